"""bop/: poses, visible fractions and masks in the layout of BOP, the benchmark for poses of objects.

    bop/train_pbr/SCENE/scene_camera.json       per image: cam_K, depth_scale, cam_R_w2c, cam_t_w2c
    bop/train_pbr/SCENE/scene_gt.json           per image and plant: obj_id, cam_R_m2c, cam_t_m2c
    bop/train_pbr/SCENE/scene_gt_info.json      per image and plant: boxes, pixel counts, visib_fract
    bop/train_pbr/SCENE/rgb/IMAGE.png, depth/IMAGE.png, mask/IMAGE_PLANT.png, mask_visib/IMAGE_PLANT.png

A scene is a drawn recipe with all of its cameras: its number, like an image's in it, counts from 0 in the order of the
frames' names. Millimetres, OpenCV axes, matrices row by row, masks of 0 and 255, as BOP has them.

Where this differs from BOP:

- A plant is listed if it wins a pixel of the instance mask, by rising plant_id. BOP lists hidden objects too.
- `px_count_all` and `bbox_obj` are those of the amodal mask, so within the image; BOP's renderer looks past its
  border. `visib_fract` is px_count_visib / px_count_all, as in BOP: a ratio of pixels, where coco.json has one of
  coverages.
- `obj_id` is 1 + the exemplar's number in its scene. Another scene has exemplars of its own, and no models are
  written.
- Plants are scaled, and lean in the wind. `cam_R_m2c` is the rotation nearest to the plant's linear map; the map
  itself is `cam_A_m2c` (3 x 3, row by row): point in the camera = cam_A_m2c point in the exemplar + cam_t_m2c. The
  exemplar's origin is its stem base, not the centre of its box.
- Pixel centres lie at +0.5 in `cam_K`; for readers that put them at whole numbers, take 0.5 off its third column.
- `depth` is along z, in steps of depth_scale millimetres, 0 for the sky and for what lies beyond 65,534 steps.
- Further keys: `plant_id` in scene_gt.json, `frame` (the frame's folder) in scene_camera.json.

Amodal masks are needed. Files in the frame's folder: ``bop/shard.json`` and the pictures, which merging places.

References
----------
Hodan et al. 2018, "BOP: Benchmark for 6D Object Pose Estimation", ECCV; bop_toolkit, docs/bop_datasets_format.md.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.camera import camera_from_world
from forestgen.dataset.files import make_folder
from forestgen.dataset.formats.depth_png import BEYOND, encode_depth
from forestgen.dataset.formats.format import (
    DatasetFormat,
    in_order,
    json_text,
    place,
    read_shard,
    whole_file,
    write_shard,
)
from forestgen.dataset.png import write_png
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import rows_of
from forestgen.scene.projection import Projection, projection_of

FOLDER_NAME, SPLIT_NAME, SHARD_NAME = "bop", "train_pbr", "shard.json"
SCENE_FILES = ("scene_camera", "scene_gt", "scene_gt_info")
MASK_FOLDERS = ("mask", "mask_visib")
_FAST = 1  # of zlib: two pictures a plant, of almost nothing but zeros

_RECORDS = list[dict[str, Any]]
_SHARD: dict[str, type] = {"scene_camera": dict, "scene_gt": _RECORDS, "scene_gt_info": _RECORDS}


class Bop(DatasetFormat):
    """Poses, visible fractions and masks of each plant."""

    name = "bop"
    check_module = "forestgen.dataset.check.bop"
    bytes_per_pixel, bytes_per_plant = 7, 6000
    label_channels: Mapping[str, str] = {"amodal": "BOP's visible fractions need amodal masks"}

    def holds(self, projection: Projection) -> bool:
        return projection.is_pinhole

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's poses and pictures into its folder; a failure raises `OutputError`."""
        amodal, home, visible = labelled.amodal, folder / FOLDER_NAME, labelled.views.visible
        assert amodal is not None  # the recipe asks for it: see `label_channels`
        for name in MASK_FOLDERS:
            make_folder(home / name)
        steps = encode_depth(labelled.frame.surface.depth_m, settings.depth_unit_m)
        steps[steps == BEYOND] = 0
        write_png(home / "depth.png", steps)

        rows = np.flatnonzero(visible.has_box)
        plants = labelled.population.plant_id[rows]
        info = []
        for number, (row, own) in enumerate(zip(rows, rows_of(plants, amodal.plant_id), strict=True)):
            whole = np.zeros(steps.shape, dtype=np.bool_)
            left, top, width, height = amodal.box_px[own]
            whole[top : top + height, left : left + width] = amodal.mask_of(int(own))
            seen = labelled.pixels.instance == labelled.population.plant_id[row]
            for name, mask in zip(MASK_FOLDERS, (whole, seen), strict=True):
                write_png(
                    home / name / f"{number:06d}.png", mask.astype(np.uint8) * np.uint8(255), compress_level=_FAST
                )
            info.append(
                {
                    "bbox_obj": amodal.box_px[own].tolist(),
                    "bbox_visib": visible.box_px[row].tolist(),
                    "px_count_all": int(amodal.pixels[own]),
                    "px_count_valid": int((whole & (steps > 0)).sum()),
                    "px_count_visib": int(visible.visible_pixels[row]),
                    "visib_fract": float(visible.visible_pixels[row] / amodal.pixels[own]),
                }
            )
        camera = _camera_entry(labelled, settings.depth_unit_m)
        shard = {"scene_camera": camera, "scene_gt": _poses(labelled, rows), "scene_gt_info": info}
        write_shard(home / SHARD_NAME, shard)

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write the scenes' files over all frames, and place the frames' pictures; see `DatasetFormat.merge`."""
        scenes = groupby(in_order(folders), key=lambda folder: folder.partition("-")[0])
        for number, (_, members) in enumerate(scenes):
            _merge_scene(root, root / FOLDER_NAME / SPLIT_NAME / f"{number:06d}", list(members))


FORMAT = Bop()


def _merge_scene(root: Path, scene: Path, folders: list[str]) -> None:
    for name in ("rgb", "depth", *MASK_FOLDERS):
        make_folder(scene / name)
    with contextlib.ExitStack() as stack:
        streams = [stack.enter_context(whole_file(scene / f"{name}.json")) for name in SCENE_FILES]
        for image, folder in enumerate(folders):
            home = root / folder / FOLDER_NAME
            shard = read_shard(home / SHARD_NAME, _SHARD)
            shard["scene_camera"]["frame"] = folder
            for name, stream in zip(SCENE_FILES, streams, strict=True):
                stream.write(("{\n" if image == 0 else ",\n") + f'"{image}":{json_text(shard[name])}')
            place(root / folder / "preview.png", scene / "rgb" / f"{image:06d}.png")
            place(home / "depth.png", scene / "depth" / f"{image:06d}.png")
            for mask in MASK_FOLDERS:
                for plant in range(len(shard["scene_gt"])):
                    place(home / mask / f"{plant:06d}.png", scene / mask / f"{image:06d}_{plant:06d}.png")
        for stream in streams:
            stream.write("\n}\n")


def _camera_entry(labelled: LabelledFrame, depth_unit_m: float) -> dict[str, Any]:
    camera = labelled.frame.camera
    pose, k = camera_from_world(camera), projection_of(camera).intrinsics(camera)
    assert k is not None  # of those that the format holds
    return {
        "cam_K": k.ravel().tolist(),
        "cam_R_w2c": pose[:3, :3].ravel().tolist(),
        "cam_t_w2c": (pose[:3, 3] * 1000.0).tolist(),
        "depth_scale": depth_unit_m * 1000.0,
    }


def _poses(labelled: LabelledFrame, rows: NDArray[np.intp]) -> list[dict[str, Any]]:
    pose, measures = camera_from_world(labelled.frame.camera), labelled.measures
    transform = measures.world_from_exemplar[rows]
    linear = pose[:3, :3] @ transform[:, :, :3]
    origin = transform[:, :, 3] @ pose[:3, :3].T + pose[:3, 3]
    exemplar, plant = measures.exemplar[rows].tolist(), labelled.population.plant_id[rows].tolist()
    return [
        {
            "cam_A_m2c": linear[k].ravel().tolist(),
            "cam_R_m2c": nearest_rotation(linear[k]).ravel().tolist(),
            "cam_t_m2c": (origin[k] * 1000.0).tolist(),
            "obj_id": exemplar[k] + 1,
            "plant_id": plant[k],
        }
        for k in range(len(rows))
    ]


def nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rotation with the least Frobenius distance to a linear map (the orthogonal Procrustes problem)."""
    left, _, right = np.linalg.svd(matrix)
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    return np.asarray(left @ right)
