"""Files against SHA256SUMS, and those that describe others: records, index, dataset.json, manifest.json, recipe."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError, ForestgenError, RecipeError
from forestgen.core.progress import Progress
from forestgen.dataset.card import CARD_NAME
from forestgen.dataset.check.files import MISUNDERSTOOD, Finding, UnreadableError, misunderstood, read_json, read_text
from forestgen.dataset.index import COLUMNS, INDEX_NAME, open_index, read_index
from forestgen.dataset.manifest import MANIFEST_NAME, SUMS_NAME, file_sum, read_sums
from forestgen.dataset.png import thumbnail_name
from forestgen.dataset.safe_path import SafePath, is_frame
from forestgen.dataset.settings import DRAW
from forestgen.recipe.dataset import split_of
from forestgen.recipe.load import load_recipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.recipe.sources import parse_yaml
from forestgen.runs.contract import RUN_DEPENDENT, JobRecord
from forestgen.runs.description import DATASET_NAME, file_groups
from forestgen.runs.folder import tool_of
from forestgen.runs.record_index import FileSum, RecordIndex
from forestgen.runs.records import JOBS, in_order, record_path, records_of
from forestgen.runs.storage import LocalStorage, files_below

_NOT_COUNTED = (DATASET_NAME, INDEX_NAME, CARD_NAME)  # in dataset.json's groups of files: they are written after it

_MOST_IN_A_NOTE = 20


@dataclass
class OpenDataSet:
    """What the checks share."""

    root: Path
    description: dict[str, Any]  # dataset.json
    record_index: RecordIndex  # with the files of SHA256SUMS, and those that are there
    seeds: dict[int, int] = field(default_factory=dict)  # image -> seed, by the index
    splits: dict[int, str] = field(default_factory=dict)  # image -> split, by the index


def record_findings(data_set: OpenDataSet) -> Iterator[Finding]:
    """Where the images' records disagree with SHA256SUMS and the index."""
    rows, damaged = _Rows(data_set.root), list[str]()
    images = 0
    for record in records_of(LocalStorage(data_set.root), damaged.append):
        images += 1
        for path, entry in record.files.items():
            listed = data_set.record_index.file(path)
            if listed is None or listed.sha256 != entry["sha256"]:
                got = "not listed" if listed is None else f"sha256 {listed.sha256}"
                yield Finding(path, "SHA256SUMS and the image's record disagree", f"sha256 {entry['sha256']}", got)
        yield from _left_out(data_set.record_index, record)
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
    if images != data_set.description["images"] and not damaged:
        yield Finding(JOBS, "there is not a record for each image", str(data_set.description["images"]), str(images))
    for name in rows.rest():
        yield Finding(INDEX_NAME, "a row is of no image that has a record", got=name, image=name)


def _left_out(record_index: RecordIndex, record: JobRecord) -> Iterator[Finding]:
    """Files of an image's frames that its record lacks."""
    for row in record.rows:
        frame = str(row["frame"])
        for path in (*(file.path for file in record_index.files(f"{record.split}/{frame}")), thumbnail_name(frame)):
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
        """Frames whose rows are left."""
        yield from self._held
        with suppress(DatasetError):  # the index's own check says why
            yield from (str(row["frame"]) for row in self._waiting)


def index_findings(data_set: OpenDataSet) -> Iterator[Finding]:
    """What is wrong with the index and dataset.json; enters the images' seeds and splits."""
    root, description = data_set.root, data_set.description
    frames: dict[str, set[str]] = {}
    try:
        yield from _column_findings(root, description)
        for row in read_index(root / INDEX_NAME):
            yield from _row_findings(data_set, row, frames)
    except (DatasetError, TypeError, ValueError, KeyError) as error:
        yield Finding(INDEX_NAME, "the index cannot be read", got=" ".join(str(error).split())[:200])
        return
    images = {split: sum(1 for own in data_set.splits.values() if own == split) for split in frames}
    for split, counts in description["splits"].items():
        counted = {"images": images.get(split, 0), "frames": len(frames.get(split, ()))}
        if counted != counts:
            yield Finding(DATASET_NAME, f"it counts {split} otherwise than the index", str(counted), str(counts))
    for split in sorted(set(frames) - set(description["splits"])):
        yield Finding(DATASET_NAME, "the index has a split that dataset.json lacks", split, "none")
    text = "".join(f"{data_set.seeds[image]}\n" for image in sorted(data_set.seeds))
    digest = hashlib.sha256(text.encode()).hexdigest()
    if digest != description["image_seeds_sha256"]:
        yield Finding(
            DATASET_NAME, "the images' seeds are not the index'", digest, str(description["image_seeds_sha256"])
        )
    for split in sorted({*frames, *description["splits"]}):
        for name in LocalStorage(root).names(split):
            if is_frame(name) and name not in frames.get(split, ()) and (root / split / name).is_dir():
                yield Finding(f"{split}/{name}", "the index has no row of this frame", "a row", "none", image=name)
    try:
        yield from _description_findings(description, data_set.splits)
    except (KeyError, TypeError, ValueError) as error:
        yield Finding(DATASET_NAME, "the content is not of this format", got=f"{type(error).__name__}: {error}"[:200])


