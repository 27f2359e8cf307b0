"""The files over all images, from the records: what a run writes when its jobs are done.

`finish` gives the same bytes for the same jobs and records, whatever their order and however often it is called. It
opens no frame's file but the shares of merged formats, and holds one record in memory at a time.

Formats are merged in a staging folder that shows the split's frames: links to their folders; of frames in an object
store copies of what merging reads, and empty files for pictures that it only places. So nothing half-merged is ever
under a final name, and a picture that a format places is known by its inode: its sum is in the frame's record.
"""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from forestgen.core.errors import DatasetError
from forestgen.dataset.card import CARD_NAME, CardCounts, card_text
from forestgen.dataset.files import disk_errors
from forestgen.dataset.formats.format import json_text, known_formats, load_formats, whole_file
from forestgen.dataset.index import INDEX_NAME, DrawTypes, write_index
from forestgen.dataset.manifest import MANIFEST_NAME, SUMS_NAME, file_sum, write_sums
from forestgen.dataset.manifest import SCHEMA as MANIFEST_SCHEMA
from forestgen.dataset.png import THUMBNAILS
from forestgen.dataset.safe_path import SafePath, is_frame
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.writer import write_dataset, write_map
from forestgen.recipe.assets import MAPS
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.map_files import is_map_file, recipe_hash
from forestgen.recipe.sources import dotted, yaml_text
from forestgen.runs.contract import Job, JobRecord, StorageBackend
from forestgen.runs.description import (
    DATASET_NAME,
    Range,
    RecipePart,
    dataset_bytes,
    describe,
    numbers_in,
    ranges_of,
    read_description,
    settings_of,
    this_version,
)
from forestgen.runs.folder import note_written, tool_of
from forestgen.runs.record_index import FileSum, RecordIndex
from forestgen.runs.records import JOBS, record_path
from forestgen.runs.storage import LocalStorage

_READ = (".json", ".txt")  # endings of what merging reads of a frame; it only places the rest


@dataclass(frozen=True)
class Finished:
    """What a data set holds."""

    frames: int
    bytes: int  # of all files that SHA256SUMS lists
    missing: tuple[int, ...]  # images that were asked for and are not there
    notes: tuple[str, ...]  # for people


def finish(
    storage: StorageBackend,
    loaded: LoadedRecipe,
    settings: DatasetSettings,
    jobs: Sequence[Job],
    records: Iterable[JobRecord],
) -> Finished:
    """Write each split's merged files, and those of the whole data set.

    `jobs`: the images of the data set. Frames and records of no job of these are removed.
    `records`: of finished jobs, in any order; those of other jobs do not count. An image whose files are not all there
    in their sizes loses its record, so that the next run makes it again.

    Raises `OutputError`: a file cannot be written, or a frame's share of a format is damaged.
    Raises `DatasetError`: two records contradict each other.
    """
    part = recipe_part(loaded, ranges_of(sorted(job.image for job in jobs)))
    wanted = {job.key for job in jobs}
    splits = {job.split for job in jobs}
    with RecordIndex() as record_index:
        for record in records:
            if record.key in wanted:
                record_index.add(record)
        return write_data_set(storage, record_index, [part], settings, [this_version()], splits)


