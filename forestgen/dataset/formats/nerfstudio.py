"""nerfstudio: transforms.json of an image's cameras, for radiance fields and splats.

A recipe's image is a scene of its own, and a transforms.json describes one scene. So a data set of one image has
``transforms.json``; one of many has ``transforms-000000.json``, ``transforms-000001.json`` and so on, an image each.
nerfstudio takes either by its path (`--data DIR/transforms.json`). A transforms.json has one camera model: where the
cameras of an image are of several, those after the first have files of their own, ``transforms-fisheye.json`` or
``transforms-000000-fisheye.json``, named by camera.json's model. Frames are in the order of their folders' names. The
shard is the frame's camera.json. An orthographic camera has no such file: the recipe is refused.

| field | what it is |
|---|---|
| `camera_model` | `OPENCV`: a pinhole; `OPENCV_FISHEYE`: equidistant; `EQUIRECTANGULAR`: a panorama |
| `w`, `h`, `fl_x`, `fl_y`, `cx`, `cy` | of each frame, pixels; pixel centres at +0.5, as nerfstudio has them |
| | of a panorama fl_x = w / 2 and fl_y = h |
| `k1`, `k2`, `p1`, `p2` (`k3`, `k4` of a fisheye) | distortion, 0 but of lenses; these have `k3`, too |
| `file_path` | the frame's preview.png, from the data set's folder |
| `transform_matrix` | 4 x 4, camera to world, in metres; the camera's x right, y up, z backward (OpenGL's axes) |
| `depth_file_path` | the frame's depth.png, where the recipe asks for `depth_png`: a pinhole's depth along the axis |
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

from forestgen.core.errors import OutputError
from forestgen.dataset.files import write_json
from forestgen.dataset.formats.depth_png import FORMAT as DEPTH
from forestgen.dataset.formats.format import DatasetFormat, damaged, in_order, read_shard
from forestgen.dataset.settings import DatasetSettings
from forestgen.scene.projection import Exchange, Projection, projection_of_model

CAMERA_NAME = "camera.json"
DEPTH_NAME = "depth.png"

_SHARD: dict[str, type] = {"model": str, "size_px": list[int], "world_from_camera": list[list[Any]]}


class Nerfstudio(DatasetFormat):
    """Cameras for radiance fields and splats."""

    name = "nerfstudio"
    check_module = "forestgen.dataset.check.nerfstudio"

    def holds(self, projection: Projection) -> bool:
        return projection.exchange is not None

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write the transforms of each image; see `DatasetFormat.merge`."""
        images: dict[str, list[str]] = {}
        for folder in in_order(folders):
            images.setdefault(folder.partition("-")[0], []).append(folder)
        for image, own in images.items():
            models: dict[str, list[str]] = {}
            for folder in own:
                models.setdefault(read_shard(root / folder / CAMERA_NAME, _SHARD)["model"], []).append(folder)
            first = "transforms" if len(images) == 1 else f"transforms-{image}"
            for number, (model, folders_of_model) in enumerate(models.items()):
                name = f"{first}.json" if number == 0 else f"{first}-{model}.json"
                write_json(root / name, _transforms(root, model, folders_of_model, settings))


FORMAT = Nerfstudio()


def _transforms(root: Path, model: str, folders: Sequence[str], settings: DatasetSettings) -> dict[str, Any]:
    projection = projection_of_model(model)
    if projection is None or projection.exchange is None:
        path, hint = root / folders[0] / CAMERA_NAME, "leave nerfstudio out of dataset.formats"
        raise OutputError(f"nerfstudio has no {model} cameras", where=str(path), hint=hint)
    exchange, frames = projection.exchange, []
    for folder in folders:
        try:
            frames.append(_frame(root, folder, exchange, settings))
        except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:  # numbers that make no camera
            raise damaged(root / folder / CAMERA_NAME, f"{type(error).__name__}: {error}"[:200]) from error
    content: dict[str, Any] = {"camera_model": exchange.camera_model, "frames": frames}
    if DEPTH.name in settings.formats:
        content["depth_unit_scale_factor"] = settings.depth_unit_m
    return content


def _frame(root: Path, folder: str, exchange: Exchange, settings: DatasetSettings) -> dict[str, Any]:
    path = root / folder / CAMERA_NAME
    camera = read_shard(path, _SHARD)
    width, height = camera["size_px"]
    opencv_from_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    focal = (width / 2.0, float(height))
    if exchange.has_k:
        k = read_shard(path, {"K": list[list[Any]]})["K"]
        focal = (k[0][0], k[1][1])
    values = read_shard(path, {"distortion": list[float]})["distortion"] if exchange.distortion else []
    if len(values) < len(exchange.distortion):
        raise ValueError(f"{len(values)} coefficients of distortion, {len(exchange.distortion)} expected")
    distortion = dict(zip(exchange.distortion, values, strict=False))  # a pinhole's k3 is 0, and has no key
    frame = {
        "file_path": f"{folder}/preview.png",
        "transform_matrix": (np.asarray(camera["world_from_camera"]) @ opencv_from_opengl).tolist(),
        **dict(zip(("fl_x", "fl_y"), focal, strict=True)),
        **{"cx": width / 2.0, "cy": height / 2.0, "w": width, "h": height},
        **distortion,
    }
    if DEPTH.name in settings.formats:
        frame["depth_file_path"] = f"{folder}/{DEPTH_NAME}"
    if camera.get("sequence") is not None:
        frame["time"] = camera["time_s"]
    return frame