def _row_findings(data_set: OpenDataSet, row: Mapping[str, Any], frames: dict[str, set[str]]) -> Iterator[Finding]:
    """Enter a row of the index, by split, and what is wrong with it."""
    split, name = str(row["split"]), str(row["frame"])
    if name in frames.setdefault(split, set()):
        yield Finding(INDEX_NAME, "a frame has two rows", "one", "two", image=name)
    frames[split].add(name)
    if row["folder"] != f"{split}/{name}" or not (SafePath(data_set.root, split) / name).is_folder():
        yield Finding(INDEX_NAME, "a row is of a frame that is not there", f"{split}/{name}", image=name)
    if data_set.record_index.file(thumbnail_name(name)) is None:
        yield Finding(thumbnail_name(name), "a frame has no thumbnail in SHA256SUMS", "one", "none", image=name)
    try:
        image, seed = int(row["image"]), int(row["image_seed"])
    except (KeyError, TypeError, ValueError) as error:
        yield Finding(INDEX_NAME, "a row has no image or no seed", "numbers", f"{error}"[:80], image=name)
        return
    first = data_set.seeds.setdefault(image, seed), data_set.splits.setdefault(image, split)
    if first != (seed, split):
        expected = f"{first[0]}, {first[1]}"
        yield Finding(INDEX_NAME, "rows of one image differ in seed or split", expected, f"{seed}, {split}", image=name)


def _column_findings(root: Path, description: Mapping[str, Any]) -> Iterator[Finding]:
    """Columns of the index that no data set of these recipes has."""
    known = {*COLUMNS, *(DRAW + key for recipe in description["recipes"] for key in recipe["draws"])}
    with open_index(root / INDEX_NAME, ()) as file:
        names = file.schema_arrow.names
    for name in names:
        if name not in known:
            yield Finding(INDEX_NAME, "unknown column of the index", "those that forestgen writes", f"{name!r:.80}")


def manifest_findings(data_set: OpenDataSet, split: str) -> Iterator[Finding]:
    """What is wrong in a split's manifest.json."""
    name, record_index = f"{split}/{MANIFEST_NAME}", data_set.record_index
    seeds = [data_set.seeds[image] for image, own in sorted(data_set.splits.items()) if own == split]
    try:
        manifest = read_json(data_set.root, name)
        listed = {f"{split}/{path}": entry["sha256"] for path, entry in manifest["files"].items()}
        recipes = [{"hash": one["hash"], "root_seed": one["root_seed"]} for one in data_set.description["recipes"]]
        wanted = {"split": split, "recipes": recipes, "image_seeds": seeds}
        for key, value in wanted.items():
            if manifest.get(key) != value:
                got = f"{manifest.get(key)!r:.120}"
                yield Finding(name, f"{key} is not the index's or dataset.json's", f"{value!r:.120}", got)
    except UnreadableError as error:
        yield error.finding
        return
    except MISUNDERSTOOD as error:
        yield misunderstood(name, error)
        return
    for path, digest in listed.items():
        known = record_index.file(path)
        if known is None or known.sha256 != digest:
            got = "not listed" if known is None else f"sha256 {known.sha256}"
            yield Finding(path, f"SHA256SUMS and {name} disagree", f"sha256 {digest}", got)
    for file in record_index.files(split):
        if file.path not in listed and file.path != name:
            yield Finding(file.path, f"{name} does not list this file", "its bytes and SHA-256", "none")


