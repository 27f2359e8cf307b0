"""How far a batch is, how fast, and who shows it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Protocol

from forestgen.core.progress import Progress, Silent

_WINDOW = 200  # the latest images, whose pace is reported
_SETTLED = 8  # images from which on that pace is worth more than the whole run's


@dataclass
class ProgressTracker:
    """Counts of a run. Images that an earlier run has made are done, but say nothing about the pace."""

    total: int  # images of the batch
    workers: int = 0
    already: int = 0  # done before this run
    made: int = 0  # by this run
    failed: int = 0  # given up
    retried: int = 0  # attempts that failed and were followed by another
    stages_s: dict[str, float] = field(default_factory=dict)  # of the images made, by stage
    started_s: float = field(default_factory=time.monotonic)
    _times: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    @property
    def done(self) -> int:
        return self.already + self.made

    @property
    def left(self) -> int:
        return self.total - self.done - self.failed

    def count(self, timings_s: Mapping[str, float]) -> None:
        """An image was made."""
        self.made += 1
        self._times.append(time.monotonic())
        for stage, seconds in timings_s.items():
            self.stages_s[stage] = self.stages_s.get(stage, 0.0) + seconds

    @property
    def images_per_hour(self) -> float | None:
        """Pace of the latest images; None before the first one."""
        if not self._times:
            return None
        if len(self._times) >= _SETTLED and self._times[-1] > self._times[0]:
            return 3600 * (len(self._times) - 1) / (self._times[-1] - self._times[0])
        return 3600 * self.made / max(1e-3, self._times[-1] - self.started_s)

    @property
    def seconds_left(self) -> float | None:
        """At this pace; None before the first image."""
        pace = self.images_per_hour
        return None if pace is None else 3600 * self.left / pace

    @property
    def longest_stages_s(self) -> dict[str, float]:
        """Seconds of each stage, the longest first."""
        return dict(sorted(self.stages_s.items(), key=lambda stage: -stage[1]))

    def shares(self) -> dict[str, float]:
        """Part of the workers' time that each stage takes, the largest first."""
        total = sum(self.stages_s.values())
        return {name: seconds / total for name, seconds in self.longest_stages_s.items() if total > 0}

    def as_event(self) -> dict[str, Any]:
        """The fields of a log's `progress`."""
        return {
            "done": self.done,
            "total": self.total,
            "failed": self.failed,
            "images_per_hour": self.images_per_hour,
            "seconds_left": self.seconds_left,
            "stage_shares": self.shares(),
        }


class Display(Progress, Protocol):
    """What shows a call's progress: the stages of the image in work, the counts of a run, and lines that stay."""

    tracker: ProgressTracker | None  # of the run that is shown, None before it has begun

    def running(self) -> AbstractContextManager[object]:
        """What is shown while its block runs."""

    def say(self, text: str) -> None:
        """A sentence worth a line."""

    def show(self, tracker: ProgressTracker) -> None:
        """The counts, every second or so; the same object every time."""


class SilentDisplay(Silent):
    """Shows nothing."""

    tracker: ProgressTracker | None = None

    def running(self) -> AbstractContextManager[object]:
        return nullcontext(self)

    def say(self, text: str) -> None:
        pass

    def show(self, tracker: ProgressTracker) -> None:
        self.tracker = tracker