@disk_errors()
def write_data_set(
    storage: StorageBackend,
    record_index: RecordIndex,
    parts: Sequence[RecipePart],
    settings: DatasetSettings,
    made_with: Sequence[Mapping[str, Any]],
    splits: Iterable[str],
) -> Finished:
    """Write all that is not an image's own.

    `record_index`: with the records of the images.
    `parts`, `made_with`: see `describe`.
    `splits`: whose folders may hold files that no record lists.
    """
    before = set[str]()  # the splits when it was last finished: another recipe may have had others
    with suppress(DatasetError):
        before.update(read_description(storage.read(DATASET_NAME), storage.name)["splits"])
    folders = sorted({*splits, *record_index.splits, *before, THUMBNAILS, MAPS})
    for folder in folders:
        record_index.note_found(storage.found(folder))
    notes = []
    for image, key, path in record_index.drop_absent():  # without its record, the next run makes the image again
        notes.append(f"image {image} counts as missing: {path} is not as it was written; a resumed run makes it again")
        storage.remove(record_path(key))
    for split in record_index.splits:
        write_split(storage, split, record_index, settings, parts, dict(made_with[0]))
    kept = {path: content for number, part in enumerate(parts, start=1) for path, content in part.kept_as(number)}
    for one in load_formats(settings.formats):
        kept |= one.split_files(list(record_index.splits), settings)
    known = {path for one in known_formats() for path in one.split_file_names}
    for path in known - kept.keys():
        storage.remove(path)
    for path, content in kept.items():
        _enter(record_index, path, content)
    _remove_unlisted(storage, folders, record_index)
    description = describe(record_index, parts, settings, made_with)
    _write_whole(storage, record_index, kept, description)
    missing = tuple(image for one in description["recipes"] for image in numbers_in(one["missing"]))
    if missing:
        are = "image is" if len(missing) == 1 else "images are"
        shown = [f"{first}-{last}" if last > first else f"{first}" for first, last in ranges_of(missing)]
        notes.append(f"{len(missing)} {are} missing: {', '.join(shown[:8])}{', ...' if len(shown) > 8 else ''}")
    total = sum(file.bytes for file in record_index.files())
    return Finished(int(description["frames"]), total, missing, tuple(notes))


def recipe_part(loaded: LoadedRecipe, asked: Sequence[Range]) -> RecipePart:
    """A recipe with its maps, as the data set keeps it.

    Raises `AssetError`: a map has changed since the recipe was loaded.
    """
    data, home = copy.deepcopy(loaded.complete), loaded.path.parent
    identity = recipe_hash({key: value for key, value in data.items() if key not in ("images", "first_image")})
    with TemporaryDirectory(prefix="forestgen-maps-") as folder:
        _store_maps(data, home, Path(folder))
        found = sorted(Path(folder, MAPS).glob("*"))
        maps = {f"{MAPS}/{path.name}": path.read_bytes() for path in found}
    draws = {dotted(keys): written for keys, written in loaded.written.items()}
    return RecipePart(identity, loaded.seed, tuple(asked), dict(loaded.splits), draws, yaml_text(data), maps)


def _store_maps(value: Any, home: Path, folder: Path) -> None:
    """Write the maps that a recipe's data name, and name them by where the data set keeps them."""
    if isinstance(value, dict):
        if is_map_file(value):
            value["file"] = f"{MAPS}/{write_map(folder, value, home)}"
            return
        for key, item in value.items():
            if isinstance(item, list) and item and all(map(is_map_file, item)):
                # A distribution's choices: names alone, to which the loader adds the sums again.
                value[key] = [f"{MAPS}/{write_map(folder, one, home)}" for one in item]
            else:
                _store_maps(item, home, folder)
    elif isinstance(value, list):
        for item in value:
            _store_maps(item, home, folder)


def _remove_unlisted(storage: StorageBackend, folders: Sequence[str], record_index: RecordIndex) -> None:
    """Remove what no record lists: records of other jobs, then files; a whole folder where all of it goes.

    Files that other tools have added stay in folders that stay.
    """
    for name in storage.names(JOBS):
        if not record_index.has_key(name.removesuffix(".json")):
            storage.remove(f"{JOBS}/{name}")
    removed = ""
    for path in record_index.unlisted():
        if removed and path.startswith(f"{removed}/"):
            continue
        parts = path.split("/")
        above = ("/".join(parts[:depth]) for depth in range(1, len(parts)))
        gone = next((folder for folder in above if not record_index.has_below(folder)), path)
        if tool_of(path) is not None and (gone == path or not is_frame(gone.rpartition("/")[2])):
            continue
        removed = gone
        storage.remove(removed)
    if isinstance(storage, LocalStorage):
        _remove_empty_folders(storage.root, folders)


