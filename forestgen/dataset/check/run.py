"""Run all checks over a data set, on several processes; the outcome does not depend on their number.

Offenders are ordered: frames by name, each with its checks in the registry's order, then the files over all images.
"""

from __future__ import annotations

import math
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.progress import Progress
from forestgen.dataset.check.frame_data import FrameData, FrameTask
from forestgen.dataset.check.merged import Merged, open_dataset
from forestgen.dataset.check.offence import DatasetCheck, FrameCheck, Offence, UnreadableError
from forestgen.dataset.check.registry import DATASET_CHECKS, FIRST, FRAME_CHECKS, HASHES, SHARED_HASHES
from forestgen.dataset.check.sequences import UNKNOWN, following_frames

_FRAMES_A_TASK = 4  # in a row, so that a sequence's next frame is read once
_FEWEST_FOR_PROCESSES = 6  # frames: below, starting a process takes longer than its share of the work
_MOST_A_CHECK = 5  # offenders that one check names in one image
_MISUNDERSTOOD = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Tally:
    """How a check went."""

    name: str
    holds: str
    images: int  # that it looked at; of a check over all images, 1 or 0
    good: int


@dataclass(frozen=True)
class Report:
    """What the checks found."""

    frames: int  # in the data set
    checked: int  # frames that were looked at before the first offender stopped the work
    tallies: tuple[Tally, ...]
    offences: tuple[Offence, ...]  # in order; the first alone unless all were asked for
    seconds: float


@dataclass(frozen=True)
class FrameResult:
    """One frame's outcome, from a worker."""

    ran: tuple[str, ...]  # checks that applied
    offences: tuple[Offence, ...]


def check_dataset(
    root: Path,
    *,
    jobs: int | None = None,
    hashes: bool = True,
    most: int = 1,
    progress: Progress | None = None,
) -> Report:
    """Check a data set's folder.

    Parameters
    ----------
    jobs : worker processes; by default the cores. No result depends on it.
    hashes : compare each file with manifest.json's SHA-256.
    most : offenders to name before stopping.

    Raises
    ------
    RecipeError
        When the folder is no data set of forestgen.
    """
    start = perf_counter()
    merged = open_dataset(root)
    tasks = _tasks(merged)
    checks = (FIRST, *FRAME_CHECKS, *((HASHES,) if hashes else ()))
    ran: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    offences: list[Offence] = []
    checked = 0
    results = _frame_results(tasks, _job_count(jobs, len(tasks)), hashes, most)
    with _stage(progress, len(tasks)) as advance:
        for result in results:
            checked += 1
            ran.update(result.ran)
            failed.update({offence.check for offence in result.offences})
            offences += result.offences
            advance(1)
            if len(offences) >= most:
                results.close()
                break
    tallies = [Tally(one.name, one.holds, ran[one.name], ran[one.name] - failed[one.name]) for one in checks]
    for check in (*DATASET_CHECKS, *((SHARED_HASHES,) if hashes else ())):
        if len(offences) >= most or not check.applies(merged):
            continue
        found = _found_by(check, merged, "")
        offences += found
        tallies.append(Tally(check.name, check.holds, 1, 0 if found else 1))
    return Report(len(tasks), checked, tuple(tallies), tuple(offences[:most]), perf_counter() - start)


def check_frame(data: FrameData, hashes: bool, most: int) -> FrameResult:
    """Run the checks of one frame; after `most` offenders, or if files are not readable, no further ones."""
    ran, offences = [FIRST.name], _found_by(FIRST, data, data.name)
    checks = () if offences else FRAME_CHECKS
    for check in (*checks, *((HASHES,) if hashes and data.task.listed else ())):
        if len(offences) >= most:
            break
        try:
            if not check.applies(data):
                continue
        except _MISUNDERSTOOD:
            pass  # the check itself meets it again, and says so
        ran.append(check.name)
        offences += _found_by(check, data, data.name)
    return FrameResult(tuple(ran), tuple(offences))


def _found_by(check: FrameCheck | DatasetCheck, data: Any, image: str) -> list[Offence]:
    """The check's first offenders; content that it cannot understand is one."""
    found: list[Offence] = []
    file = check.file or image
    if isinstance(check, FrameCheck) and check.file and not check.shared:
        file = f"{image}/{check.file}"
    try:
        for offence in islice(check.find(data), _MOST_A_CHECK):
            found.append(offence)  # noqa: PERF402 - those before an error count
    except UnreadableError as error:
        found.append(error.offence)
    except _MISUNDERSTOOD as error:
        reason = f"{type(error).__name__}: {error}"
        found.append(Offence(file, "the content is not of this format", got=reason[:200]))
    return [replace(offence, check=check.name, image=offence.image or image) for offence in found]


def _tasks(merged: Merged) -> list[FrameTask]:
    listed: dict[str, dict[str, Any]] = {name: {} for name in merged.frames}
    for name, entry in merged.listed.items():
        frame = name.partition("/")[0]
        if "/" in name and frame in listed:
            listed[frame][name] = entry
    following = following_frames(merged.root, merged.frames)
    return [
        FrameTask(merged.root, name, listed[name], merged.shared(name), following.get(name)) for name in merged.frames
    ]


def _frame_results(tasks: Sequence[FrameTask], jobs: int, hashes: bool, most: int) -> Generator[FrameResult]:
    """Results in the order of frames. Closing the iterator stops the work."""
    size = max(1, min(_FRAMES_A_TASK, math.ceil(len(tasks) / (2 * jobs))))
    chunks = [tasks[first : first + size] for first in range(0, len(tasks), size)]
    if jobs == 1:
        for chunk in chunks:
            yield from _frames(chunk, hashes, most)
        return
    # A process of its own start, not a copy of this one, which has threads and handlers of signals.
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_quiet)
    try:
        waiting: list[Future[list[FrameResult]]] = []
        for chunk in chunks:
            waiting.append(pool.submit(_chunk, chunk, hashes, most))
            while len(waiting) > 2 * jobs:  # no more than that are in memory
                yield from waiting.pop(0).result()
        for future in waiting:
            yield from future.result()
    except BrokenProcessPool as error:
        hint = "free some memory, or --jobs 1"
        raise ResourceError("a worker process died, most likely for want of memory", hint=hint) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _chunk(tasks: Sequence[FrameTask], hashes: bool, most: int) -> list[FrameResult]:
    return list(_frames(tasks, hashes, most))


def _frames(tasks: Sequence[FrameTask], hashes: bool, most: int) -> Iterator[FrameResult]:
    """Check frames in a row; a sequence's next frame is read once."""
    by_name = {task.name: task for task in tasks}
    held: dict[str, FrameData] = {}
    for task in tasks:
        data = held.pop(task.name, None) or FrameData(task)
        held.clear()
        if task.following not in (None, UNKNOWN):
            following = FrameData(by_name.get(task.following) or FrameTask(task.root, task.following, {}, {}))
            data.following = following
            if task.following in by_name:
                held[task.following] = following
        result = check_frame(data, hashes, most)
        data.following = None
        yield result
        if len(result.offences) >= most:
            return


def _quiet() -> None:
    """Ctrl-C ends the parent, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _job_count(jobs: int | None, frames: int) -> int:
    if jobs is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        jobs = cores if frames >= _FEWEST_FOR_PROCESSES else 1
    return max(1, min(jobs, frames))


def _stage(progress: Progress | None, frames: int) -> Any:
    from contextlib import nullcontext

    return progress.stage("images", frames) if progress is not None else nullcontext(_ignore)


def _ignore(_: int) -> None:
    pass
