"""The engine of `render`: images made one after another in this process."""

from __future__ import annotations

from collections import deque

from forestgen.core.progress import Progress
from forestgen.core.threads import limit_cores
from forestgen.runs.contract import Job, Outcome, Work
from forestgen.runs.work import make_here


class InProcessEngine:
    """See `contract.Engine`. The first image that fails raises its own error: finished images stay.

    Parameters
    ----------
    progress : of the stages of each image.
    """

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work, self._progress = work, progress
        self._queue: deque[tuple[Job, int]] = deque()

    def __enter__(self) -> InProcessEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.clear()
        limit_cores(None)

    @property
    def workers(self) -> int:
        return 1

    def submit(self, job: Job, attempt: int) -> None:
        self._queue.append((job, attempt))

    def wait(self, timeout_s: float) -> list[Outcome]:
        """Make one image, however long it takes."""
        if not self._queue:
            return []
        job, attempt = self._queue.popleft()
        return [make_here(self._work, job, attempt, self._progress)]
