"""A previous data set makes room for a new one and comes back if nothing takes its place; no empty one stays."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from forestgen.core.errors import OutputError
from forestgen.dataset.files import output_error
from forestgen.dataset.folder import clear_leftovers, hidden_name
from forestgen.dataset.foreign import tool_of
from forestgen.runs.contract import HIDDEN, RUN, Place
from forestgen.runs.folder import check_ours
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import done_keys


@contextmanager
def replacing(place: Place) -> Iterator[None]:
    """Move the data set that is in `place` aside while the block makes a new one there.

    If the block fails before an image is finished, the previous data set is put back. After a crash the next run
    removes what was moved aside, or puts it back if nothing has taken its place.

    Raises
    ------
    OutputError : the folder holds something else, another run writes there, or it cannot be moved.
    """
    if not isinstance(place, LocalPlace):
        raise OutputError(
            "only a folder of this machine can be replaced", where=place.name, hint="remove it there, or choose another"
        )
    try:
        root = place.root.resolve()
    except (OSError, RuntimeError) as error:  # a loop of links
        raise OutputError("the folder's path cannot be followed", where=place.name, got=str(error)) from error
    clear_leftovers(root, lambda: bool(done_keys(place)) or not set(place.names("")) <= {HIDDEN, RUN})
    check_ours(place)
    if not place.names(""):
        yield
        return
    with place.lock():
        pass  # nobody writes there
    aside = root.parent / hidden_name(root, "replaced")
    try:
        root.rename(aside)
    except OSError as error:
        raise output_error(error, root) from error
    try:
        yield
    except BaseException:
        if not done_keys(place):
            _put_back(aside, root)
            raise
        _discard(aside, root)
        raise
    _discard(aside, root)


def _put_back(aside: Path, root: Path) -> None:
    """Give the previous data set its name again; what the new one has begun is removed."""
    try:
        shutil.rmtree(root, ignore_errors=True)
        aside.rename(root)
    except OSError as error:
        raise OutputError(
            "the previous data set could not be put back", where=str(aside), hint=f"rename this folder to {root.name}"
        ) from error


def _discard(aside: Path, root: Path) -> None:
    _keep_foreign(aside, root)
    shutil.rmtree(aside, ignore_errors=True)


def _keep_foreign(aside: Path, root: Path) -> None:
    """Move what other tools have left beside the data set, such as ``.git``, into the folder that replaces it."""
    if not aside.is_dir() or not root.is_dir():
        return
    for entry in aside.iterdir():
        if tool_of(entry.name) is not None and not (root / entry.name).exists():
            entry.rename(root / entry.name)


@contextmanager
def leaving_no_empty(place: Place) -> Iterator[None]:
    """Remove the data set that the block has begun in an absent or empty folder, if it fails before an image is made.

    An empty folder that was there before stays, and so does what another run has begun there meanwhile.
    """
    if not isinstance(place, LocalPlace) or place.names(""):
        yield
        return
    new = [folder for folder in (place.root, *place.root.parents) if not os.path.lexists(folder)]  # the innermost first
    try:
        yield
    except BaseException:
        if place.root.is_dir() and not done_keys(place):
            with suppress(OutputError), place.lock():
                _remove_content(place.root)
        for folder in new:
            with suppress(OSError):  # it was never made, or something else lies there
                folder.rmdir()
        raise


def _remove_content(folder: Path) -> None:
    for path in folder.iterdir():
        shutil.rmtree(path, ignore_errors=True)
