"""Run all checks over a data set, on several processes; the outcome does not depend on their number.

Each family of invariants is a small module. The checks recompute from the files' definitions in plain NumPy. They share
no code that computes labels with those who wrote the files: only the numbers of parts, and readers that are safe with
strangers' files.

Findings are ordered: frames by name, each with its checks in the order of this module, then the files over all images.
"""

from __future__ import annotations

import math
import signal
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.processes import without_main
from forestgen.core.progress import Progress, Silent
from forestgen.core.registry import Registration, register_again, registrations
from forestgen.core.threads import cores
from forestgen.dataset.check import geometry, light, masks, merged
from forestgen.dataset.check.files import MISUNDERSTOOD, Finding, UnreadableError
from forestgen.dataset.check.frame_data import FrameCheck, FrameData
from forestgen.dataset.check.merged import UNKNOWN, DatasetCheck, Merged, following_frames, open_dataset
from forestgen.dataset.formats.format import known_formats

_FRAMES_A_CHUNK = 4  # in a row, so that a sequence's next frame is read once
_FEWEST_FOR_PROCESSES = 6  # frames: below, starting a process takes longer than its share of the work
MOST_NAMED = 1000  # findings of one check that are named; the others are counted

# Of a frame's own labels, in the order in which they run. Those of each registered format follow.
_FRAME_CHECKS = (
    merged.files, geometry.camera, masks.ids, masks.instance_png, masks.parts, masks.semantic, merged.names,
    masks.coverage, masks.visible, masks.areas, masks.stems, masks.measures, masks.keypoints, masks.places,
    masks.amodal, geometry.depth, geometry.sky, geometry.circle, geometry.position, geometry.normals, geometry.centre,
    masks.branches, light.radiance, light.header, light.raw, light.photo, light.surfaces, geometry.motion,
)  # fmt: skip
_DATASET_CHECKS = (merged.listing, merged.legend)

Named = tuple[list[Finding], int]  # a check's findings that are named, and the number of all


@dataclass(frozen=True)
class Report:
    """What the checks found."""

    frames: int
    looked_at: Mapping[str, int]  # check -> frames; of a check over all frames 1
    findings: tuple[Finding, ...]  # in order, up to `MOST_NAMED` of each check
    found: int  # findings, also those that are not named


def check_dataset(root: Path, *, jobs: int | None = None, progress: Progress | None = None) -> Report:
    """Check a data set's folder, by so many processes; one that is no data set of forestgen raises `RecipeError`."""
    data_set = open_dataset(root)
    frames = _frames(data_set)
    looked_at, found = Counter[str](), Counter[str]()
    findings: list[Finding] = []

    def add(check: str, named: Sequence[Finding], count: int) -> None:
        looked_at[check] += 1
        findings.extend(named[: max(0, MOST_NAMED - found[check])])
        found[check] += count

    with (progress or Silent()).stage("images", len(frames)) as advance:
        for result in _frame_results(frames, _job_count(jobs, len(frames))):
            for check, (named, count) in result.items():
                add(check, named, count)
            advance(1)
    for one in _dataset_checks():
        if one.applies(data_set):
            own = list(one.findings(data_set))
            add(one.name, own, len(own))
    return Report(len(frames), looked_at, tuple(findings), found.total())


def _frame_checks() -> Iterator[FrameCheck]:
    return chain(_FRAME_CHECKS, *(one.frame_checks() for one in known_formats()))


def _dataset_checks() -> Iterator[DatasetCheck]:
    return chain(_DATASET_CHECKS, *(one.dataset_checks() for one in known_formats()))


def check_frame(data: FrameData) -> dict[str, Named]:
    """Run the checks of one frame that apply.

    A file that cannot be read is named once, and the checks that do without it go on.
    """
    found: dict[str, Named] = {}
    known: set[tuple[object, ...]] = set()  # of a file that cannot be read, which several checks ask for
    for check in _frame_checks():
        if _applies(check, data):
            own = [one for one in check.findings(data) if _place(one) not in known]
            known.update(map(_place, own))
            found[check.name] = own[:MOST_NAMED], len(own)
    return found


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


def _frames(data_set: Merged) -> list[FrameData]:
    listed: dict[str, dict[str, Any]] = {name: {} for name in data_set.frames}
    for name, entry in data_set.listed.items():
        frame = name.partition("/")[0]
        if "/" in name and frame in listed:
            listed[frame][name] = entry
    following = following_frames(data_set.root, data_set.frames)
    shares = {}  # format -> frame -> what can be read of it in merged files; the format's own checks report the rest
    for one in known_formats():
        with suppress(UnreadableError, *MISUNDERSTOOD):
            shares[one.name] = one.frame_shares(data_set)
    return [
        FrameData(
            data_set.root,
            name,
            listed[name],
            shared={format_name: by_frame[name] for format_name, by_frame in shares.items() if name in by_frame},
            next_name=following.get(name),
        )
        for name in data_set.frames
    ]


def _frame_results(frames: Sequence[FrameData], jobs: int) -> Iterator[dict[str, Named]]:
    """Results in the order of frames."""
    size = max(1, min(_FRAMES_A_CHUNK, math.ceil(len(frames) / (2 * jobs))))
    chunks = [frames[first : first + size] for first in range(0, len(frames), size)]
    if jobs == 1:
        yield from chain.from_iterable(map(_chunk, chunks))
        return
    # A process of its own start, not a copy of this one, which has threads and handlers of signals.
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(registrations(),))
    try:
        with without_main():  # this starts the processes
            results = pool.map(_chunk, chunks)
        yield from chain.from_iterable(results)
    except BrokenProcessPool as error:
        hint = "free some memory, or `workers=1`"
        raise ResourceError("a worker process died, most likely for want of memory", hint=hint) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _chunk(frames: Sequence[FrameData]) -> list[dict[str, Named]]:
    """Check frames in a row; a sequence's next frame is read once."""
    waiting = {one.name: replace(one) for one in frames}  # which hold what they have read until they are checked
    results = []
    for name in [one.name for one in frames]:
        data = waiting.pop(name)
        if data.next_name is not None and data.next_name != UNKNOWN:
            data.following = waiting.get(data.next_name) or FrameData(data.root, data.next_name)
        results.append(check_frame(data))
    return results


def _begin(registered: tuple[Registration, ...]) -> None:
    """Register the parent's formats. Ctrl-C ends the parent, which ends its workers."""
    register_again(registered)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _job_count(jobs: int | None, frames: int) -> int:
    if jobs is None:
        jobs = cores() if frames >= _FEWEST_FOR_PROCESSES else 1
    return max(1, min(jobs, frames))