def _description_findings(description: Mapping[str, Any], split_of_image: Mapping[int, str]) -> Iterator[Finding]:
    """What is wrong in dataset.json, by the splits of the index' images."""
    for key in ("images", "frames"):
        total = sum(int(counts[key]) for counts in description["splits"].values())
        if description[key] != total:
            yield Finding(DATASET_NAME, f"{key} is not the sum over the splits", str(total), str(description[key]))
    made = dict.fromkeys(range(len(description["recipes"])), 0)
    for image, split in split_of_image.items():
        holds = (any(first <= image <= last for first, last in one["asked"]) for one in description["recipes"])
        number = next((at for at, held in enumerate(holds) if held), None)
        if number is None:
            yield Finding(DATASET_NAME, f"image {image} of the index is of no recipe", "one that asked for it", "none")
            continue
        made[number] += 1
        shares = description["recipes"][number]["splits"]
        if shares and split_of(shares, image) != split:
            problem = f"image {image} is in another split than its number gives"
            yield Finding(INDEX_NAME, problem, split_of(shares, image), split, image=str(image))
    for number, count in made.items():
        one = description["recipes"][number]
        asked, missing = (sum(last - first + 1 for first, last in one[key]) for key in ("asked", "missing"))
        if (one["images"], missing) != (asked, asked - count):
            expected, got = f"{asked} asked, {asked - count} missing", f"{one['images']} asked, {missing} missing"
            yield Finding(DATASET_NAME, f"recipes[{number}] counts its images wrongly", expected, got)


def group_findings(data_set: OpenDataSet) -> Iterator[Finding]:
    """Kinds of files that dataset.json counts otherwise; of a data set in which no file is missing or added."""
    noted = data_set.description["files"]
    there = file_groups(file for file in data_set.record_index.present() if file.path not in _NOT_COUNTED)
    for group in sorted({*there, *noted}):
        if there.get(group) != noted.get(group):
            expected, got = str(there.get(group)), str(noted.get(group))
            yield Finding(DATASET_NAME, f"files: {group} is counted wrongly", expected, got)


def recipe_findings(data_set: OpenDataSet) -> Iterator[Finding]:
    """Recipes of the whole data set that do not have the hash of dataset.json."""
    for one in data_set.description["recipes"]:
        file = str(one["file"])
        try:
            content = plain_yaml(read_text(data_set.root, file), file)
            digest = _identity(content)
            if digest != one["hash"]:  # maps that are drawn from a list have no sums in the file: the loader adds them
                digest = _identity(load_recipe(data_set.root / file).complete)
        except UnreadableError as error:
            yield error.finding
        except ForestgenError as error:
            yield Finding(
                file, "the recipe has changed, and cannot be loaded", one["hash"], " ".join(str(error).split())
            )
        else:
            if digest != one["hash"]:
                yield Finding(file, "the recipe is not the one that dataset.json names", one["hash"], digest)


def plain_yaml(text: str, name: str) -> dict[str, Any]:
    """A recipe's content, within the limits of `parse_yaml` but without the loader's checks of keys.

    Raises `UnreadableError` if it is no mapping.
    """
    try:
        content, _ = parse_yaml(text, name, lines=False)
    except RecipeError as error:
        got = " ".join(str(error).split())[:200]
        raise UnreadableError(Finding(name, "the file cannot be read", got=got)) from error
    if not isinstance(content, dict):
        raise UnreadableError(Finding(name, "this is no recipe", expected="a mapping"))
    return content


def _identity(complete: Mapping[str, Any]) -> str:
    return recipe_hash({key: value for key, value in complete.items() if key not in ("images", "first_image")})


def found(root: Path) -> Iterator[tuple[str, int, int]]:
    """What lies in the folder and belongs to the data set."""
    for name in sorted(path.name for path in root.iterdir()):
        if name in RUN_DEPENDENT or name == SUMS_NAME:
            continue
        if SafePath(root, name).is_folder():
            yield from files_below(root, name)
        else:
            yield name, (root / name).lstat().st_size, 0


