"""The index of a folder that `forestgen render` wrote, which has none: read from the frames' own files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from forestgen.core.errors import DatasetError
from forestgen.dataset.report.frames import Frames, frames_of
from forestgen.dataset.safe_path import SafePath, check_cells, is_frame
from forestgen.recipe.yaml_source import parse_yaml

_UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, SyntaxError),
    *(pa.ArrowException, DatasetError, Image.DecompressionBombError),
)
_SKY = {"sun_elevation_deg": ("sun", "elevation_deg"), "sun_azimuth_deg": ("sun", "azimuth_deg"),
        "turbidity": ("turbidity",), "clouds": ("clouds", "type"), "cloud_cover": ("clouds", "cover")}  # fmt: skip


def plain_frames(folder: Path, class_names: dict[int, str]) -> Frames:
    """A row for each frame's folder, with the columns of the index that its small files tell.

    Raises
    ------
    DatasetError : a frame's file cannot be read.
    """
    rows = []
    root = SafePath(folder)
    for frame in (root / name for name in root.names() if os.path.lexists(folder / name / "semantic.png")):
        try:
            rows.append(_row(frame, class_names))
        except _UNREADABLE as error:
            got = " ".join(str(error).split())[:200]
            hint = "forestgen labels check names what is wrong"
            raise DatasetError("a frame cannot be read", where=str(frame), got=got, hint=hint) from error
    return frames_of(rows)


def _row(frame: SafePath, class_names: dict[int, str]) -> dict[str, Any]:
    number, _, camera = frame.name.partition("-")
    if not is_frame(frame.name):
        raise ValueError("the folder has no frame's name")
    return {
        "frame": frame.name,
        "folder": frame.name,
        "split": "",
        "image": int(number),
        "camera": camera,
        **_camera(frame / "camera.json"),
        "class_pixels": _class_pixels(frame / "semantic.png", class_names),
        **_plants(frame / "plants.parquet"),
        **_drawn(frame / "recipe.yaml"),
    }


def _camera(path: SafePath) -> dict[str, Any]:
    content = path.read_json()
    width_px, height_px = (int(side) for side in content["size_px"])
    return {"camera_kind": str(content.get("model") or ""), "width_px": width_px, "height_px": height_px}


def _class_pixels(path: SafePath, class_names: dict[int, str]) -> dict[str, int]:
    with path.open() as stream, Image.open(stream, formats=("PNG",)) as image:
        counts = np.bincount(np.asarray(image).ravel())
    return {class_names.get(int(number), f"class {number}"): int(counts[number]) for number in np.flatnonzero(counts)}


def _plants(path: SafePath) -> dict[str, Any]:
    with path.open() as stream, pq.ParquetFile(stream) as file:
        check_cells(file.metadata.num_rows, file.metadata.num_columns)
        table = file.read(columns=["species", "visible_pixels"])
    pixels: NDArray[np.int64] = table.column("visible_pixels").to_numpy()
    species = np.asarray(table.column("species").to_pylist(), dtype=object)
    seen = pixels > 0
    names, index = np.unique(species[seen].astype(str), return_inverse=True)
    instances, won = np.bincount(index, minlength=len(names)), np.zeros(len(names), dtype=np.int64)
    np.add.at(won, index, pixels[seen])
    return {
        "plants": len(pixels),
        "plants_in_view": int(seen.sum()),
        "instance_pixels_histogram": np.bincount(np.log2(pixels[seen]).astype(int)).tolist(),
        "species_instances": dict(zip(names.tolist(), instances.tolist(), strict=True)),
        "species_pixels": dict(zip(names.tolist(), won.tolist(), strict=True)),
    }


def _drawn(path: SafePath) -> dict[str, Any]:
    """What the drawn recipe says of sky and season."""
    recipe, _ = parse_yaml(path.read().decode("utf-8"), path.name, error=DatasetError, lines=False)
    if not isinstance(recipe, dict):
        raise ValueError("recipe.yaml is no mapping")
    sky = {name: _within(recipe.get("sky"), keys) for name, keys in _SKY.items()}
    if sky["clouds"] != "noise":
        sky["cloud_cover"] = None  # which others do not heed
    return {
        **sky,
        "season": _within(recipe.get("plants"), ("season",)),
    }


def _within(section: Any, keys: tuple[str, ...]) -> Any:
    for key in keys:
        section = section.get(key) if isinstance(section, dict) else None
    return section
