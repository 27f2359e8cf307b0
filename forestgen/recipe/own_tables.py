"""Tables of spectra that a recipe names: found, checked, and kept as text where they are the user's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from forestgen.core.errors import AssetError
from forestgen.recipe.assets import find_asset, scenes_dir
from forestgen.recipe.sources import Keys, SourceMap
from forestgen.recipe.spectra import (
    KIND,
    SEASONS,
    Columns,
    bands_of,
    of_season,
    seasons_of,
    sensor_file,
    surface_columns,
    table_text,
)


def is_shipped(path: Path) -> bool:
    """Whether a file is one of forestgen's own."""
    return path.is_relative_to(scenes_dir()) and ".." not in path.parts


def embed_spectra(
    materials: Any, sources: SourceMap, keys: Keys, folder: Path, season: str | None = None, root: Path | None = None
) -> None:
    """Check the spectra that a species' materials name, in place; a file of the user's own is kept as its text.

    ``spectrum: NAME`` becomes ``spectrum: {name: NAME}``, with the file's ``text`` unless forestgen ships it. So a
    recipe's hash covers the file, and a drawn recipe holds all that it needs.

    Parameters
    ----------
    materials : the section as written, of any type.
    keys : its key path in the recipe.
    folder : where paths start.
    season : of materials that name none; None: it is not known yet.
    root : the recipe's folder, where `folder` is that of a species file.

    Raises
    ------
    AssetError : see `load_spectra`; or the table has no such season.
    """
    for material_name, material in materials.items() if isinstance(materials, dict) else ():
        if not isinstance(material, dict):
            continue
        written = material.get("spectrum")
        if isinstance(written, str):
            written = material["spectrum"] = {"name": written}
        if not isinstance(written, dict) or not isinstance(written.get("name"), str):
            continue  # the schema tells what is wrong
        name, text, where = written["name"], written.get("text"), sources.where((*keys, material_name, "spectrum"))
        if isinstance(text, str):
            columns = surface_columns(text, name, where)
        elif text is None:
            path = find_asset(KIND, name, folder=folder, root=root, where=where)
            text = table_text(path)
            columns = surface_columns(text, str(path), where)
            if not is_shipped(path):
                written["name"], written["text"] = path.name, text
        else:
            continue
        _check_season(columns, material.get("season") or season, name, where)


def embed_sensors(cameras: Any, sources: SourceMap, folder: Path) -> None:
    """Check the sensors that cameras name, in place; a file of the user's own is kept as its text.

    ``bands: NAME`` becomes ``bands: {name: NAME}``, as with `embed_spectra`.

    Parameters
    ----------
    cameras : the section as written, of any type.
    folder : where paths start.

    Raises
    ------
    AssetError : see `load_bands`.
    """
    for index, camera in enumerate(cameras) if isinstance(cameras, list) else ():
        if not isinstance(camera, dict):
            continue
        written = camera.get("bands")
        if isinstance(written, str):
            written = camera["bands"] = {"name": written}
        if not isinstance(written, dict) or not isinstance(written.get("name"), str):
            continue  # the schema tells what is wrong
        name, text, where = written["name"], written.get("text"), sources.where(("cameras", index, "bands"))
        if isinstance(text, str):
            bands_of(text, name, where)
        elif text is None:
            path = sensor_file(name, folder, where)
            text = table_text(path)
            bands_of(text, str(path), where)
            if not is_shipped(path):
                written["name"], written["text"] = path.name, text


def _check_season(columns: Columns, season: object, name: str, where: str) -> None:
    """The table serves the season, if that is one."""
    if season in SEASONS and of_season(columns, season) is None:
        expected = f"one of {', '.join(seasons_of(columns))}"
        hint = "the material's own `season` goes before plants.season"
        raise AssetError(f"{name} has no {season}", where=where, expected=expected, got=str(season), hint=hint)
