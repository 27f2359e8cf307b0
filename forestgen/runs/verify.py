"""Whether a data set is what its records say, from the sums of its files to the plants of its splits.

Every check goes on after its first finding, and names up to `MOST_NAMED`; the report counts the others. The checks, in
their order:

| check | holds if |
|---|---|
| sums | every file that SHA256SUMS lists is there and has its bytes |
| listing | nothing else lies in the data set's folder, but run/, report.html and .forestgen/; no folder is empty |
| records | the records of the images say the same sums and rows |
| index | it has the frames that are there, and dataset.json counts them right |
| manifests | the manifest.json of each split lists the split's files with the sums of SHA256SUMS |
| recipes | recipe.yaml is the recipe that dataset.json names |
| frames | the index tells of each frame what its files show |
| seeds | no image's seed is in two splits |
| communities | no plant community, by species and places of its plants, is in two splits |
| labels SPLIT | the split's labels are true to each other and to its files |
| renders | images that are rendered again have the same bytes |

Files that other tools leave in the folder (`folder.tool_of`) are a note.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any

from forestgen.core.arguments import MOST_SEEDS, flag_of, is_address, whole_of
from forestgen.core.errors import ForestgenError, RecipeError
from forestgen.core.figures import count, seconds
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.check.files import Finding
from forestgen.dataset.check.run import MOST_NAMED, check_dataset
from forestgen.dataset.manifest import is_run_folder
from forestgen.dataset.safe_path import SafePath, check_folder, unreadable
from forestgen.recipe.registries import DATASET_FORMATS
from forestgen.runs import verify_index as checks
from forestgen.runs.description import DATASET_NAME, read_description, settings_of
from forestgen.runs.folder import BATCH
from forestgen.runs.record_index import RecordIndex
from forestgen.runs.records import JOBS
from forestgen.runs.replace import previous_note
from forestgen.runs.storage import LocalStorage
from forestgen.runs.verify_frames import check_frames, check_renders


@dataclass(frozen=True)
class CheckResult:
    """How a check went."""

    name: str
    holds: str  # what is true if it passes, for people
    images: int  # that it looked at; of others frames, files, rows
    good: int
    found: int  # findings, also those that are not named


@dataclass(frozen=True, repr=False)
class VerificationReport:
    """What the checks found."""

    images: int
    frames: int
    files: int  # that SHA256SUMS lists
    checks: tuple[CheckResult, ...]  # in their order; `images` counts what a check looked at
    findings: tuple[Finding, ...]  # in the order of the checks; of each check the first thousand
    notes: tuple[str, ...]  # for people; none of them is an error
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether every check passed."""
        return not self.findings

    @property
    def not_named(self) -> int:
        """How many findings there are beyond those in `findings`."""
        return sum(check.found for check in self.checks) - len(self.findings)

    def as_dict(self) -> dict[str, Any]:
        """The report in plain types, for JSON."""
        return {
            "ok": self.ok,
            "images": self.images,
            "frames": self.frames,
            "files": self.files,
            "checks": [
                {"name": one.name, "holds": one.holds, "looked_at": one.images, "findings": one.found}
                for one in self.checks
            ],
            "findings": [_finding(one) for one in self.findings],
            "findings_not_named": self.not_named,
            "notes": list(self.notes),
            "seconds": round(self.seconds, 3),
        }

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        found = "ok" if self.ok else count(len(self.findings) + self.not_named, "finding")
        return f"<VerificationReport: {found}, {count(self.images, 'image')}, {count(self.frames, 'frame')}>"

    def lines(self) -> Iterator[str]:
        """For people: the table of checks, what was found, then what they should know."""
        width = max(len(check.name) for check in self.checks)
        yield f"{'check':<{width}}   looked at  ok"
        for check in self.checks:
            what = f"FAILED: {check.holds} ({count(check.found, 'finding')})" if check.found else check.holds
            mark = "no " if check.found else "yes"
            yield f"{check.name:<{width}}  {check.images:>10,}  {mark} {what}"
        for one in self.findings:
            values = [f"{word} {text}" for word, text in (("expected", one.expected), ("got", one.got)) if text]
            more = f" ({'; '.join(values)})" if values else ""
            yield f"{one.check}: {one.where}: {one.problem}{more}"
        if self.not_named:
            yield f"... and {self.not_named:,} more"
        for note in self.notes:
            yield f"note: {note}"
        done = f"{count(self.images, 'image')}, {count(self.frames, 'frame')}, {count(self.files, 'file')}"
        yield f"{done} in {seconds(self.seconds)}"


