"""Named parts of a recipe: the files under ``scenes/`` and ``recipes/``.

In an installed wheel they lie in ``forestgen/_data``; in a checkout at the repository's root.
"""

from __future__ import annotations

from pathlib import Path

from forestgen.core.errors import AssetError
from forestgen.recipe.paths import inside
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


def _data_dir(name: str) -> Path:
    for root in (PACKAGE / "_data", PACKAGE.parent):
        if (root / name).is_dir():
            return root / name
    raise AssetError(
        f"this installation has no folder {name!r}",
        expected=f"{PACKAGE / '_data' / name} or {PACKAGE.parent / name}",
        hint="install forestgen again",
    )


def scenes_dir() -> Path:
    """Folder of the parts that recipes refer to by name."""
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
    return sorted(_files(kind), key=lambda name: (name.count("/"), name))


def _files(kind: str) -> dict[str, Path]:
    """Name -> file of the shipped parts of a kind."""
    folder, suffixes = _kind_dir(kind), SUFFIXES.get(kind)
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and (suffixes is None or p.suffix in suffixes))
    return {p.relative_to(folder).with_suffix("").as_posix(): p for p in files}


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
    name : a shipped part's name; or, with a slash or the kind's suffix, a path relative to `folder`. A file at that
        path goes before a shipped part of the same name.
    folder : the recipe's folder, or that of its species file, which the path must not leave (`paths.inside`). None: the
        name comes from the command line; any path goes, relative to the working directory.
    root : the recipe's folder, where `folder` is a species file's.
    where : place in the recipe that names the part, for messages.
    parameter : of a call, that names the part in place of a recipe.

    Raises
    ------
    AssetError : there is no such file, and the message lists the parts that exist; or the path leads elsewhere.
    """
    suffixes = SUFFIXES.get(kind, (".yaml",))
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
    names = list_assets(kind)
    if name not in names:
        path_like = f"./{name or 'name'}{suffixes[0]}"
        raise AssetError(
            f"nothing in {kind} has this name",
            where=where,
            parameter=parameter,
            expected=f"one of {', '.join(names) or '(there are none)'}, or a path such as {path_like}",
            got=repr(name),
            hint=did_you_mean(name, names) if kind != "species" or name not in BUILDINGS else _as_building(name),
        )
    return _files(kind)[name]


def _as_building(name: str) -> str:
    return f"it is a building: site: {{buildings: [{{kind: {name}, position_m: [...]}}]}}"


def _shipped(kind: str, name: str) -> Path | None:
    """The file of a shipped part, without looking through all of them; None: go and look."""
    parts = name.split("/")
    if any(part in ("", ".", "..") or "\\" in part or ":" in part for part in parts):
        return None
    for suffix in SUFFIXES.get(kind, ()):
        path = _kind_dir(kind) / f"{name}{suffix}"
        if _is_file(path):
            return path
    return None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError, RuntimeError):  # a name that no file system takes: too long, NUL, unknown ~user
        return False
