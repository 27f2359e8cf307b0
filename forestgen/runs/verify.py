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

Files that other tools leave in the folder (forestgen/dataset/foreign.py) are a note.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from forestgen.core.arguments import MOST_SEEDS, whole_of
from forestgen.core.errors import DatasetError, ForestgenError, RecipeError
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.check import MOST_NAMED, CheckResult, Finding, check_dataset
from forestgen.dataset.index import INDEX_NAME, read_index
from forestgen.dataset.manifest import is_run_folder
from forestgen.dataset.safe_path import SafePath, check_folder, is_frame, unreadable
from forestgen.dataset.thumbnails import thumbnail_name
from forestgen.recipe.registries import DATASET_FORMATS
from forestgen.runs import verify_files as files
from forestgen.runs.contract import JobRecord
from forestgen.runs.description import DATASET_NAME, read_description, settings_of
from forestgen.runs.folder import BATCH
from forestgen.runs.ledger import Ledger
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import JOBS, record_path, records_of
from forestgen.runs.replace import previous_note
from forestgen.runs.verify_frames import check_frames, column_findings
from forestgen.runs.verify_manifests import description_findings, group_findings, manifest_findings, recipe_findings
from forestgen.runs.verify_renders import check_renders
from forestgen.runs.verify_report import VerificationReport


class _Verifier:
    """What the checks share, and what they found."""

    def __init__(
        self, root: Path, ledger: Ledger, said: dict[str, Any], workers: int | None, progress: Progress
    ) -> None:
        self.root, self.ledger, self.said = root, ledger, said
        self.workers, self.progress = workers, progress
        self.checks: list[CheckResult] = []
        self.findings: list[Finding] = []
        self.notes: list[str] = []
        self.seeds: dict[int, int] = {}  # image -> seed, by the index
        self.splits: dict[int, str] = {}  # image -> split, by the index

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


def _unknown_formats(names: Iterable[str]) -> Iterator[str]:
    """Notes on formats that are not registered here; one that is registered and broken raises `RecipeError`."""
    for name in names:
        if name in DATASET_FORMATS:
            DATASET_FORMATS.load(name)
        else:
            yield f"labels of the format {name} are not checked: no format of that name is registered here"


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

    Parameters
    ----------
    rerender : how many images to render again.
    seed : draws these.
    workers : processes and threads that check; by default the cores. No result depends on it.
    hashes : read all files and compare their sums; otherwise only that they are there.
    labels : check the labels of each split.

    Raises
    ------
    RecipeError : the folder is no data set of forestgen, or a number is out of bounds.
    """
    whole_of(rerender, "rerender", 0, 10**9)
    whole_of(seed, "seed", 0, MOST_SEEDS)
    if workers is not None:
        whole_of(workers, "workers", 1, 1024)
    start = perf_counter()
    said = open_data_set(root)
    with TemporaryDirectory(prefix="forestgen-verify-") as scratch, Ledger(Path(scratch)) as ledger:
        verifier = _Verifier(root, ledger, said, workers, progress or Silent())
        verifier.notes += filter(None, [previous_note(root)])
        _check_files(verifier, hashes)
        _check_records(verifier)
        _check_index(verifier)
        _check_manifests(verifier)
        for name, holds, looked_at, found in check_frames(root, said, workers, verifier.progress):
            verifier.run(name, holds, looked_at, found)
        if labels:
            verifier.notes += _unknown_formats(settings_of(said).formats)
            _check_labels(verifier)
        if rerender:
            holds = "images rendered again have the same bytes"
            renders = check_renders(root, said, rerender, seed, verifier.progress, verifier.notes.append)
            verifier.run("renders", holds, min(rerender, int(said["images"])), renders)
        listed = sum(1 for _ in ledger.files())
    return VerificationReport(
        int(said["images"]),
        int(said["frames"]),
        listed,
        tuple(verifier.checks),
        tuple(verifier.findings),
        tuple(verifier.notes),
        perf_counter() - start,
    )


def open_data_set(root: Path) -> dict[str, Any]:
    """dataset.json of a finished data set.

    Raises
    ------
    RecipeError : the folder holds something else: what it seems to be, and what to do.
    DatasetError : dataset.json is damaged.
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
    scheme, separator, _ = str(path).partition(":/")
    if separator and scheme.isalnum() and len(scheme) > 1:  # one letter is a drive of Windows
        raise RecipeError(
            "this is the address of an object store",
            where=str(path).replace(":/", "://", 1),
            expected="a folder of this machine",
            hint="copy the data set here, with what is hidden in it",
        )


