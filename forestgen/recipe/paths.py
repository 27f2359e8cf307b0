"""Which files a recipe may name: those below its own folder, forestgen's, and those of folders that the user allows.

A recipe may come from anybody, and whoever runs it should not have to read it first. So a path in a recipe, or in a
species file that it names, is relative to that file's folder, and the file that it leads to must lie below the recipe's
folder when all links are followed. ``forestgen --allow-folder DIR COMMAND ...``, or the environment variable
``FORESTGEN_ALLOW_FOLDERS``, names further folders. A recipe that is stored with an image also reaches ``../maps``,
where its maps lie by their content.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

from forestgen.core.errors import AssetError

ALLOWED = "FORESTGEN_ALLOW_FOLDERS"  # environment: folders, separated as in PATH
MAPS = "maps"  # beside an image's folder, dataset/writer.py
_STORED = re.compile(rf"\.\./{MAPS}/([0-9a-f]{{16}})\.[a-z]{{2,4}}")  # the name is the beginning of its SHA-256
_ELSEWHERE = re.compile(r"//|\\\\|~|[A-Za-z][A-Za-z0-9+.-]*://|[A-Za-z]:[\\/]")  # network, home, URL, drive
_RELATIVE = "a path that is relative to the recipe's folder and does not leave it"


def allowed_folders() -> tuple[Path, ...]:
    """The folders besides a recipe's own that the user allows recipes to read from."""
    return tuple(Path(one).absolute() for one in os.environ.get(ALLOWED, "").split(os.pathsep) if one)


def allow_folders(folders: list[Path]) -> None:
    """Let recipes of this process, and of those that it starts, read from these folders too.

    Raises
    ------
    AssetError : one of them is no folder.
    """
    for folder in folders:
        if not folder.is_dir():
            raise AssetError(
                "no such folder", parameter="allow_folders", expected="an existing folder", got=str(folder)
            )
    together = [*allowed_folders(), *(folder.absolute() for folder in folders)]
    if together:
        os.environ[ALLOWED] = os.pathsep.join(str(folder) for folder in together)


def inside(
    folder: Path, written: str, *, roots: Sequence[Path] = (), sha256: str | None = None, where: str | None = None
) -> Path:
    """The path that a recipe means by `written`: ``folder / written``, if that is for a recipe to read.

    Parameters
    ----------
    folder : that the path is relative to: of the recipe, or of the species file that names it.
    roots : the folders that it may lie in, where that is not `folder` alone.
    sha256 : of the file's content, if the recipe gives it.
    where : place in the recipe, for messages.

    Raises
    ------
    AssetError : the path, or a link on its way, leads out of the recipe's folder; it may still name no file.
    """
    if not written or any(unicodedata.category(one) in ("Cc", "Cf", "Cs") for one in written):
        raise AssetError("not a file's name", where=where, expected=_RELATIVE, got=ascii(written)[:80])
    if _ELSEWHERE.match(written):  # refused before anything is asked of a file system, which might ask a network
        raise _out(written, where)
    stored = _STORED.fullmatch(written)
    try:
        home, target = folder.resolve(), (folder / written).resolve()
        allowed = [one.resolve() for one in (*(roots or (folder,)), *allowed_folders())]
    except (OSError, RuntimeError, ValueError) as cause:  # RuntimeError: links in a circle
        reason = cause.strerror if isinstance(cause, OSError) else "links that lead in a circle"
        raise AssetError("the file cannot be read", where=where, expected=_RELATIVE, got=reason) from cause
    if stored and sha256 is not None and sha256.startswith(stored[1]):
        allowed.append(home.parent / MAPS)
    if not any(target.is_relative_to(one) for one in allowed):
        raise _out(written, where)
    return folder / written


def _out(written: str, where: str | None) -> AssetError:
    return AssetError(
        "the path leads out of the recipe's folder",
        where=where,
        expected=_RELATIVE,
        got=f"{written!r:.80}",
        hint="put the file beside the recipe; or allow its folder: `allow_folders='DIR'`",
    )
