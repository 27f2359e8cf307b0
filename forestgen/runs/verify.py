"""Whether a data set is what its records say, from the sums of its files to the plants of its splits.

The checks, in their order:

| check | holds if |
|---|---|
| sums | every file that SHA256SUMS lists is there and has its bytes |
| listing | nothing else lies in the data set's folder, but run/, report.html and .forestgen/ |
| records | the records of the images say the same sums and rows |
| index | it has the frames that are there, and dataset.json counts them right |
| frames | the index tells of each frame what its files show |
| seeds | no image's seed is in two splits |
| communities | no plant community, by species and places of its plants, is in two splits |
| labels SPLIT | `forestgen labels check` accepts the split |
| renders | images that are rendered again have the same bytes |
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from forestgen.core.errors import DatasetError, ForestgenError, RecipeError
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.check import Offence, Tally, check_dataset
from forestgen.dataset.checksums import SUMS_NAME, file_sum, read_sums
from forestgen.dataset.index import INDEX_NAME, read_index
from forestgen.dataset.manifest import is_run_folder
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.runs.contract import RUN_DEPENDENT
from forestgen.runs.description import DATASET_NAME, read_description
from forestgen.runs.finish import files_below
from forestgen.runs.ledger import FileSum, Ledger
from forestgen.runs.parallel import in_order
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import JOBS, records_of
from forestgen.runs.verify_frames import check_frames
from forestgen.runs.verify_renders import check_renders

MOST_OFFENCES = 10  # that one check names


@dataclass(frozen=True)
class Verdict:
    """What the checks found."""

    images: int
    frames: int
    files: int
    tallies: tuple[Tally, ...]  # by check; `images` counts what it looked at
    offences: tuple[Offence, ...]
    notes: tuple[str, ...]
    seconds: float


class _Verifier:
    """What the checks share, and what they found."""

    def __init__(self, root: Path, ledger: Ledger, said: dict[str, Any], jobs: int | None, progress: Progress) -> None:
        self.root, self.ledger, self.said = root, ledger, said
        self.jobs, self.progress = jobs, progress
        self.tallies: list[Tally] = []
        self.offences: list[Offence] = []
        self.notes: list[str] = []

    def run(self, name: str, holds: str, looked_at: int, found: Iterable[Offence]) -> None:
        """Take the first offences of a check."""
        own = [replace(one, check=name) for one in islice(found, MOST_OFFENCES)]
        self.offences += own
        self.tallies.append(Tally(name, holds, looked_at, max(0, looked_at - len(own))))


def verify(
    root: Path,
    *,
    rerender: int = 0,
    seed: int = 0,
    jobs: int | None = None,
    hashes: bool = True,
    labels: bool = True,
    progress: Progress | None = None,
) -> Verdict:
    """Check a data set's folder.

    Parameters
    ----------
    rerender : how many images to render again.
    seed : draws these.
    jobs : processes and threads that check; by default the cores. No result depends on it.
    hashes : read all files and compare their sums; otherwise only that they are there.
    labels : check the labels of each split.

    Raises
    ------
    RecipeError : the folder is no data set of `forestgen batch`.
    """
    start = perf_counter()
    said = open_data_set(root)
    with TemporaryDirectory(prefix="forestgen-verify-") as scratch, Ledger(Path(scratch)) as ledger:
        verifier = _Verifier(root, ledger, said, jobs, progress or Silent())
        _check_files(verifier, hashes)
        _check_records(verifier)
        _check_index(verifier)
        for name, holds, looked_at, found in check_frames(root, said, jobs, verifier.progress):
            verifier.run(name, holds, looked_at, found)
        if labels:
            _check_labels(verifier)
        if rerender:
            holds = "images rendered again have the same bytes"
            renders = check_renders(root, said, rerender, seed, verifier.progress, verifier.notes.append)
            verifier.run("renders", holds, min(rerender, int(said["images"])), renders)
        files = sum(1 for _ in ledger.files())
    return Verdict(
        int(said["images"]),
        int(said["frames"]),
        files,
        tuple(verifier.tallies),
        tuple(verifier.offences),
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
    if not root.is_dir():
        problem = "this is a file" if root.exists() else "there is no such folder"
        raise RecipeError(problem, where=str(root), expected="a folder that forestgen batch made")
    content, hint = root / DATASET_NAME, None
    if os.path.lexists(content):
        try:
            return read_description(SafePath(root, DATASET_NAME).read(), str(content))
        except OSError as error:
            raise unreadable(content, error) from error
    if (root.parent / DATASET_NAME).is_file():
        got, hint = "a part of a data set", f"name {root.parent}"
    elif is_run_folder(root):
        got, hint = "the output of forestgen render", f"forestgen labels check {root}"
    elif (root / JOBS).is_dir():
        got, hint = "a batch that is not finished", "the command that began it, with --resume"
    else:
        inside = sorted(path.parent.name for path in root.glob(f"*/{DATASET_NAME}"))
        got = f"a folder of data sets, such as {inside[0]}" if inside else "no forestgen output"
        hint = f"name {root / inside[0]}" if inside else None
    raise RecipeError(
        "this is no data set of forestgen batch", where=str(root), expected=DATASET_NAME, got=got, hint=hint
    )


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
    ledger.note_found(_found(root))
    try:
        for path, digest in read_sums(root / SUMS_NAME):
            ledger.add_file(FileSum(path, 0, digest))
    except DatasetError as error:
        offence = Offence(SUMS_NAME, error.problem, error.expected or "", error.got or error.where or "")
        verifier.run("sums", "files have their SHA-256", 1, [offence])
        return
    count = sum(1 for _ in ledger.files())
    lost = (Offence(path, "the file is missing", "a file, as SHA256SUMS lists it", "none") for path in ledger.lost())
    verifier.run(
        "sums",
        "files are those that SHA256SUMS lists",
        count,
        [*islice(lost, MOST_OFFENCES)] or _sums(verifier, hashes),
    )
    strangers = (Offence(path, "SHA256SUMS does not list this file", "nothing") for path in ledger.strangers())
    verifier.run("listing", "nothing else lies in the folder", count, strangers)


def _found(root: Path) -> Iterator[tuple[str, int, int]]:
    """What lies in the folder and belongs to the data set."""
    for name in sorted(path.name for path in root.iterdir()):
        if name in RUN_DEPENDENT or name == SUMS_NAME:
            continue
        if SafePath(root, name).is_folder():
            yield from files_below(root, name)
        else:
            yield name, (root / name).lstat().st_size, 0


def _sums(verifier: _Verifier, hashes: bool) -> Iterator[Offence]:
    if not hashes:
        return
    count = sum(1 for _ in verifier.ledger.files())
    with ThreadPoolExecutor(verifier.jobs) as pool, verifier.progress.stage("sums", count) as advance:
        tasks = ((file, verifier.root) for file in verifier.ledger.files())
        for offence in in_order(pool, _sum_offence, tasks):
            advance(1)
            if offence is not None:
                yield offence


def _sum_offence(task: tuple[FileSum, Path]) -> Offence | None:
    file, root = task
    try:
        digest = file_sum(SafePath(root, file.path))
    except OSError as error:
        return Offence(file.path, "the file cannot be read", got=error.strerror or str(error))
    if digest == file.sha256:
        return None
    return Offence(file.path, "the file has changed since it was made", f"sha256 {file.sha256}", f"sha256 {digest}")


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
    verifier.run("records", "images' records agree with the files", said, _record_offences(verifier, place, damaged))


def _record_offences(verifier: _Verifier, place: LocalPlace, damaged: list[str]) -> Iterator[Offence]:
    rows = _Rows(verifier.root)
    images = 0
    for record in records_of(place, damaged.append):
        images += 1
        for path, said in record.files.items():
            listed = verifier.ledger.file(path)
            if listed is None or listed.sha256 != said["sha256"]:
                got = "not listed" if listed is None else f"sha256 {listed.sha256}"
                yield Offence(path, "SHA256SUMS and the image's record disagree", f"sha256 {said['sha256']}", got)
        for row in record.rows:
            own = rows.take(str(row["frame"]))
            wrong = [key for key, value in row.items() if own is None or own.get(key) != value]
            if wrong:
                got = "no row" if own is None else f"{own.get(wrong[0])!r:.80}"
                problem = f"the row of {row['frame']} is not its record's: {wrong[0]}"
                yield Offence(INDEX_NAME, problem, f"{row[wrong[0]]!r:.80}", got, image=str(row["frame"]))
    for note in damaged:
        path, _, problem = note.partition(": ")
        yield Offence(path, problem or "the record is damaged")
    if images != verifier.said["images"] and not damaged:
        yield Offence(JOBS, "there is not a record for each image", str(verifier.said["images"]), str(images))
    for name in rows.rest():
        yield Offence(INDEX_NAME, "a row is of no image that has a record", got=name, image=name)


class _Rows:
    """Rows of the index by frame, met in the order of images: one at a time in memory where that order holds."""

    def __init__(self, root: Path) -> None:
        self._waiting = read_index(root / INDEX_NAME)
        self._held: dict[str, dict[str, Any]] = {}

    def take(self, frame: str) -> dict[str, Any] | None:
        """A frame's row, once."""
        try:
            while frame not in self._held and (row := next(self._waiting, None)) is not None:
                self._held[str(row["frame"])] = row
        except DatasetError:
            return None
        return self._held.pop(frame, None)

    def rest(self) -> Iterator[str]:
        """Frames whose rows nobody took."""
        yield from self._held
        try:
            yield from (str(row["frame"]) for row in self._waiting)
        except DatasetError as error:
            yield error.problem