def _remove_empty_folders(root: Path, folders: Sequence[str]) -> None:
    """Of frames that never came to a file, and of splits that have no images any more."""
    for folder in filter(lambda name: SafePath(root, name).is_folder(), folders):
        for name in SafePath(root, folder).names():
            if tool_of(name) is None:
                with suppress(OSError):  # it is a file, or not empty
                    (root / folder / name).rmdir()
        with suppress(OSError):
            (root / folder).rmdir()


def _write_whole(
    storage: StorageBackend, record_index: RecordIndex, kept: Mapping[str, bytes], description: dict[str, Any]
) -> None:
    """The files of the whole data set; dataset.json comes last, and says that all others are there."""
    note_written(storage, kept)
    for path, content in kept.items():
        storage.write(path, content)
    staging = storage.staging()
    try:
        types, counts = DrawTypes(), CardCounts()
        for row in record_index.rows():
            types.add(row)
            counts.add(row)
        index, sums = staging / INDEX_NAME, staging / SUMS_NAME
        write_index(index, record_index.rows(), types.columns)
        record_index.add_file(FileSum(INDEX_NAME, index.stat().st_size, file_sum(index)))
        storage.put_file(index, INDEX_NAME)
        card = card_text(description, counts, settings_of(description)).encode()
        _enter(record_index, CARD_NAME, card)
        storage.write(CARD_NAME, card)
        _enter(record_index, DATASET_NAME, dataset_bytes(description))
        write_sums(sums, ((file.path, file.sha256) for file in record_index.files()))
        storage.put_file(sums, SUMS_NAME)
    finally:
        storage.discard(staging)
    storage.write(DATASET_NAME, dataset_bytes(description))


def _enter(record_index: RecordIndex, path: str, content: bytes) -> None:
    record_index.add_file(FileSum(path, len(content), hashlib.sha256(content).hexdigest()))


def write_split(
    storage: StorageBackend,
    split: str,
    record_index: RecordIndex,
    settings: DatasetSettings,
    parts: Sequence[RecipePart],
    version: dict[str, Any],
) -> None:
    """Merge the formats of a split's frames and write its manifest; the index takes their sums.

    Raises `OutputError`: a frame lacks a file or it is damaged, or one cannot be written.
    """
    staging = storage.staging()
    try:
        root = staging / split
        root.mkdir()
        _show_frames(storage, split, root, record_index)
        write_dataset(root, record_index.frames(split), settings)
        _hide_frames(root, record_index.frames(split))
        placed = list(_enter_merged(root, split, record_index))
        _write_manifest(root / MANIFEST_NAME, split, record_index, parts, version)
        record_index.add_file(_sum(root, MANIFEST_NAME, split))
        _publish(storage, split, root, placed)
    finally:
        storage.discard(staging)


def _show_frames(storage: StorageBackend, split: str, root: Path, record_index: RecordIndex) -> None:
    """Make the frames' folders appear in `root`."""
    if isinstance(storage, LocalStorage):
        for frame in record_index.frames(split):
            source, target = storage.root / split / frame, root / frame
            try:
                target.symlink_to(source, target_is_directory=True)
            except OSError:  # not everybody may make links to folders under Windows
                shutil.copytree(source, target)
        return
    remote: Any = storage
    names = (file.path for frame in record_index.frames(split) for file in record_index.files(f"{split}/{frame}"))
    read = (path for path in names if path.endswith(_READ))
    remote.fetch(read, root.parent)
    for frame in list(record_index.frames(split)):
        record_index.note_found(_touched(file, root.parent) for file in list(record_index.files(f"{split}/{frame}")))


def _touched(file: FileSum, folder: Path) -> tuple[str, int, int]:
    """What `RecordIndex.note_found` takes of a file; an empty one stands for what was not fetched."""
    path = folder / file.path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return file.path, file.bytes, path.stat().st_ino


