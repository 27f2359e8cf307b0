"""The files over all images of a split: classes.json, the merged formats, manifest.json.

Formats are merged in a staging folder that shows the split's frames: links to their folders; of frames in an object
store copies of what merging reads, and empty files for pictures that it only places. So nothing half-merged is ever
under a final name, and a picture that a format places is known by its inode: its sum is in the frame's record.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from forestgen.dataset.foreign import tool_of
from forestgen.dataset.formats.shards import json_text, whole_file
from forestgen.dataset.manifest import MANIFEST_NAME, file_sum
from forestgen.dataset.manifest import SCHEMA as MANIFEST_SCHEMA
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.writer import write_dataset
from forestgen.runs.contract import StorageBackend
from forestgen.runs.description import RecipePart
from forestgen.runs.folder import note_written
from forestgen.runs.record_index import FileSum, RecordIndex
from forestgen.runs.storage import LocalStorage

_READ = (".json", ".txt")  # endings of what merging reads of a frame; it only places the rest


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
            _link_folder(storage.root / split / frame, root / frame)
        return
    remote: Any = storage
    names = (file.path for frame in record_index.frames(split) for file in record_index.files(f"{split}/{frame}"))
    read = (path for path in names if path.endswith(_READ))
    remote.fetch(read, root.parent)
    for frame in list(record_index.frames(split)):
        record_index.note_found(_touched(file, root.parent) for file in list(record_index.files(f"{split}/{frame}")))


def _link_folder(source: Path, target: Path) -> None:
    try:
        target.symlink_to(source, target_is_directory=True)
    except OSError:  # not everybody may make links to folders under Windows
        shutil.copytree(source, target, copy_function=_link_file)


def _link_file(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


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
