"""Displays of a run's progress, for tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from forestgen.runs.summary import ProgressTracker


class RecordingDisplay:
    """A display that keeps the lines that a run prints."""

    def __init__(self) -> None:
        self.said: list[str] = []

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Any]:
        yield lambda steps: None

    def say(self, text: str) -> None:
        self.said.append(text)

    def show(self, meter: ProgressTracker) -> None:
        pass
