"""Run all checks over a data set, on several processes; the outcome does not depend on their number.

Findings are ordered: frames by name, each with its checks in the order of this module, then the files over all images.
"""

from __future__ import annotations

import math
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import chain, repeat
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.processes import without_main
from forestgen.core.progress import Progress
from forestgen.core.registry import Registration, register_again, registrations
from forestgen.dataset.check import geometry, light, manifest, masks, plants
from forestgen.dataset.check.check import DatasetCheck, FrameCheck
from forestgen.dataset.check.finding import MISUNDERSTOOD, Finding, UnreadableError, misunderstood
from forestgen.dataset.check.frame_data import FrameData, FrameTask
from forestgen.dataset.check.merged import UNKNOWN, Merged, following_frames, open_dataset
from forestgen.dataset.formats.format import known_formats

_FRAMES_A_TASK = 4  # in a row, so that a sequence's next frame is read once
_FEWEST_FOR_PROCESSES = 6  # frames: below, starting a process takes longer than its share of the work
MOST_NAMED = 1000  # findings of one check that are named; the others are counted

# Of a frame's own labels, in the order in which they run. Those of each registered format follow.
_FRAME_CHECKS = (
    manifest.files, geometry.camera, masks.ids, masks.instance_png, masks.parts, masks.semantic, manifest.names,
    masks.coverage, plants.visible, plants.areas, plants.stems, plants.measures, plants.keypoints, plants.places,
    plants.amodal, geometry.depth, geometry.sky, geometry.circle, geometry.position, geometry.normals, geometry.centre,
    masks.branches, light.radiance, light.header, light.raw, light.surfaces, geometry.motion,
)  # fmt: skip
_DATASET_CHECKS = (manifest.listing, manifest.legend)


@dataclass(frozen=True)
class CheckResult:
    """How a check went."""

    name: str
    holds: str
    images: int  # that it looked at; of a check over all images, 1 or 0
    good: int
    found: int = 0  # findings, also those that are not named


@dataclass(frozen=True)
class Report:
    """What the checks found."""

    frames: int  # in the data set
    checked: int  # frames that were looked at before the first finding stopped the work
    check_results: tuple[CheckResult, ...]
    findings: tuple[Finding, ...]  # in order; the first alone unless more were asked for
    seconds: float


@dataclass(frozen=True)
class FrameResult:
    """One frame's outcome, from a worker."""

    ran: tuple[str, ...]  # checks that applied
    findings: tuple[Finding, ...]
    found: Counter[str]  # check -> how many findings, also those beyond MOST_NAMED


def check_dataset(
    root: Path,
    *,
    jobs: int | None = None,
    hashes: bool = True,
    most: int | None = 1,
    progress: Progress | None = None,
) -> Report:
    """Check a data set's folder; one that is no data set of forestgen raises `RecipeError`.

    Parameters
    ----------
    jobs : worker processes; by default the cores. No result depends on it.
    hashes : compare each file with manifest.json's SHA-256.
    most : findings to name before stopping; None: go through everything, and name up to `MOST_NAMED` of each check.
    """
    start = perf_counter()
    merged = open_dataset(root)
    tasks = _tasks(merged)
    hashed = (manifest.shared_hashes,) if hashes else ()
    ran: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    found: Counter[str] = Counter()
    findings: list[Finding] = []
    checked = 0
    limit = math.inf if most is None else most
    results = _frame_results(tasks, _job_count(jobs, len(tasks)), hashes, limit)
    with nullcontext(lambda _: None) if progress is None else progress.stage("images", len(tasks)) as advance:
        for result in results:
            checked += 1
            ran.update(result.ran)
            failed.update(result.found.keys())
            findings += _first_of_each(result.findings, found)
            found.update(result.found)
            advance(1)
            if len(findings) >= limit:
                results.close()
                break
    check_results = [
        CheckResult(one.name, one.holds, ran[one.name], ran[one.name] - failed[one.name], found[one.name])
        for one in _frame_checks(hashes)
    ]
    for check in (*_DATASET_CHECKS, *(check for one in known_formats() for check in one.dataset_checks()), *hashed):
        if len(findings) >= limit or not check.applies(merged):
            continue
        own, count = _found_by(check, merged, "")
        findings += own
        check_results.append(CheckResult(check.name, check.holds, 1, 0 if count else 1, count))
    return Report(len(tasks), checked, tuple(check_results), tuple(findings[:most]), perf_counter() - start)


def _frame_checks(hashes: bool) -> Iterator[FrameCheck]:
    yield from _FRAME_CHECKS
    for one in known_formats():
        yield from one.frame_checks()
    if hashes:
        yield manifest.frame_hashes


