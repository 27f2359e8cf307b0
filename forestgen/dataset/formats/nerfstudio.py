"""nerfstudio: transforms.json of an image's cameras, for radiance fields and splats.

A recipe's image is a scene of its own, and a transforms.json describes one scene. So a data set of one image has
``transforms.json``; one of many has ``transforms-000000.json``, ``transforms-000001.json`` and so on, an image each.
nerfstudio takes either by its path (`--data DIR/transforms.json`). Frames are in the order of their folders' names. The
shard is the frame's camera.json.

| field | what it is |
|---|---|
| `camera_model` | `OPENCV`: a pinhole with distortion, which is 0 here |
| `w`, `h`, `fl_x`, `fl_y`, `cx`, `cy` | of each frame, pixels; pixel centres at +0.5, as nerfstudio has them |
| `k1`, `k2`, `p1`, `p2` | 0 |
| `file_path` | the frame's preview.png, from the data set's folder |
| `transform_matrix` | 4 x 4, camera to world, in metres; the camera's x right, y up, z backward (OpenGL's axes) |
| `depth_file_path` | the frame's depth.png, where the recipe asks for `depth_png`: depth along the axis, not the ray |
| `depth_unit_scale_factor` | metres of a step of depth.png; nerfstudio wants it as an option of the same name as well |
| `time` | seconds since the beginning of the camera path, for a frame of one |

The world is that of all files: x east, y north, z up. Each preview.png is tone mapped by itself: where brightness must
agree between views, take `radiance` of frame.exr. In wind, plants move between the frames of a path.

References
----------
Tancik et al. 2023, "Nerfstudio: a modular framework for neural radiance field development".
nerf.studio, "Data conventions".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.dataset.files import write_json
from forestgen.dataset.formats.shards import in_order, read_shard
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame

CAMERA_NAME = "camera.json"
DEPTH_NAME = "depth.png"

_SHARD: dict[str, type] = {"K": list[list[Any]], "size_px": list[int], "world_from_camera": list[list[Any]]}


def write_frame(folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
    """Nothing: every frame has its camera.json."""


def merge(root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
    """Write the transforms of each image.

    Raises
    ------
    OutputError
        When a camera.json is missing or damaged, or a file cannot be written.
    """
    images: dict[str, list[str]] = {}
    for folder in in_order(folders):
        images.setdefault(folder.partition("-")[0], []).append(folder)
    for image, own in images.items():
        name = "transforms.json" if len(images) == 1 else f"transforms-{image}.json"
        write_json(root / name, _transforms(root, own, settings))


def _transforms(root: Path, folders: Sequence[str], settings: DatasetSettings) -> dict[str, Any]:
    content: dict[str, Any] = {
        "camera_model": "OPENCV",
        "frames": [_frame(root, folder, settings) for folder in folders],
    }
    if "depth_png" in settings.formats:
        content["depth_unit_scale_factor"] = settings.depth_unit_m
    return content


def _frame(root: Path, folder: str, settings: DatasetSettings) -> dict[str, Any]:
    camera = read_shard(root / folder / CAMERA_NAME, _SHARD)
    k = camera["K"]
    width, height = camera["size_px"]
    opencv_from_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frame = {
        "file_path": f"{folder}/preview.png",
        "transform_matrix": (np.asarray(camera["world_from_camera"]) @ opencv_from_opengl).tolist(),
        "fl_x": k[0][0],
        "fl_y": k[1][1],
        "cx": k[0][2],
        "cy": k[1][2],
        "w": width,
        "h": height,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
    }
    if "depth_png" in settings.formats:
        frame["depth_file_path"] = f"{folder}/{DEPTH_NAME}"
    if camera.get("sequence") is not None:
        frame["time"] = camera["time_s"]
    return frame
