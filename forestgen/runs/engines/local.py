"""The local engine: worker processes of this machine, each with a pipe of its own.

A worker that dies - killed, out of memory, crashed in compiled code - fails the job that it had, and another takes its
place. Workers share no queue and no lock: one that is killed while it holds them would stop the others, and so it is in
the pools of processes that there are. Workers start when there are jobs for them.
"""

from __future__ import annotations

import multiprocessing
import pickle
import platform
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from forestgen.core.processes import without_main
from forestgen.core.registry import registrations
from forestgen.runs.contract import Failed, FailureKind, Job, Outcome, Work
from forestgen.runs.engines.worker_process import serve

_LOOK_EVERY_S = 0.2  # how often workers are looked at, where their memory or time is bounded
_LEAVES_WITHIN_S = 10.0  # a process whose pipe has closed


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    task: tuple[Job, int] | None = None  # what it does, and the attempt
    since_s: float = field(default_factory=time.monotonic)

    @property
    def name(self) -> str:
        return f"{platform.node()}:{self.process.pid}"


class LocalEngine:
    """See `contract.Engine`.

    `work`: sent to each worker once.
    `workers`: processes.
    `make`: what does a job, `runs.work.make_job`; must be importable by name, as workers are processes of their own.
    `timeout_s`: that a job may take; its worker is killed then, even if it hangs. None: no bound.
    """

    def __init__(
        self, work: Work, workers: int, make: Callable[[Work, Job, int], Outcome], *, timeout_s: float | None = None
    ) -> None:
        self._work, self._timeout_s = work, timeout_s
        self._count = max(1, workers)
        self._packed = pickle.dumps((registrations(), make, work))
        self._workers: list[_Worker] = []
        self._queue: deque[tuple[Job, int]] = deque()
        self._outcomes: list[Outcome] = []

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            worker.pipe.close()
        self._workers.clear()
        self._queue.clear()

    @property
    def workers(self) -> int:
        return self._count

    def submit(self, job: Job, attempt: int) -> None:
        self._queue.append((job, attempt))
        self._hand_out()

    def wait(self, timeout_s: float) -> list[Outcome]:
        end = time.monotonic() + timeout_s
        while not self._outcomes and (left := end - time.monotonic()) > 0:
            bounded = self._work.memory_bytes is not None or self._timeout_s is not None
            self._listen(min(left, _LOOK_EVERY_S) if bounded else left)
            self._check_bounds()
            self._hand_out()
        outcomes, self._outcomes = self._outcomes, []
        return outcomes

    def _hand_out(self) -> None:
        """Give waiting jobs to workers that have none, starting those that are missing."""
        while self._queue:
            idle = next((worker for worker in self._workers if worker.task is None), None)
            if idle is None and len(self._workers) < self._count:
                idle = self._start()
            if idle is None:
                return
            try:
                idle.pipe.send(self._queue[0])
            except OSError:  # it died idle: the job has not begun
                self._bury(idle)
                continue
            idle.task, idle.since_s = self._queue.popleft(), time.monotonic()

    def _start(self) -> _Worker:
        context = multiprocessing.get_context("spawn")  # a fork would copy threads' locks
        ours, theirs = context.Pipe()
        process = context.Process(
            target=serve, args=(theirs, self._packed, self._work.threads), name="forestgen worker"
        )
        with _without_ctrl_c(), without_main():
            process.start()
        theirs.close()
        self._workers.append(_Worker(process, ours))
        return self._workers[-1]

    def _listen(self, timeout_s: float) -> None:
        """Take what workers report, and notice those that have died."""
        sources: dict[Any, _Worker] = {worker.pipe: worker for worker in self._workers}
        sources |= {worker.process.sentinel: worker for worker in self._workers}
        heard = {id(worker): worker for worker in (sources[one] for one in wait(list(sources), timeout_s))}
        for worker in heard.values():
            try:
                while worker.pipe.poll():
                    self._outcomes.append(worker.pipe.recv())
                    worker.task = None
                gone = not worker.process.is_alive()
            except (EOFError, OSError):  # also in the middle of a message
                gone = True
            if gone:
                worker.process.join(_LEAVES_WITHIN_S)
                self._fail(worker, "worker", _cause_of_death(worker.process.exitcode))

    def _check_bounds(self) -> None:
        """Stop workers that take more memory or time than they may."""
        most_bytes, most_s = self._work.memory_bytes, self._timeout_s
        for worker in [one for one in self._workers if not one.pipe.poll()]:  # the others are done
            used = 0 if most_bytes is None else _resident_bytes(worker.process.pid)
            taken_s = 0.0 if worker.task is None else time.monotonic() - worker.since_s
            if most_bytes is not None and used > most_bytes:
                self._fail(
                    worker,
                    "memory",
                    f"the worker took {used / 1e9:.2f} GB of memory, more than the {most_bytes / 1e9:.2f} GB it may "
                    "have\n"
                    "  try       a larger `worker_memory` with fewer workers, smaller images or a smaller site",
                )
            elif most_s is not None and taken_s > most_s:
                self._fail(
                    worker,
                    "time",
                    f"the image was not done after {taken_s:.3g} s\n"
                    "  try       a larger `timeout`, if the image is only slow; a worker's first image takes longest",
                )

    def _fail(self, worker: _Worker, kind: FailureKind, message: str) -> None:
        """The worker is no more; what it did has failed."""
        self._bury(worker)
        if worker.task is not None:
            job, attempt = worker.task
            seconds = time.monotonic() - worker.since_s
            self._outcomes.append(Failed(job, attempt, kind, message, seconds, worker.name))

    def _bury(self, worker: _Worker) -> None:
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)


def _cause_of_death(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f"the worker process left with exit code {exit_code}"
    with suppress(ValueError):
        name = signal.Signals(-exit_code).name
        if name == "SIGKILL":
            return (
                "the worker process was killed (SIGKILL), most likely because memory ran out\n"
                "  try       fewer workers, or `worker_memory` to see which images take so much"
            )
        return f"the worker process crashed ({name})"
    return f"the worker process was ended by signal {-exit_code}"


def _resident_bytes(pid: int | None) -> int:
    """Memory of a process that is resident now; 0 if it is gone."""
    import psutil

    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """A process started in this block never takes Ctrl-C; while Python starts it would die with a traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else it is started in the block, and unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
