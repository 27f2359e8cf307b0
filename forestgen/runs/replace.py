"""A previous data set makes room for a new one, and comes back if the new one gets no image.

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
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from forestgen.core.errors import ForestgenError, OutputError
from forestgen.dataset.files import output_error
from forestgen.runs.contract import HIDDEN, StorageBackend
from forestgen.runs.folder import BEGUN, MOVING, PREVIOUS
from forestgen.runs.foreign_files import check_replaceable, free_name, move_foreign, named
from forestgen.runs.records import done_keys
from forestgen.runs.storage import LOCK_FILES, STAGING, LocalStorage

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

    Raises
    ------
    OutputError : something cannot be moved.
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

    Parameters
    ----------
    splits : names of the new data set's.
    say : told of users' files that were kept, and of what could not be removed.
    overwrite : replace the data set that is there; if the block fails before an image is finished, it is put back.
    keep_begun : without `overwrite`, leave what a block has begun that fails before an image is finished: its log.

    Raises
    ------
    OutputError : users' files lie where the new data set has its own, or something cannot be moved.
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

    Parameters
    ----------
    say : told of users' files that were kept, and of what could not be removed.
    drop_begun : remove a data set without a finished image also where there was no previous one.
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