def _check_files(verifier: _Verifier, hashes: bool) -> None:
    """Enter the listed files and those that are there, and compare them."""
    root, ledger = verifier.root, verifier.ledger
    ledger.note_found(files.found(root))
    refused: list[Finding] = []
    is_listed = files.enter_sums(root, ledger, refused)
    if not is_listed:
        files.enter_other_sums(root, ledger, verifier.said["splits"])
    count = sum(1 for _ in ledger.files())
    changed = files.changed(root, ledger, verifier.workers, verifier.progress) if hashes else ()
    found = chain(refused, files.lost(ledger), changed)
    verifier.run("sums", "files are those that SHA256SUMS lists", max(count, 1), found)
    strangers = files.strangers(ledger, verifier.notes.append) if is_listed else ()
    verifier.run("listing", "nothing else lies in the folder", count, chain(strangers, files.empty_folders(root)))


def _check_records(verifier: _Verifier) -> None:
    """The records, where they are: a copy of the data set may do without them."""
    place = LocalPlace(verifier.root)
    if not place.names(JOBS):
        verifier.notes.append(
            f"there are no records in {JOBS}: this copy can be verified, but neither resumed nor merged"
        )
        return
    damaged: list[str] = []
    said = verifier.said["images"]
    verifier.run("records", "images' records agree with the files", said, _record_findings(verifier, place, damaged))


def _record_findings(verifier: _Verifier, place: LocalPlace, damaged: list[str]) -> Iterator[Finding]:
    rows = _Rows(verifier.root)
    images = 0
    for record in records_of(place, damaged.append):
        images += 1
        for path, said in record.files.items():
            listed = verifier.ledger.file(path)
            if listed is None or listed.sha256 != said["sha256"]:
                got = "not listed" if listed is None else f"sha256 {listed.sha256}"
                yield Finding(path, "SHA256SUMS and the image's record disagree", f"sha256 {said['sha256']}", got)
        yield from _left_out(verifier.ledger, record)
        for row in record.rows:
            own = rows.take(str(row["frame"]))
            if own is None and rows.is_cut:
                continue  # the index's own check says why
            wrong = [key for key, value in row.items() if own is None or own.get(key) != value]
            for key in wrong[:1] if own is None else wrong:
                got = "no row" if own is None else f"{own.get(key)!r:.80}"
                problem = f"the row of {row['frame']} is not its record's: {key}"
                yield Finding(INDEX_NAME, problem, f"{row[key]!r:.80}", got, image=str(row["frame"]))
    for note in damaged:
        path, _, problem = note.partition(": ")
        yield Finding(path, problem or "the record is damaged")
    if images != verifier.said["images"] and not damaged:
        yield Finding(JOBS, "there is not a record for each image", str(verifier.said["images"]), str(images))
    for name in rows.rest():
        yield Finding(INDEX_NAME, "a row is of no image that has a record", got=name, image=name)


def _left_out(ledger: Ledger, record: JobRecord) -> Iterator[Finding]:
    """Files of an image's frames that its record lacks."""
    for row in record.rows:
        frame = str(row["frame"])
        for path in (*(file.path for file in ledger.files(f"{record.split}/{frame}")), thumbnail_name(frame)):
            if path not in record.files:
                yield Finding(record_path(record.key), f"the record lacks {path}", "its bytes and SHA-256", "none")


class _Rows:
    """Rows of the index by frame, met in the order of images: one at a time in memory where that order holds."""

    def __init__(self, root: Path) -> None:
        self._waiting = read_index(root / INDEX_NAME)
        self._held: dict[str, dict[str, Any]] = {}
        self.is_cut = False  # whether it could not be read to its end

    def take(self, frame: str) -> dict[str, Any] | None:
        """A frame's row, once."""
        try:
            while frame not in self._held and (row := next(self._waiting, None)) is not None:
                self._held[str(row["frame"])] = row
        except DatasetError:
            self.is_cut = True
        return self._held.pop(frame, None)

    def rest(self) -> Iterator[str]:
        """Frames whose rows nobody took."""
        yield from self._held
        with suppress(DatasetError):  # the index's own check says why
            yield from (str(row["frame"]) for row in self._waiting)


def _check_index(verifier: _Verifier) -> None:
    verifier.run("index", "it has a row for each frame", verifier.said["frames"], _index_findings(verifier))


