"""Files that a recipe names: shipped ones by name, under ``scenes/`` and ``recipes/``, and the user's own by path.

In an installed wheel the shipped files lie in ``forestgen/_data``, in a checkout at the repository's root.

A recipe may come from anybody, and users should be able to run it without reading it first. So a path in a recipe, or
in a species file that it names, is relative to that file's folder, and the file that it leads to must lie below the
recipe's folder after all links are followed. ``forestgen --allow-folder DIR COMMAND ...``, or the environment variable
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
from forestgen.recipe.registries import BUILDINGS
from forestgen.recipe.suggestions import did_you_mean

PACKAGE = Path(__file__).resolve().parents[1]
SUFFIXES = {
    "species": (".yaml",),
    "recipes": (".yaml",),
    "terrain": (".yaml",),
    "climate": (".yaml",),
    "lsystems": (".lsys", ".sys"),
    "modules": (".yaml",),
    "spectra": (".csv",),
}
ALLOWED = "FORESTGEN_ALLOW_FOLDERS"  # environment: folders, separated as in PATH
MAPS = "maps"  # beside an image's folder, by dataset/writer.py
_STORED = re.compile(rf"\.\./{MAPS}/([0-9a-f]{{16}})\.[a-z]{{2,4}}")  # the name is the beginning of its SHA-256
_ELSEWHERE = re.compile(r"//|\\\\|~|[A-Za-z][A-Za-z0-9+.-]*://|[A-Za-z]:[\\/]")  # network, home, URL, drive
_RELATIVE = "a path that is relative to the recipe's folder and does not leave it"


def _data_dir(name: str) -> Path:
    places = [PACKAGE / "_data" / name, PACKAGE.parent / name]
    for folder in places:
        if folder.is_dir():
            return folder
    problem, expected = f"this installation has no folder {name!r}", " or ".join(map(str, places))
    raise AssetError(problem, expected=expected, hint="install forestgen again")


def scenes_dir() -> Path:
    """Folder of the files that recipes refer to by name."""
    return _data_dir("scenes")


def recipes_dir() -> Path:
    """Folder of the complete examples."""
    return _data_dir("recipes")


def _kind_dir(kind: str) -> Path:
    return recipes_dir() if kind == "recipes" else scenes_dir() / kind


def list_assets(kind: str) -> list[str]:
    """Names of the shipped parts of a kind ("species", "lsystems", ..., "recipes"), sorted.

    Those in a folder of their own come last: ``reproductions/domination_test``.
    """
    folder, suffixes = _kind_dir(kind), SUFFIXES.get(kind, ())
    files = (path for path in folder.rglob("*") if path.suffix in suffixes and path.is_file())
    names = {path.relative_to(folder).with_suffix("").as_posix() for path in files}
    return sorted(names, key=lambda name: (name.count("/"), name))


def find_asset(
    kind: str,
    name: str,
    *,
    folder: Path | None = None,
    root: Path | None = None,
    where: str | None = None,
    parameter: str | None = None,
) -> Path:
    """The file of a named part.

    Parameters
    ----------
    kind : "species", "lsystems", "spectra", "terrain", "climate" or "recipes".
    name : a shipped file's name; or, with a slash or the kind's suffix, a path relative to `folder`. A file at that
        path takes precedence over a shipped file of the same name.
    folder : the recipe's folder, or that of its species file, which the path must not leave (see `inside`). None: the
        name comes from the command line and may be any path, relative to the working directory.
    root : the recipe's folder, where `folder` is a species file's.
    where, parameter : the place in a recipe, or the parameter of a call, that names the file; for messages.

    Raises
    ------
    AssetError : there is no such file, and the message lists those that exist; or the path leads elsewhere.
    """
    suffixes = SUFFIXES[kind]
    if "/" in name or "\\" in name or name.endswith((*suffixes, ".yaml", ".yml")):
        path = Path(name) if folder is None else inside(folder, name, roots=(root or folder, scenes_dir()), where=where)
        if _is_file(path):
            return path
        if _shipped(kind, name) is None:
            hint = did_you_mean(name, list_assets(kind))
            problem, expected = f"no such {kind} file", "an existing file"
            raise AssetError(problem, where=where, parameter=parameter, expected=expected, got=str(path), hint=hint)
    shipped = _shipped(kind, name)
    if shipped is not None:
        return shipped
    names, path_like = list_assets(kind), f"./{name or 'name'}{suffixes[0]}"
    expected = f"one of {', '.join(names) or '(there are none)'}, or a path such as {path_like}"
    problem, hint = f"nothing in {kind} has this name", did_you_mean(name, names)
    if kind == "species" and name in BUILDINGS:
        hint = f"it is a building: site: {{buildings: [{{kind: {name}, position_m: [...]}}]}}"
    raise AssetError(problem, where=where, parameter=parameter, expected=expected, got=repr(name), hint=hint)


def _shipped(kind: str, name: str) -> Path | None:
    """The file of a shipped part, without looking through all of them; None: go and look."""
    parts = name.split("/")
    if any(part in ("", ".", "..") or "\\" in part or ":" in part for part in parts):
        return None
    for suffix in SUFFIXES[kind]:
        path = _kind_dir(kind) / f"{name}{suffix}"
        if _is_file(path):
            return path
    return None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError, RuntimeError):  # a name that no file system takes: too long, NUL, unknown ~user
        return False


def allowed_folders() -> tuple[Path, ...]:
    """The folders besides a recipe's own that the user allows recipes to read from."""
    return tuple(Path(one).absolute() for one in os.environ.get(ALLOWED, "").split(os.pathsep) if one)


def allow_folders(folders: list[Path]) -> None:
    """Let recipes of this process, and of those that it starts, read from these folders too."""
    for folder in folders:
        if not folder.is_dir():
            expected = "an existing folder"
            raise AssetError("no such folder", parameter="allow_folders", expected=expected, got=str(folder))
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
    got, hint = f"{written!r:.80}", "put the file beside the recipe; or allow its folder: `allow_folders='DIR'`"
    return AssetError("the path leads out of the recipe's folder", where=where, expected=_RELATIVE, got=got, hint=hint)
