"""The index of a folder that `forestgen render` wrote, which has none: read from the frames' own files."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError
from forestgen.dataset.report.frames import Frames, frames_of

_SKY = {"sun_elevation_deg": ("sun", "elevation_deg"), "sun_azimuth_deg": ("sun", "azimuth_deg"),
        "turbidity": ("turbidity",), "clouds": ("clouds", "type"), "cloud_cover": ("clouds", "cover")}  # fmt: skip


def plain_frames(folder: Path, class_names: dict[int, str]) -> Frames:
    """A row for each frame's folder, with the columns of the index that its small files tell.

    Raises
    ------
    DatasetError : a frame's file cannot be read.
    """
    rows = []
    for frame in sorted(path.parent for path in folder.glob("*/semantic.png")):
        try:
            rows.append(_row(frame, class_names))
        except (OSError, ValueError, KeyError, SyntaxError, pa.ArrowException) as error:
            got = " ".join(str(error).split())[:200]
            hint = "forestgen labels check names what is wrong"
            raise DatasetError("a frame cannot be read", where=str(frame), got=got, hint=hint) from error
    return frames_of(rows)


def _row(frame: Path, class_names: dict[int, str]) -> dict[str, Any]:
    number, _, camera = frame.name.partition("-")
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


def _camera(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text(encoding="utf-8"))
    size = content.get("size_px") or (None, None)
    return {"camera_kind": content.get("model"), "width_px": size[0], "height_px": size[1]}


def _class_pixels(path: Path, class_names: dict[int, str]) -> dict[str, int]:
    from PIL import Image

    with Image.open(path) as image:
        counts = np.bincount(np.asarray(image).ravel())
    return {class_names.get(int(number), f"class {number}"): int(counts[number]) for number in np.flatnonzero(counts)}


def _plants(path: Path) -> dict[str, Any]:
    table = pq.read_table(io.BytesIO(path.read_bytes()), columns=["species", "visible_pixels"])
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


def _drawn(path: Path) -> dict[str, Any]:
    """What the drawn recipe says of sky and season."""
    from ruamel.yaml import YAML

    recipe = YAML(typ="safe").load(path.read_bytes())
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