def _hide_frames(root: Path, frames: Iterable[str]) -> None:
    """Leave what was merged alone; what a format has placed of fetched frames keeps its inode."""
    for frame in frames:
        path = root / frame
        if path.is_symlink():
            path.unlink()
        else:
            shutil.rmtree(path)


def _enter_merged(root: Path, split: str, record_index: RecordIndex) -> Iterator[tuple[str, str]]:
    """Enter the merged files; the frames' files among them, with their new places."""
    for path in _files_below(root):
        name = path.relative_to(root).as_posix()
        status = path.stat()
        source = record_index.file_of_inode(status.st_ino, split)
        if source is None:
            record_index.add_file(_sum(root, name, split))
            continue
        record_index.add_file(FileSum(f"{split}/{name}", source.bytes, source.sha256))
        yield source.path, f"{split}/{name}"


def _publish(storage: StorageBackend, split: str, root: Path, placed: Sequence[tuple[str, str]]) -> None:
    if not isinstance(storage, LocalStorage):
        remote: Any = storage
        for _, target in placed:
            (root.parent / target).unlink()
        remote.link(placed)
        remote.upload(root, split)
        return
    note_written(storage, (f"{split}/{path.name}" for path in root.iterdir()))
    for path in sorted(root.iterdir()):
        if path.is_dir():
            _keep_foreign(storage.root / split / path.name, path)
            storage.put_folder(path, f"{split}/{path.name}")
        else:
            storage.put_file(path, f"{split}/{path.name}")


def _keep_foreign(before: Path, staged: Path) -> None:
    """Take over what other tools have added to a folder that is about to be replaced, such as caches of labels."""
    for path in _files_below(before):
        target = staged / path.relative_to(before)
        if tool_of(path.relative_to(before).as_posix()) is None or path.is_symlink() or not path.is_file():
            continue
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):  # its tool has removed it meanwhile
                shutil.copyfile(path, target)


def _write_manifest(
    path: Path, split: str, record_index: RecordIndex, parts: Sequence[RecipePart], version: dict[str, Any]
) -> None:
    """A split's manifest.json; piece by piece, since it names every file."""
    with whole_file(path) as stream:
        stream.write("{\n")
        _write_list(stream, "image_seeds", map(json_text, record_index.seeds(split)))
        for key in ("packages", "platform", "python"):
            name = "versions" if key == "packages" else key
            stream.write(f"{json.dumps(name)}: {json_text(version[key])},\n")
        recipes = [{"hash": part.hash, "root_seed": part.root_seed} for part in parts]
        if len(parts) == 1:
            stream.write(f'"recipe_hash": {json_text(parts[0].hash)},\n"root_seed": {parts[0].root_seed},\n')
        stream.write(f'"recipes": {json_text(recipes)},\n"schema": {json_text(MANIFEST_SCHEMA)},\n')
        stream.write(f'"split": {json_text(split)},\n"run": {{\n')
        _write_list(stream, "images", map(json_text, record_index.reports(split)))
        _write_list(stream, "notes", map(json_text, record_index.notes(split)), end="},\n")
        stream.write('"files": {')
        for number, file in enumerate(record_index.files(split)):
            name = json_text(file.path.removeprefix(f"{split}/"))
            sums = json_text({"bytes": file.bytes, "sha256": file.sha256})
            stream.write(("\n" if number == 0 else ",\n") + f"{name}: {sums}")
        stream.write("\n}}\n")


def _write_list(stream: IO[str], key: str, items: Iterator[str], end: str = ",\n") -> None:
    stream.write(f"{json.dumps(key)}: [")
    for number, item in enumerate(items):
        stream.write(("\n" if number == 0 else ",\n") + item)
    stream.write("]" + end)


def _sum(root: Path, name: str, split: str) -> FileSum:
    return FileSum(f"{split}/{name}", (root / name).stat().st_size, file_sum(root / name))


def _files_below(root: Path) -> Iterator[Path]:
    for folder, _, names in os.walk(root):
        for name in sorted(names):
            yield Path(folder) / name
