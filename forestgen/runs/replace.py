"""A previous data set makes room for a new one and comes back if nothing takes its place; no empty one stays.

Meanwhile it lies beside the folder, as ``.NAME.previous-HOST-PID-START-RANDOM``.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from forestgen.core.errors import OutputError
from forestgen.dataset.files import output_error
from forestgen.dataset.folder import clear_leftovers, hidden_beside, hidden_name, leftovers
from forestgen.runs.contract import Place
from forestgen.runs.folder import check_ours
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import done_keys
from forestgen.runs.strays import check_strays, move_strays, named

_KIND = "previous"


def restore_previous(place: Place, say: Callable[[str], None]) -> None:
    """Finish what a run that was killed while it replaced the data set had begun.

    The previous data set is put back, or, if the new one has a finished image, removed, but for files of a user's and
    of other tools: they move into the new one. A folder that holds something else stays, and so does what lies beside.

    Raises
    ------
    OutputError : it cannot be moved, or another run writes there.
    """
    if not isinstance(place, LocalPlace):
        return
    root = _resolved(place)
    try:
        clear_leftovers(root)
        asides = leftovers(root, _KIND)
    except OSError as error:
        raise output_error(error, root) from error
    for aside in asides:
        try:
            check_ours(place)
        except OutputError:  # the run itself says so
            return
        if place.names(""):
            with place.lock():
                pass  # nobody writes there
        if done_keys(place):
            _discard(aside, root, say)
        else:
            _put_back(aside, root)
            say(f"{place.name}: the previous data set is back: a run that was to replace it was killed")


def previous_beside(root: Path) -> Path | None:
    """The data set that a run was to replace, if it lies beside its folder; see the module."""
    with suppress(OSError, RuntimeError):
        return next(iter(hidden_beside(root.resolve(), _KIND)), None)
    return None


@contextmanager
def replacing(place: Place, splits: Iterable[str], say: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """Move the data set that is in `place` aside while the block makes a new one there.

    If the block fails before an image is finished, the previous data set is put back. What forestgen has not written
    moves into the new one.

    Parameters
    ----------
    splits : names of the new data set's.
    say : told of files that were kept.

    Raises
    ------
    OutputError : the folder holds something else, another run writes there, it cannot be moved, or a user's files lie
        where the new data set has its own.
    """
    if not isinstance(place, LocalPlace):
        raise OutputError(
            "only a folder of this machine can be replaced", where=place.name, hint="remove it there, or choose another"
        )
    root = _resolved(place)
    check_ours(place)
    if not place.names(""):
        yield
        return
    with place.lock():
        pass  # nobody writes there
    check_strays(root, splits, place.name)
    aside = root.parent / hidden_name(root, _KIND)
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
        _discard(aside, root, say)
        raise
    _discard(aside, root, say)


def _resolved(place: LocalPlace) -> Path:
    try:
        return place.root.resolve()
    except (OSError, RuntimeError) as error:  # a loop of links
        raise OutputError("the folder's path cannot be followed", where=place.name, got=str(error)) from error


def _put_back(aside: Path, root: Path) -> None:
    """Give the previous data set its name again; what the new one has begun is removed."""
    try:
        if root.is_dir():
            move_strays(root, aside)
            shutil.rmtree(root, ignore_errors=True)
        aside.rename(root)
    except OSError as error:
        raise OutputError(
            "the previous data set could not be put back", where=str(aside), hint=f"rename this folder to {root.name}"
        ) from error


def _discard(aside: Path, root: Path, say: Callable[[str], None]) -> None:
    """Remove the previous data set; what is not forestgen's moves into the new one, or stays."""
    try:
        kept = move_strays(aside, root)
        if kept:
            say(f"note: kept of the previous data set, as forestgen has not written it: {named(kept)}")
        shutil.rmtree(aside, ignore_errors=True)
    except (OSError, OutputError, RecursionError) as error:  # the last: folders a thousand deep
        say(f"note: the previous data set stays in {aside}: {error}")


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
