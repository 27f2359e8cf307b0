"""The files of a data set against SHA256SUMS, and what else lies in its folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

from forestgen.core.errors import DatasetError
from forestgen.core.progress import Progress
from forestgen.dataset.check import Finding
from forestgen.dataset.check.files import UnreadableError, read_json
from forestgen.dataset.foreign import tool_of
from forestgen.dataset.manifest import MANIFEST_NAME, SUMS_NAME, file_sum, read_sums
from forestgen.dataset.safe_path import SafePath
from forestgen.runs.contract import RUN_DEPENDENT
from forestgen.runs.record_index import FileSum, RecordIndex
from forestgen.runs.records import in_order, records_of
from forestgen.runs.storage import LocalStorage, files_below

_MOST_IN_A_NOTE = 20


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