def enter_sums(root: Path, record_index: RecordIndex, refused: list[Finding]) -> bool:
    """Enter the lines of SHA256SUMS, and in `refused` what is wrong with it; whether all of it could be read."""

    def refuse(error: DatasetError) -> None:
        line = (error.where or "").rpartition(":")[2]
        refused.append(Finding(SUMS_NAME, f"line {line}: {error.problem}", error.expected or "", error.got or ""))

    try:
        for path, digest in read_sums(root / SUMS_NAME, refuse):
            try:
                record_index.add_file(FileSum(path, 0, digest))
            except DatasetError:
                refused.append(Finding(SUMS_NAME, f"{path} is listed twice, with different sums"))
    except DatasetError as error:
        refused.append(Finding(SUMS_NAME, error.problem, error.expected or "", error.got or error.where or ""))
        return False
    return True


def enter_records(root: Path, record_index: RecordIndex) -> set[str]:
    """Enter the sums of the images' records; the splits that have images."""
    splits = set()
    for record in records_of(LocalStorage(root)):
        splits.add(record.split)
        for path, entry in record.files.items():
            with suppress(DatasetError):  # two records, or a record and SHA256SUMS, disagree: a check names it
                record_index.add_file(FileSum(path, 0, str(entry["sha256"])))
    return splits


def enter_other_sums(root: Path, record_index: RecordIndex, splits: Iterable[str]) -> None:
    """Where SHA256SUMS cannot be read: enter the sums of the records and of the splits' manifests."""
    enter_records(root, record_index)
    for split in splits:
        with suppress(UnreadableError, KeyError, TypeError, AttributeError, DatasetError):
            for path, entry in read_json(root, f"{split}/{MANIFEST_NAME}")["files"].items():
                record_index.add_file(FileSum(f"{split}/{path}", 0, str(entry["sha256"])))


def lost(record_index: RecordIndex) -> Iterator[Finding]:
    """Listed files that are not there."""
    for path in record_index.lost():
        yield Finding(path, "the file is missing", "a file, as SHA256SUMS lists it", "none")


def changed(root: Path, record_index: RecordIndex, threads: int | None, progress: Progress) -> Iterator[Finding]:
    """Listed files that are there with another sum."""
    count = sum(1 for _ in record_index.present())
    with ThreadPoolExecutor(threads) as pool, progress.stage("sums", count) as advance:
        for finding in in_order(pool, partial(_sum_finding, root), record_index.present()):
            advance(1)
            if finding is not None:
                yield finding


def _sum_finding(root: Path, file: FileSum) -> Finding | None:
    try:
        digest = file_sum(SafePath(root, file.path))
    except OSError as error:
        return Finding(file.path, "the file cannot be read", got=error.strerror or str(error))
    if digest == file.sha256:
        return None
    return Finding(file.path, "the file has changed since it was made", f"sha256 {file.sha256}", f"sha256 {digest}")


def unlisted(record_index: RecordIndex, note: Callable[[str], None]) -> Iterator[Finding]:
    """Files that SHA256SUMS does not list; those of other tools are a note."""
    foreign: list[str] = []
    count = 0
    for path in record_index.unlisted():
        tool = tool_of(path)
        if tool is None:
            yield Finding(path, "SHA256SUMS does not list this file", "nothing")
            continue
        count += 1
        if count <= _MOST_IN_A_NOTE:
            foreign.append(f"{path} ({tool})")
    if foreign:
        more = f" and {count - len(foreign):,} more" if count > len(foreign) else ""
        note(f"files of other tools are left out: {', '.join(foreign)}{more}")


def empty_folders(root: Path) -> Iterator[Finding]:
    """Folders without a file, the topmost of each."""
    filled: set[Path] = set()
    empty: list[Path] = []
    for name, folders, names in os.walk(root, topdown=False):
        folder = Path(name)
        if names or any(folder / one in filled or (folder / one).is_symlink() for one in folders):
            filled.add(folder)
        else:
            empty.append(folder)
    for folder in sorted(empty):
        path = folder.relative_to(root)
        is_top = folder.parent in filled
        if is_top and path.parts and path.parts[0] not in RUN_DEPENDENT and tool_of(path.as_posix()) is None:
            yield Finding(path.as_posix(), "this folder is empty", "no such folder")