def _finding(one: Finding) -> dict[str, Any]:
    names = ("check", "where", "problem", "expected", "got", "file", "plant_id")
    pixel = None if one.pixel is None else list(one.pixel)
    return {**{name: getattr(one, name) for name in names}, "frame": one.image or None, "pixel": pixel}


class _Verifier:
    """A data set, and what the checks found in it."""

    def __init__(self, data_set: checks.OpenDataSet, workers: int | None, progress: Progress) -> None:
        self.data_set, self.workers, self.progress = data_set, workers, progress
        self.checks: list[CheckResult] = []
        self.findings: list[Finding] = []
        self.notes: list[str] = []

    def run(
        self, name: str, holds: str, looked_at: int, found: Iterable[Finding], most: float = MOST_NAMED, more: int = 0
    ) -> None:
        """Take a check's findings: name the first `most` and count all; `more` are not among `found`."""
        count = 0
        for count, one in enumerate(found, start=1):
            if count <= most:
                self.findings.append(replace(one, check=name))
        count += more
        self.checks.append(CheckResult(name, holds, looked_at, max(0, looked_at - count), count))


def verify(
    root: Path,
    *,
    rerender: int = 0,
    seed: int = 0,
    workers: int | None = None,
    hashes: bool = True,
    labels: bool = True,
    progress: Progress | None = None,
) -> VerificationReport:
    """Check a data set's folder.

    `rerender`: how many images to render again.
    `seed`: draws these.
    `workers`: processes and threads that check; by default the cores. No result depends on it.
    `hashes`: read all files and compare their sums; otherwise only that they are there.
    `labels`: check the labels of each split.

    Raises `RecipeError`: the folder is no data set of forestgen, or a number is out of bounds.
    """
    whole_of(rerender, "rerender", 0, 10**9)
    whole_of(seed, "seed", 0, MOST_SEEDS)
    flag_of(hashes, "hashes")
    if workers is not None:
        whole_of(workers, "workers", 1, 1024)
    start = perf_counter()
    description = open_data_set(root)
    with RecordIndex() as record_index:
        data_set = checks.OpenDataSet(root, description, record_index)
        verifier = _Verifier(data_set, workers, progress or Silent())
        verifier.notes += filter(None, [previous_note(root)])
        _check_files(verifier, hashes)
        _check_descriptions(verifier)
        for name, holds, looked_at, found in check_frames(root, description, workers, verifier.progress):
            verifier.run(name, holds, looked_at, found)
        if labels:
            _check_labels(verifier)
        if rerender:
            holds = "images rendered again have the same bytes"
            renders = check_renders(root, description, rerender, seed, verifier.progress, verifier.notes.append)
            verifier.run("renders", holds, min(rerender, int(description["images"])), renders)
        listed = sum(1 for _ in record_index.files())
    return VerificationReport(
        int(description["images"]),
        int(description["frames"]),
        listed,
        tuple(verifier.checks),
        tuple(verifier.findings),
        tuple(verifier.notes),
        perf_counter() - start,
    )


def open_data_set(root: Path) -> dict[str, Any]:
    """dataset.json of a finished data set.

    Raises `RecipeError`: the folder holds something else: what it seems to be, and what to do.
    Raises `DatasetError`: dataset.json is damaged.
    """
    refuse_address(root)
    check_folder(root, "a folder that forestgen render or batch made")
    content, hint = root / DATASET_NAME, None
    if os.path.lexists(content):
        try:
            return read_description(SafePath(root, DATASET_NAME).read(), str(content))
        except OSError as error:
            raise unreadable(content, error) from error
    if (root.parent / DATASET_NAME).is_file():
        got, hint = "a part of a data set", f"name {root.parent}"
    elif is_run_folder(root):
        got = "a split without its data set, or the output of forestgen simulate or calibrate"
        hint = f"name the folder that has {DATASET_NAME}"
    elif (root / BATCH).is_file() or (root / JOBS).is_dir() or previous_note(root):
        got, hint = "a data set that is not finished", "the command that began it, with `resume=True`"
    else:
        inside = sorted(path.parent.name for path in root.glob(f"*/{DATASET_NAME}"))
        got = f"a folder of data sets, such as {inside[0]}" if inside else "no forestgen output"
        hint = f"name {root / inside[0]}" if inside else None
    hint = "; ".join(filter(None, [hint, previous_note(root)])) or None
    raise RecipeError("this is no data set of forestgen", where=str(root), expected=DATASET_NAME, got=got, hint=hint)


