"""A previous data set makes room for a new one, and comes back if the new one gets no image.

What users and other tools have put into its folder moves into the new one.

All of this happens under the lock of the folder, so what lies in one of these places when a run starts was left by a
run that was killed, and `recover` finishes what that run had begun:

| in `.forestgen` | |
|---|---|
| `previous` | the data set that is replaced, as it was |
| `moving` | a part of a data set on its way to `previous` or back: the rest is in its folder |
| `begun` | of a new data set that has no image: users' files in it go back into the folder, the rest is removed |
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path

from forestgen.core.errors import ForestgenError, OutputError, output_error
from forestgen.dataset.check.files import Finding
from forestgen.dataset.png import THUMBNAILS
from forestgen.dataset.safe_path import SafePath, is_frame
from forestgen.recipe.assets import MAPS
from forestgen.runs.contract import HIDDEN, RUN, StorageBackend
from forestgen.runs.folder import BEGUN, MOVING, PREVIOUS, splits_before, tool_of, written_paths
from forestgen.runs.record_index import RecordIndex
from forestgen.runs.records import done_keys
from forestgen.runs.storage import LOCK_FILES, STAGING, LocalStorage, unreadable_storage
from forestgen.runs.verify_index import enter_records, enter_sums

_MAP = rf"{MAPS}/[0-9a-f]{{16}}\.[^/]+"
_OF_RUN = re.compile(rf"SHA256SUMS|report\.html|{RUN}/(log\.jsonl|jobs\.parquet|summary\.json)")  # not in SHA256SUMS
_TOP = re.compile(
    rf"{HIDDEN}/.*|README\.md|dataset\.json|index\.parquet|recipe(-[0-9]+)?\.yaml|{_MAP}|{_OF_RUN.pattern}"
)
_OF_SPLIT = re.compile(rf"(classes|manifest)\.json|{_MAP}")
_FOLDERS = (HIDDEN, RUN, MAPS, THUMBNAILS)
_MOST_NAMED = 10
_STAYS = {*LOCK_FILES, *(path.removeprefix(f"{HIDDEN}/") for path in (STAGING, PREVIOUS, MOVING, BEGUN))}


def previous_note(root: Path) -> str | None:
    """Where the data set lies that a run was to replace, and what becomes of it; None if there is none."""
    previous = next((root / name for name in (PREVIOUS, MOVING) if os.path.lexists(root / name)), None)
    if previous is None:
        return None
    with suppress(ForestgenError):
        if done_keys(LocalStorage(root)) and previous == root / PREVIOUS:
            return f"{previous} has the data set that was there: the next run removes it; move it away to keep it"
    return f"{previous} has the data set that was there: unless a run is just replacing it, `resume=True` puts it back"


def recover(storage: StorageBackend, say: Callable[[str], None]) -> None:
    """Finish what a run that was killed while it replaced the data set had begun; the caller holds the lock.

    The previous data set is put back or, if the new one has a finished image, removed, but for users' files.

    Raises `OutputError`: something cannot be moved.
    """
    outcome = _settle(storage, say) if isinstance(storage, LocalStorage) else None
    if outcome is not None:
        say(f"{storage.name}: the previous data set is {outcome}: a run that was to replace it was killed")


@contextmanager
def replacing(
    storage: StorageBackend, splits: Iterable[str], say: Callable[[str], None], *, overwrite: bool, keep_begun: bool
) -> Iterator[None]:
    """Make a data set in the block, whose caller holds the lock of `storage`.

    What forestgen has not written moves from the previous data set into the new one.

    `splits`: names of the new data set's.
    `say`: called with users' files that were kept, and with what could not be removed.
    `overwrite`: replace the data set that is there; if the block fails before an image is finished, it is put back.
    `keep_begun`: without `overwrite`, leave what a block has begun that fails before an image is finished: its log.

    Raises `OutputError`: users' files lie where the new data set has its own, or something cannot be moved.
    """
    if overwrite:
        check_replaceable(storage, splits)
    if not isinstance(storage, LocalStorage):
        yield
        return
    drop_begun = False
    try:
        if overwrite:
            _set_aside(storage)
        drop_begun = (overwrite or not keep_begun) and not any(_content(storage.root))
        yield
    except BaseException:
        _settle(storage, say, drop_begun=drop_begun)
        raise
    _settle(storage, say)


def _settle(storage: LocalStorage, say: Callable[[str], None], *, drop_begun: bool = False) -> str | None:
    """What became of the previous data set: it is back, or removed; None if there was none, or it stays.

    `say`: called with users' files that were kept, and with what could not be removed.
    `drop_begun`: remove a data set without a finished image also where there was no previous one.
    """
    root = storage.root
    outcome: str | None = None
    previous, moving, begun = root / PREVIOUS, root / MOVING, root / BEGUN
    with _moving(root):
        if _move_content(moving, root):
            outcome = "back"
        has_image = bool(done_keys(storage))
        if not has_image and (previous.is_dir() or drop_begun):
            _move_content(root, begun)
        if not has_image and previous.is_dir():
            previous.rename(moving)
            _move_content(moving, root)
            outcome = "back"
        if moving.is_dir() and not any(_content(moving)):
            storage.remove(MOVING)  # what a lock or a worker had left in it
    if previous.is_dir() and _discard(storage, PREVIOUS, say):
        outcome = "removed"
    if begun.is_dir():
        _discard(storage, BEGUN, say)
    return outcome


def _set_aside(storage: LocalStorage) -> None:
    """Move all that lies in the folder to `PREVIOUS`."""
    previous = storage.root / PREVIOUS
    if os.path.lexists(previous):
        raise OutputError("a data set that was replaced lies there still", where=str(previous), hint="move it away")
    with _moving(storage.root):
        _move_content(storage.root, storage.root / MOVING)
        if (storage.root / MOVING).is_dir():
            (storage.root / MOVING).rename(previous)


def _content(root: Path) -> Iterator[str]:
    """Paths of what moves with a data set: all that lies in its folder, and in the hidden one the records."""
    for folder, stays in ((root, {HIDDEN}), (root / HIDDEN, _STAYS)):
        names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
        yield from ((folder / name).relative_to(root).as_posix() for name in names if name not in stays)


def _move_content(source: Path, target: Path) -> bool:
    """Move a data set, or what is left of it, into another folder, where what is in its way gets another name.

    Returns
    -------
    Whether there was anything to move.
    """
    content = list(_content(source))
    for path in content:
        new = target / path
        new.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(new):
            new.rename(free_name(new))
        (source / path).rename(new)
    for folder in (source / HIDDEN, source):
        with suppress(OSError):  # it is not there, or not empty
            folder.rmdir()
    return bool(content)


def _discard(storage: LocalStorage, path: str, say: Callable[[str], None]) -> bool:
    """Remove a data set, or tell that it stays; what is not forestgen's moves into the one that is there."""
    try:
        kept = move_foreign(storage.root / path, storage.root)
        if kept:
            say(f"note: kept of {storage.name}, as forestgen has not written it: {named(kept)}")
        storage.remove(path)
        storage.clear_staging()
    except (OSError, ForestgenError, RecursionError) as error:  # the last: folders a thousand deep
        say(f"note: {storage.root / path} stays: {error}")
        return False
    return True