def check_frame(data: FrameData, hashes: bool, most: float) -> FrameResult:
    """Run the checks of one frame; after `most` findings no further ones.

    A file that cannot be read is named once, and the checks that do without it go on.
    """
    ran: list[str] = []
    findings: list[Finding] = []
    found: Counter[str] = Counter()
    for check in _frame_checks(hashes):
        if len(findings) >= most:
            break
        if not _applies(check, data):
            continue
        ran.append(check.name)
        own, count = _found_by(check, data, data.name)
        known = {_place(one) for one in findings}  # of a file that cannot be read, which several checks ask for
        fresh = [one for one in own if _place(one) not in known]
        findings += fresh
        if count > len(own) - len(fresh):
            found[check.name] = count - (len(own) - len(fresh))
    return FrameResult(tuple(ran), tuple(findings), found)


def _place(finding: Finding) -> tuple[object, ...]:
    return finding.file, finding.problem, finding.plant_id, finding.pixel


def _applies(check: FrameCheck, data: FrameData) -> bool:
    """Whether a check has its files; it says itself what it cannot understand of them."""
    try:
        return check.applies(data)
    except UnreadableError:
        return False  # which the first check has named
    except MISUNDERSTOOD:
        return True


def _first_of_each(findings: Sequence[Finding], before: Counter[str]) -> Iterator[Finding]:
    """Those of a frame that are named, by how many of each check there were in other frames."""
    number = Counter(before)
    for finding in findings:
        number[finding.check] += 1
        if number[finding.check] <= MOST_NAMED:
            yield finding


def _found_by(check: FrameCheck | DatasetCheck, data: Any, image: str) -> tuple[list[Finding], int]:
    """The check's first findings and the number of all; content that it cannot understand is one."""
    found: list[Finding] = []
    count = 0
    file = check.file or image
    if isinstance(check, FrameCheck) and check.file and not check.shared:
        file = f"{image}/{check.file}"
    try:
        for finding in check.findings(data) if isinstance(check, FrameCheck) else check.find(data):
            count += 1
            if count <= MOST_NAMED:
                found.append(finding)
    except UnreadableError as error:
        found.append(error.finding)
        count += 1
    except MISUNDERSTOOD as error:
        found.append(misunderstood(file, error))
        count += 1
    return [replace(finding, check=check.name, image=finding.image or image) for finding in found], count


def _tasks(merged: Merged) -> list[FrameTask]:
    listed: dict[str, dict[str, Any]] = {name: {} for name in merged.frames}
    for name, entry in merged.listed.items():
        frame = name.partition("/")[0]
        if "/" in name and frame in listed:
            listed[frame][name] = entry
    following = following_frames(merged.root, merged.frames)
    shares = _shares(merged)
    return [
        FrameTask(
            root=merged.root,
            name=name,
            listed=listed[name],
            shared={format_name: by_frame[name] for format_name, by_frame in shares.items() if name in by_frame},
            following=following.get(name),
        )
        for name in merged.frames
    ]


def _shares(merged: Merged) -> dict[str, Mapping[str, Any]]:
    """Format -> frame -> what can be read of it in the format's merged files; its own checks report the rest."""
    found = {}
    for one in known_formats():
        with suppress(UnreadableError, *MISUNDERSTOOD):
            found[one.name] = one.frame_shares(merged)
    return found


def _frame_results(tasks: Sequence[FrameTask], jobs: int, hashes: bool, most: float) -> Generator[FrameResult]:
    """Results in the order of frames. Closing the iterator stops the work."""
    size = max(1, min(_FRAMES_A_TASK, math.ceil(len(tasks) / (2 * jobs))))
    chunks = [tasks[first : first + size] for first in range(0, len(tasks), size)]
    if jobs == 1:
        for chunk in chunks:
            yield from _chunk(chunk, hashes, most)
        return
    # A process of its own start, not a copy of this one, which has threads and handlers of signals.
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(registrations(),))
    try:
        with without_main():  # this starts the processes
            results = pool.map(_chunk, chunks, repeat(hashes), repeat(most))
        yield from chain.from_iterable(results)
    except BrokenProcessPool as error:
        hint = "free some memory, or `workers=1`"
        raise ResourceError("a worker process died, most likely for want of memory", hint=hint) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _chunk(tasks: Sequence[FrameTask], hashes: bool, most: float) -> list[FrameResult]:
    """Check frames in a row; a sequence's next frame is read once."""
    results = []
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
        results.append(check_frame(data, hashes, most))
        data.following = None
        if len(results[-1].findings) >= most:
            break
    return results


def _begin(registered: tuple[Registration, ...]) -> None:
    """Register the parent's formats. Ctrl-C ends the parent, which ends its workers."""
    register_again(registered)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _job_count(jobs: int | None, frames: int) -> int:
    if jobs is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        jobs = cores if frames >= _FEWEST_FOR_PROCESSES else 1
    return max(1, min(jobs, frames))