def refuse_address(path: Path) -> None:
    """Raise `RecipeError` for the address of an object store, which is no folder of this machine."""
    if is_address(path):
        problem, where = "this is the address of an object store", str(path).replace(":/", "://", 1)
        hint = "work on a copy of the data set on this machine, with the folder .forestgen in it"
        raise RecipeError(problem, where=where, expected="a folder of this machine", hint=hint)


def _check_files(verifier: _Verifier, hashes: bool) -> None:
    """Enter the listed files and those that are there, and compare them."""
    root, record_index = verifier.data_set.root, verifier.data_set.record_index
    record_index.note_found(checks.found(root))
    refused: list[Finding] = []
    is_listed = checks.enter_sums(root, record_index, refused)
    if not is_listed:
        checks.enter_other_sums(root, record_index, verifier.data_set.description["splits"])
    count = sum(1 for _ in record_index.files())
    changed = checks.changed(root, record_index, verifier.workers, verifier.progress) if hashes else ()
    found = chain(refused, checks.lost(record_index), changed)
    verifier.run("sums", "files are those that SHA256SUMS lists", max(count, 1), found)
    unlisted = checks.unlisted(record_index, verifier.notes.append) if is_listed else ()
    verifier.run("listing", "nothing else lies in the folder", count, chain(unlisted, checks.empty_folders(root)))


def _check_descriptions(verifier: _Verifier) -> None:
    """The files that describe others; records where they are: a copy of the data set may do without them."""
    data_set, description = verifier.data_set, verifier.data_set.description
    is_complete = not any(check.found for check in verifier.checks)
    missing = sum(last - first + 1 for recipe in description["recipes"] for first, last in recipe.get("missing", ()))
    if missing:
        verifier.notes.append(
            f"of the images that the recipes ask for, {missing:,} {'is' if missing == 1 else 'are'} missing"
        )
    if LocalStorage(data_set.root).names(JOBS) or not description["images"]:
        verifier.run(
            "records", "images' records agree with the files", description["images"], checks.record_findings(data_set)
        )
    else:
        note = f"there are no records in {JOBS}: this copy can be verified, but neither resumed nor merged"
        verifier.notes.append(note)
    verifier.run("index", "it has a row for each frame", description["frames"], checks.index_findings(data_set))
    manifests = chain.from_iterable(checks.manifest_findings(data_set, split) for split in description["splits"])
    groups = checks.group_findings(data_set) if is_complete else ()
    holds = "they list the files, the recipes and the seeds"
    verifier.run("manifests", holds, len(description["splits"]), chain(manifests, groups))
    verifier.run("recipes", "recipes have their hashes", len(description["recipes"]), checks.recipe_findings(data_set))


def _check_labels(verifier: _Verifier) -> None:
    """Labels of each split; the sums are compared already. A format that is broken raises `RecipeError`."""
    root, description = verifier.data_set.root, verifier.data_set.description
    for name in settings_of(description).formats:
        if name in DATASET_FORMATS:
            DATASET_FORMATS.load(name)
        else:
            note = f"labels of the format {name} are not checked: no format of that name is registered here"
            verifier.notes.append(note)
    for split, counts in description["splits"].items():
        name, holds = f"labels {split}", "labels are true to each other"
        if not SafePath(root, split).is_folder():
            finding = Finding(split, "the split is no folder of the data set", "a folder, and no link")
            verifier.run(name, holds, counts["frames"], [finding])
            continue
        try:
            report = check_dataset(root / split, jobs=verifier.workers, progress=verifier.progress)
        except ForestgenError as error:
            finding = Finding(split, error.problem, error.expected or "", error.got or "")
            verifier.run(name, holds, counts["frames"], [finding])
            continue
        found = (
            replace(one, file=f"{split}/{one.file}", problem=f"{one.problem} (check {one.check!r})")
            for one in report.findings
        )
        verifier.run(name, holds, counts["frames"], found, math.inf, report.found - len(report.findings))