def _check_index(verifier: _Verifier) -> None:
    verifier.run("index", "it has a row for each frame", verifier.said["frames"], _index_offences(verifier))


def _index_offences(verifier: _Verifier) -> Iterator[Offence]:
    root, said = verifier.root, verifier.said
    images: dict[str, set[int]] = {}
    frames: dict[str, int] = {}
    seeds: dict[int, int] = {}
    split_of: dict[int, str] = {}
    try:
        for row in read_index(root / INDEX_NAME):
            split, name = str(row["split"]), str(row["frame"])
            images.setdefault(split, set()).add(int(row["image"]))
            frames[split] = frames.get(split, 0) + 1
            image, seed = int(row["image"]), int(row["image_seed"])
            if seeds.setdefault(image, seed) != seed or split_of.setdefault(image, split) != split:
                expected, got = f"{seeds[image]}, {split_of[image]}", f"{seed}, {split}"
                yield Offence(INDEX_NAME, "rows of one image differ in seed or split", expected, got, image=name)
            if row["folder"] != f"{split}/{name}" or not (SafePath(root, split) / name).is_folder():
                yield Offence(INDEX_NAME, "a row is of a frame that is not there", f"{split}/{name}", image=name)
    except (DatasetError, TypeError, ValueError, KeyError) as error:
        yield Offence(INDEX_NAME, "the index cannot be read", got=" ".join(str(error).split())[:200])
        return
    for split, counts in said["splits"].items():
        counted = {"images": len(images.get(split, ())), "frames": frames.get(split, 0)}
        if counted != counts:
            yield Offence(DATASET_NAME, f"it counts {split} otherwise than the index", str(counted), str(counts))
    for split in sorted(set(images) - set(said["splits"])):
        yield Offence(DATASET_NAME, "the index has a split that is not told here", split, "none")
    text = "".join(f"{seeds[image]}\n" for image in sorted(seeds))
    digest = hashlib.sha256(text.encode()).hexdigest()
    if digest != said["image_seeds_sha256"]:
        yield Offence(DATASET_NAME, "the images' seeds are not the index'", digest, str(said["image_seeds_sha256"]))


def _check_labels(verifier: _Verifier) -> None:
    for split, counts in verifier.said["splits"].items():
        verifier.run(
            f"labels {split}", "labels are true to each other", counts["frames"], _label_offences(verifier, split)
        )


def _label_offences(verifier: _Verifier, split: str) -> Iterator[Offence]:
    """The sums are compared already."""
    if not SafePath(verifier.root, split).is_folder():
        yield Offence(split, "the split is no folder of the data set", "a folder, and no link")
        return
    try:
        report = check_dataset(
            verifier.root / split,
            jobs=verifier.jobs,
            hashes=False,
            most=MOST_OFFENCES,
            progress=verifier.progress,
        )
    except ForestgenError as error:
        yield Offence(split, error.problem, error.expected or "", error.got or "")
        return
    for one in report.offences:
        yield replace(one, file=f"{split}/{one.file}", problem=f"{one.problem} (check {one.check!r})")