def _index_findings(verifier: _Verifier) -> Iterator[Finding]:
    root, said = verifier.root, verifier.said
    frames: dict[str, set[str]] = {}
    try:
        yield from column_findings(root, said)
        for row in read_index(root / INDEX_NAME):
            yield from _row_findings(verifier, row, frames)
    except (DatasetError, TypeError, ValueError, KeyError) as error:
        yield Finding(INDEX_NAME, "the index cannot be read", got=" ".join(str(error).split())[:200])
        return
    images = {split: sum(1 for own in verifier.splits.values() if own == split) for split in frames}
    for split, counts in said["splits"].items():
        counted = {"images": images.get(split, 0), "frames": len(frames.get(split, ()))}
        if counted != counts:
            yield Finding(DATASET_NAME, f"it counts {split} otherwise than the index", str(counted), str(counts))
    for split in sorted(set(frames) - set(said["splits"])):
        yield Finding(DATASET_NAME, "the index has a split that is not told here", split, "none")
    text = "".join(f"{verifier.seeds[image]}\n" for image in sorted(verifier.seeds))
    digest = hashlib.sha256(text.encode()).hexdigest()
    if digest != said["image_seeds_sha256"]:
        yield Finding(DATASET_NAME, "the images' seeds are not the index'", digest, str(said["image_seeds_sha256"]))
    yield from _frames_without_rows(root, {*frames, *said["splits"]}, frames)
    try:
        yield from description_findings(said, verifier.splits)
    except (KeyError, TypeError, ValueError) as error:
        yield Finding(DATASET_NAME, "the content is not of this format", got=f"{type(error).__name__}: {error}"[:200])


def _row_findings(verifier: _Verifier, row: Mapping[str, Any], frames: dict[str, set[str]]) -> Iterator[Finding]:
    """Enter a row of the index, by split, and what is wrong with it."""
    split, name = str(row["split"]), str(row["frame"])
    if name in frames.setdefault(split, set()):
        yield Finding(INDEX_NAME, "a frame has two rows", "one", "two", image=name)
    frames[split].add(name)
    if row["folder"] != f"{split}/{name}" or not (SafePath(verifier.root, split) / name).is_folder():
        yield Finding(INDEX_NAME, "a row is of a frame that is not there", f"{split}/{name}", image=name)
    if verifier.ledger.file(thumbnail_name(name)) is None:
        yield Finding(thumbnail_name(name), "a frame has no thumbnail in SHA256SUMS", "one", "none", image=name)
    try:
        image, seed = int(row["image"]), int(row["image_seed"])
    except (KeyError, TypeError, ValueError) as error:
        yield Finding(INDEX_NAME, "a row has no image or no seed", "numbers", f"{error}"[:80], image=name)
        return
    first = verifier.seeds.setdefault(image, seed), verifier.splits.setdefault(image, split)
    if first != (seed, split):
        expected = f"{first[0]}, {first[1]}"
        yield Finding(INDEX_NAME, "rows of one image differ in seed or split", expected, f"{seed}, {split}", image=name)


def _frames_without_rows(root: Path, splits: Iterable[str], frames: Mapping[str, set[str]]) -> Iterator[Finding]:
    place = LocalPlace(root)
    for split in sorted(splits):
        for name in place.names(split):
            if is_frame(name) and name not in frames.get(split, ()) and (root / split / name).is_dir():
                yield Finding(f"{split}/{name}", "the index has no row of this frame", "a row", "none", image=name)


def _check_manifests(verifier: _Verifier) -> None:
    root, said, ledger = verifier.root, verifier.said, verifier.ledger
    complete = not any(check.found for check in verifier.checks if check.name in ("sums", "listing"))
    found: list[Iterator[Finding]] = []
    for split in said["splits"]:
        seeds = {image: seed for image, seed in verifier.seeds.items() if verifier.splits[image] == split}
        found.append(manifest_findings(root, split, said, ledger, seeds))
    if complete:
        found.append(group_findings(said, ledger))
    holds = "they list the files, the recipes and the seeds"
    verifier.run("manifests", holds, len(said["splits"]), chain.from_iterable(found))
    verifier.run("recipes", "recipes have their hashes", len(said["recipes"]), recipe_findings(root, said))


def _check_labels(verifier: _Verifier) -> None:
    """Labels of each split; the sums are compared already."""
    for split, counts in verifier.said["splits"].items():
        name, holds = f"labels {split}", "labels are true to each other"
        if not SafePath(verifier.root, split).is_folder():
            finding = Finding(split, "the split is no folder of the data set", "a folder, and no link")
            verifier.run(name, holds, counts["frames"], [finding])
            continue
        try:
            report = check_dataset(
                verifier.root / split, jobs=verifier.workers, hashes=False, most=None, progress=verifier.progress
            )
        except ForestgenError as error:
            finding = Finding(split, error.problem, error.expected or "", error.got or "")
            verifier.run(name, holds, counts["frames"], [finding])
            continue
        found = (
            replace(one, file=f"{split}/{one.file}", problem=f"{one.problem} (check {one.check!r})")
            for one in report.findings
        )
        more = sum(check_result.found for check_result in report.check_results) - len(report.findings)
        verifier.run(name, holds, counts["frames"], found, math.inf, more)
