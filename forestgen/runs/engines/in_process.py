"""The engine of `render`: images made one after another in this process."""

from __future__ import annotations

import time
from collections import deque

from forestgen.core.progress import Progress
from forestgen.core.threads import cores, limit_cores
from forestgen.render.variant import mitsuba
from forestgen.runs.contract import Failed, Job, Outcome, Work
from forestgen.runs.work import explained, failure_kind, make_here, worker_name


class InProcessEngine:
    """See `contract.Engine`. An image that fails brings its error, which the run raises; finished images stay.

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
        if self._work.threads is not None:
            limit_cores(None)
            mitsuba(cores())

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
        began_s = time.perf_counter()
        try:
            return [make_here(self._work, job, attempt, self._progress)]
        except Exception as error:  # noqa: BLE001 - the run logs it, and raises it
            seconds = time.perf_counter() - began_s
            return [Failed(job, attempt, failure_kind(error), explained(error), seconds, worker_name(), error)]
