"""Compiled loops on several cores: order, loops inside loops, forks."""

from __future__ import annotations

import itertools
import os
import threading

import numpy as np
import pytest

from forestgen.core import threads

pytestmark = pytest.mark.usefixtures("four_cores")


@pytest.fixture
def four_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda pid: set(range(4)), raising=False)


@pytest.mark.parametrize("n", [0, 1, 9_999, 123_457])
def test_ranges_cover_everything_once(n: int) -> None:
    seen = np.zeros(n, dtype=np.int64)

    def work(first: int, end: int) -> None:
        seen[first:end] += 1

    threads.parallel_for(n, work)
    assert (seen == 1).all()
    spans = threads.map_ranges(n, lambda first, end: (first, end))
    assert spans[0][0] == 0
    assert spans[-1][1] == n
    assert all(a[1] == b[0] for a, b in itertools.pairwise(spans))


def test_a_loop_inside_loops_ends() -> None:
    def inner(first: int, end: int) -> None:
        threads.parallel_for(100_000, lambda a, b: None)

    done = threading.Thread(target=lambda: threads.parallel_for(400_000, inner), daemon=True)
    done.start()
    done.join(timeout=30)
    assert not done.is_alive()


def test_an_error_in_a_range_is_raised() -> None:
    def work(first: int, end: int) -> None:
        if first > 0:
            raise ValueError("in a range")

    with pytest.raises(ValueError, match="in a range"):
        threads.parallel_for(100_000, work)
    assert threads.at_once([lambda: 1, lambda: 2]) == [1, 2]  # the threads are still there


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own() -> None:
    threads.at_once([lambda: None] * 4)
    child = os.fork()
    if child == 0:
        os._exit(0 if threads.at_once([lambda: 1, lambda: 2]) == [1, 2] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_jobs_apart_have_a_core_each() -> None:
    """Their results in order; loops inside of them have one core, and outside all again; an error is raised."""
    jobs = [lambda k=k: (k, threads.cores()) for k in range(5)]
    assert threads.parallel_map(jobs) == [(k, 1) for k in range(5)]
    assert threads.cores() == 4

    def fail() -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        threads.parallel_map([fail, lambda: 1])
    assert threads.at_once([threads.cores, threads.cores]) == [4, 4]
