"""Progress of long work, told to whoever listens: the command line shows bars, a library call shows nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Progress(Protocol):
    """A listener. `stage` opens a piece of work of `total` steps and yields a function that advances it."""

    def stage(self, title: str, total: int) -> AbstractContextManager[Callable[[int], None]]: ...


class Silent:
    """The listener that shows nothing."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        yield lambda steps: None
