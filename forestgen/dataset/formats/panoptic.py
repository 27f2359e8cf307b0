"""panoptic.json and panoptic/FRAME.png: COCO panoptic segmentation.

Every pixel belongs to a segment. Things are plants, by category; stuff is ground (with litter, rock and water) and sky.
A picture holds a segment's id as a colour, id = R + 256 G + 65536 B. A plant's segment id is its plant_id; the two
largest ids of 24 bits stand for ground and sky, since 0 is COCO's mark for pixels without a label:

| segment | id | category |
|---|---|---|
| plant | plant_id | its species, or its class of labels.classes: as in coco.json |
| ground | 16,777,214 | number of plants' categories + 1 |
| sky | 16,777,215 | number of plants' categories + 2 |

A frame that shows a plant with an id above 16,777,213 is refused: the format cannot hold it.

Files: ``FRAME/panoptic.png`` and ``FRAME/panoptic.json``, the shard; merged, ``panoptic/FRAME.png`` (a hard link of the
first where the disk can) and ``panoptic.json``. Image ids are those of coco.json. `segments_info` lists plants by
rising id, then ground, then sky, with area in pixels and a tight box.

References
----------
Kirillov et al. 2019, "Panoptic Segmentation", CVPR; the panoptic data format of cocodataset.org.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.core.parts import Part
from forestgen.dataset import png
from forestgen.dataset.formats.coco import write_merged
from forestgen.dataset.formats.format import DatasetFormat, in_order, numbering, place, read_frame, write_shard
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import instance_mask

SHARD_NAME, PICTURE_NAME = "panoptic.json", "panoptic.png"
FILE_NAME, FOLDER_NAME = "panoptic.json", "panoptic"
SKY_ID = png.MAX_PNG_ID
GROUND_ID = png.MAX_PNG_ID - 1
MOST_PLANT_ID = png.MAX_PNG_ID - 2

_SHARD: dict[str, type] = {"segments_info": list[dict[str, Any]], "image": dict}


class Panoptic(DatasetFormat):
    """COCO panoptic: plants, ground and sky."""

    name = "panoptic"
    check_module = "forestgen.dataset.check.panoptic"
    bytes_per_pixel, bytes_per_plant = 6, 400

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's picture and segments into its folder; a plant's id that does not fit is refused before."""
        instance = labelled.pixels.instance
        _require_fitting(instance, str(folder / PICTURE_NAME))
        segments = segment_ids(instance, labelled.pixels.part)
        width, height = labelled.frame.camera.size_px
        shard = {
            "image": {"height": int(height), "width": int(width)},
            "segments_info": segments_info(segments, labelled),
            **numbering(settings),
        }
        png.write_instance(folder / PICTURE_NAME, segments)
        write_shard(folder / SHARD_NAME, shard)

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write panoptic.json over all frames, and place their pictures beside it; see `DatasetFormat.merge`."""

        def annotations_of(folder: str, shard: Mapping[str, Any]) -> list[dict[str, Any]]:
            name = f"{folder}.png"
            place(root / folder / PICTURE_NAME, root / FOLDER_NAME / name)
            return [{"file_name": name, "segments_info": shard["segments_info"]}]

        shards = ((folder, read_frame(root / folder / SHARD_NAME, _SHARD, settings)) for folder in in_order(folders))
        write_merged(root / FILE_NAME, shards, annotations_of, categories(settings.category_names), settings)

    def check_ids(self, plant_id: NDArray[np.uint32], where: str) -> None:
        if plant_id.max(initial=0) > MOST_PLANT_ID:
            _require_fitting(instance_mask(plant_id), where)


FORMAT = Panoptic()


def _require_fitting(instance: NDArray[np.uint32], where: str) -> None:
    """Raise `OutputError` if an (H, W) mask of plants has an id that the pictures cannot hold."""
    largest = int(instance.max(initial=0))
    if largest > MOST_PLANT_ID:
        problem = "a plant_id does not fit the 24 bits of a panoptic picture, of which two ids are ground and sky"
        hint = "leave panoptic out of dataset.formats: coco.json and frame.exr hold ids of 32 bits"
        raise OutputError(problem, where=where, expected=f"ids up to {MOST_PLANT_ID}", got=str(largest), hint=hint)


def segment_ids(instance: NDArray[np.uint32], part: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(H, W) uint32 segment of each pixel: its plant, or ground, or sky where the part is nothing."""
    background = np.where(part == Part.NOTHING, np.uint32(SKY_ID), np.uint32(GROUND_ID))
    return np.where(instance != 0, instance, background).astype(np.uint32)


def segments_info(segments: NDArray[np.uint32], labelled: LabelledFrame) -> list[dict[str, Any]]:
    """Area, box and category of each segment of a picture."""
    visible = labelled.views.visible
    rows = np.flatnonzero(visible.has_box)
    columns = zip(
        visible.plant_id[rows].tolist(),
        (labelled.category[rows] + 1).tolist(),
        visible.visible_pixels[rows].tolist(),
        visible.box_px[rows].tolist(),
        strict=True,
    )
    found = [_segment(plant, category, area, box) for plant, category, area, box in columns]
    things = len(labelled.classes.instance_categories[0])
    for segment, category in ((GROUND_ID, things + 1), (SKY_ID, things + 2)):
        y, x = np.nonzero(segments == segment)
        if len(x):
            left, top = int(x.min()), int(y.min())
            box = [left, top, int(x.max()) - left + 1, int(y.max()) - top + 1]
            found.append(_segment(segment, category, len(x), box))
    return found


def categories(names: Sequence[str]) -> list[dict[str, Any]]:
    """Those of plants, then ground, then sky, in the colours of semantic.png's default classes."""
    sky, ground, *plants = png.class_palette(len(names) + 2).tolist()
    things = [
        {"color": colour, "id": i, "isthing": 1, "name": name, "supercategory": "plant"}
        for i, (name, colour) in enumerate(zip(names, plants, strict=True), start=1)
    ]
    stuff = [
        {"color": colour, "id": len(things) + i, "isthing": 0, "name": name, "supercategory": "background"}
        for i, (name, colour) in enumerate((("ground", ground), ("sky", sky)), start=1)
    ]
    return things + stuff


def _segment(segment: int, category: int, area: int, box: list[int]) -> dict[str, Any]:
    return {"area": area, "bbox": box, "category_id": category, "id": segment, "iscrowd": 0}
