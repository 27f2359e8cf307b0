"""Compiled loops on several cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")

_LEAST_PER_THREAD = 10_000  # a shorter range is not worth a thread's start
_ALONE = threading.local()
_limit: list[int] = []  # of this process, once it is set


def limit_cores(most: int | None) -> None:
    """Let this process use at most so many cores, as one of several workers; None: all. No result depends on it."""
    _limit[:] = [] if most is None else [max(1, most)]


def cores() -> int:
    """Number of cores that this process may use; inside a job of `parallel_map` one."""
    if getattr(_ALONE, "yes", False):
        return 1
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([there, *_limit])


class _Pool:
    """Threads that wait for the next loop: starting new ones takes longer than a short loop.

    A loop inside a loop gets threads of its own: waiting for others of its own pool could deadlock.
    """

    def __init__(self) -> None:
        self._made = threading.Lock()
        self._inside = threading.local()
        self._threads: ThreadPoolExecutor | None = None
        self._size = 0

    @contextmanager
    def threads(self) -> Iterator[ThreadPoolExecutor]:
        """As many as there are cores."""
        size = cores()
        if getattr(self._inside, "yes", False):
            with ThreadPoolExecutor(size) as own:
                yield own
            return
        with self._made:
            if self._threads is None or self._size != size:
                self._threads, self._size = ThreadPoolExecutor(size, "", setattr, (self._inside, "yes", True)), size
            pool = self._threads
        yield pool

    def forget(self) -> None:
        """In a process that was forked: threads do not come along."""
        self.__init__()  # type: ignore[misc]


_POOL = _Pool()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_POOL.forget)


def parallel_map(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """The results of large independent jobs, each on a core of its own.

    The loops inside a job stay on its core, so they do not wait for each other's ends.
    """

    def alone(job: Callable[[], T]) -> T:
        _ALONE.yes = True
        try:
            return job()
        finally:
            _ALONE.yes = False

    if min(cores(), len(jobs)) < 2:
        return [job() for job in jobs]
    with _POOL.threads() as pool:
        return list(pool.map(alone, jobs))


def at_once(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """The results of independent jobs, on all cores."""
    if cores() < 2:
        return [job() for job in jobs]
    with _POOL.threads() as pool:
        return list(pool.map(lambda job: job(), jobs))


def map_ranges(n: int, work: Callable[[int, int], T]) -> list[T]:
    """``work(first, end)`` of as many disjoint ranges of 0 ... n as there are cores, in order.

    What is made of the results must not depend on the ranges.
    """
    return _in_pieces(n, work, max(1, min(cores(), n // _LEAST_PER_THREAD)))


def parallel_for(n: int, work: Callable[[int, int], None]) -> None:
    """``work(first, end)`` over 0 ... n in disjoint ranges, on all cores. Results must not depend on the ranges."""
    threads = min(cores(), n // _LEAST_PER_THREAD)
    _in_pieces(n, work, 1 if threads < 2 else 4 * threads)  # four each, so that no thread waits long for the last


def _in_pieces(n: int, work: Callable[[int, int], T], pieces: int) -> list[T]:
    if pieces == 1:
        return [work(0, n)]
    edges = [n * k // pieces for k in range(pieces + 1)]
    with _POOL.threads() as pool:
        return list(pool.map(work, edges[:-1], edges[1:]))


def over_slabs(count: int, cells_each: int, work: Callable[[int, int], None]) -> None:
    """``work(first, end)`` over 0 ... count in disjoint ranges, on all cores; each of the count has so many cells."""

    def slab(first_cell: int, end_cell: int) -> None:
        first, end = -(-first_cell // cells_each), -(-end_cell // cells_each)
        if first < end:
            work(first, end)

    parallel_for(count * cells_each, slab)
