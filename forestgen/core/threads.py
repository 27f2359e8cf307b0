"""Compiled loops on several cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

# A range shorter than this is not worth a thread's start.
_LEAST_PER_THREAD = 10_000


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_ranges(n: int, work: Callable[[int, int], T]) -> list[T]:
    """``work(first, end)`` of as many disjoint ranges of 0 ... n as there are cores, in order.

    What is made of the results must not depend on the ranges.
    """
    threads = max(1, min(cores(), n // _LEAST_PER_THREAD))
    edges = [n * k // threads for k in range(threads + 1)]
    if threads == 1:
        return [work(0, n)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, edges[:-1], edges[1:]))


def over_ranges(n: int, work: Callable[[int, int], None]) -> None:
    """``work(first, end)`` over 0 ... n in disjoint ranges, on all cores. Results must not depend on the ranges."""
    threads = min(cores(), n // _LEAST_PER_THREAD)
    if threads < 2:
        work(0, n)
        return
    edges = [n * k // (4 * threads) for k in range(4 * threads + 1)]  # four each: the last to finish has little left
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