@contextmanager
def _moving(root: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise output_error(error, Path(error.filename or root)) from error


def foreign_files(root: Path) -> list[str]:
    """Paths of what forestgen has not written, sorted; of a folder in which all is, only the folder.

    The sources are SHA256SUMS for a finished data set; else the images' records, the names that forestgen uses in any
    data set, and its list of the files over all images (`folder.note_written`).

    Raises `OutputError`: the folder cannot be read, or the disk of temporary files is full.
    """
    with RecordIndex() as record_index:
        refused: list[Finding] = []
        is_whole = enter_sums(root, record_index, refused) and not refused
        splits = {*splits_before(LocalStorage(root)), *enter_records(root, record_index)}
        try:
            return sorted(_foreign_in(root, record_index, splits, is_whole))
        except OSError as error:
            raise unreadable_storage(error, error.filename or root) from error


def _foreign_in(root: Path, record_index: RecordIndex, splits: set[str], is_whole: bool) -> Iterator[str]:
    written = tuple(written_paths(LocalStorage(root)))

    def is_known(path: str) -> bool:
        """Whether the index has all that forestgen has written there."""
        return is_whole or (_is_in_frame(path, splits) and record_index.has_below("/".join(path.split("/")[:2])))

    def may_be_ours(path: str) -> bool:
        """Whether forestgen gives such names, or has noted that it writes there."""
        return _is_named(path, splits) or any(path == one or path.startswith(f"{one}/") for one in written)

    waiting = [""]
    while waiting:
        folder = waiting.pop()
        with os.scandir(root / folder) as entries:
            found = [(one.name, one.is_dir(follow_symlinks=False)) for one in entries]
        for name, is_folder in found:
            path = f"{folder}/{name}" if folder else name
            if path.encode("utf-8", "replace").decode() != path:  # no text: forestgen writes no such name
                yield path
            elif path == HIDDEN or _OF_RUN.fullmatch(path) or record_index.file(path):
                continue
            elif is_folder and (record_index.has_below(path) or path in _FOLDERS or path in splits):
                waiting.append(path)
            elif is_known(path) or not may_be_ours(f"{path}/" if is_folder else path):
                yield path


def _is_named(path: str, splits: Iterable[str]) -> bool:
    """Whether forestgen gives such names, whatever the formats of the data set are."""
    folder, _, inside = path.partition("/")
    if folder == THUMBNAILS:
        return inside.endswith(".jpg") and is_frame(inside.removesuffix(".jpg"))
    of_split = _OF_SPLIT.fullmatch(inside) is not None or _is_in_frame(path, splits)
    return _TOP.fullmatch(path) is not None or (folder in splits and of_split)


def _is_in_frame(path: str, splits: Iterable[str]) -> bool:
    """Whether it is the folder of a frame, or lies in one."""
    split, _, inside = path.partition("/")
    return split in splits and is_frame(inside.partition("/")[0])


def check_replaceable(storage: StorageBackend, splits: Iterable[str]) -> None:
    """Refuse to replace a data set in an object store, or one with users' files where the new one has its own.

    Files where only some formats have theirs are not refused: they are renamed when the new data set is there.

    `splits`: names of the new one's.

    Raises `OutputError`.
    """
    if not isinstance(storage, LocalStorage):
        hint = "remove it there, or choose another"
        raise OutputError("only a folder of this machine can be replaced", where=storage.name, hint=hint)
    if not storage.names(""):
        return
    root, names = storage.root, {*splits, *splits_before(storage)}

    def files(path: str) -> Iterator[str]:
        """A path and, of a folder that the new data set has as well, what lies in it."""
        yield path
        if path.partition("/")[0] in (*names, *_FOLDERS) and not (root / path).is_symlink():
            for folder, folders, inner in os.walk(root / path):
                inside = Path(folder).relative_to(root).as_posix()
                yield from (f"{inside}/{name}" for name in (*folders, *inner) if inside != ".")

    def is_used(path: str) -> bool:
        """Whether the new data set may have a file there, or a folder where this is none."""
        is_folder = path in _FOLDERS or path in names
        return _is_named(path, names) or (is_folder and not SafePath(root, path).is_folder())

    own = (path for path in foreign_files(root) if tool_of(path) is None)
    if used := [path for path in own if any(map(is_used, files(path)))]:
        problem = "files that forestgen has not written lie where the new data set has its own"
        expected = "none in frames' folders, and none of a name that forestgen gives"
        raise OutputError(problem, where=storage.name, expected=expected, got=named(used), hint="move them away")


def move_foreign(source: Path, target: Path) -> list[str]:
    """Move what is not forestgen's from one data set's folder into another's; the paths that it has there.

    Files of other tools go only into folders that are there, and not into frames.

    Raises `OSError`: one cannot be moved; the others after it stay too.
    """
    splits = {*splits_before(LocalStorage(source)), *splits_before(LocalStorage(target))}
    kept: list[str] = []
    for path in foreign_files(source):
        if tool_of(path) is not None and (_is_in_frame(path, splits) or not (target / path).parent.is_dir()):
            continue
        _move(source, target, path, kept.append)
    return kept


def _move(source: Path, target: Path, path: str, note: Callable[[str], None]) -> None:
    old, new = source / path, target / path
    new.parent.mkdir(parents=True, exist_ok=True)
    if os.path.lexists(new):
        is_folder = old.is_dir() and new.is_dir() and not (old.is_symlink() or new.is_symlink())
        if tool_of(path) is not None and not is_folder:
            return  # the tool has made it again
        if is_folder and tool_of(path) is None:
            for inner in sorted(old.iterdir()):
                _move(source, target, f"{path}/{inner.name}", note)
            return
        new = free_name(new)
    old.rename(new)
    note(new.relative_to(target).as_posix())


def free_name(path: Path) -> Path:
    """`path` or, if something lies there, a name beside it."""
    names = (path.with_name(f"{path.name}.previous-{number}") for number in count(1))
    return next(one for one in chain([path], names) if not os.path.lexists(one))


def named(paths: list[str]) -> str:
    """Some of many paths, for people."""
    more = f" and {len(paths) - _MOST_NAMED:,} more" if len(paths) > _MOST_NAMED else ""
    return ", ".join(path.encode("utf-8", "backslashreplace").decode() for path in paths[:_MOST_NAMED]) + more
