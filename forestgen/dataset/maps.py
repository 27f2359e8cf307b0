"""The maps that a recipe names, written beside its images: an output folder holds all that its recipes need."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from forestgen.core.errors import AssetError
from forestgen.core.grey_picture import kind_of
from forestgen.dataset.files import output_error, write_bytes
from forestgen.recipe.assets import MAPS, inside
from forestgen.recipe.map_files import map_files

_WEATHER = ("csv", "nc", "vol")


def _ending(path: Path) -> str:
    """A file's kind, which weather is known by and a picture must show."""
    own = path.suffix.lower().removeprefix(".")
    return own if own in _WEATHER else kind_of(path)


def write_maps(root: Path, data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write each map of a drawn recipe into ``maps/`` of a run's folder, once.

    Parameters
    ----------
    root : the run's folder.
    data : the drawn recipe, plain.
    folder : the recipe's own, to which paths in `data` are relative.

    Returns
    -------
    dict : `data` with paths as from a frame's folder, named by content: the same for every copy of the recipe.

    Raises
    ------
    AssetError : a file has changed since the recipe was loaded.
    OutputError : one cannot be written.
    """
    stored = copy.deepcopy(data)
    for one in map_files(stored):
        one["file"] = f"../{MAPS}/{write_map(root, one, folder)}"
    return stored


def write_map(root: Path, one: Mapping[str, Any], folder: Path) -> str:
    """Write one map, a mapping of its file and SHA-256, into ``maps/`` of `root`; its name there. See `write_maps`."""
    sha256 = one["sha256"]
    source = inside(folder, one["file"], sha256=sha256)
    name = f"{sha256[:16]}.{_ending(source)}"
    target = root / MAPS / name
    if not target.exists():
        content = source.read_bytes()
        if hashlib.sha256(content).hexdigest() != sha256:
            raise AssetError("this map has changed since the recipe was loaded", where=str(source))
        try:
            target.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise output_error(error, target.parent) from error
        write_bytes(target, content)
    return name
