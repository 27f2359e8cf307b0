"""coco.json: COCO instances of all frames, with run-length masks.

Beyond COCO's own fields an annotation holds `plant_id`, `visible_area_px` (sum of coverage, where `area` counts
pixels) and `truncated`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.labels.plants_table import VisiblePlants


@dataclass(frozen=True)
class FrameRecord:
    """What coco.json needs of one frame."""

    folder_name: str
    size_px: tuple[int, int]  # width, height
    species_names: tuple[str, ...]  # in the recipe's order: category id is the position + 1
    annotations: tuple[dict[str, Any], ...]  # COCO annotations without `id` and `image_id`


def encode_masks(instance: NDArray[np.uint32]) -> dict[int, dict[str, Any]]:
    """Run-length code of every plant of a mask, in one pass over the pixels.

    Parameters
    ----------
    instance : (H, W) uint32; 0 is no plant.

    Returns
    -------
    plant_id -> COCO's compressed RLE, ``{"size": [H, W], "counts": str}``, ids rising.
    """
    height, width = instance.shape
    flat = instance.T.ravel()  # COCO runs go down the columns
    first = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    owner = flat[first]
    end = np.concatenate([first[1:], [flat.size]])
    order = np.argsort(owner, kind="stable")
    ids, begin = np.unique(owner[order], return_index=True)
    groups = np.split(order, begin[1:])
    return {
        int(plant): _compress(first[runs], end[runs], height, width)
        for plant, runs in zip(ids, groups, strict=True)
        if plant != 0
    }


def _compress(first: NDArray[np.intp], end: NDArray[np.intp], height: int, width: int) -> dict[str, Any]:
    """RLE of runs [first, end) of ones: alternating lengths of zeros and ones, zeros first."""
    from pycocotools import mask

    edges = np.stack([first, end], axis=1).ravel()
    counts = np.diff(edges, prepend=0)
    if edges[-1] != height * width:
        counts = np.append(counts, height * width - edges[-1])
    rle = mask.frPyObjects({"size": [height, width], "counts": counts.tolist()}, height, width)
    return {"size": [height, width], "counts": rle["counts"].decode("ascii")}


def frame_annotations(
    instance: NDArray[np.uint32], visible: VisiblePlants, species: NDArray[np.integer]
) -> tuple[dict[str, Any], ...]:
    """COCO annotations of the plants that win a pixel, by rising plant_id.

    Parameters
    ----------
    instance : (H, W) uint32.
    visible : of the same mask.
    species : (N,) index of each plant's species in the recipe's order.
    """
    codes = encode_masks(instance)
    return tuple(
        {
            "area": int(visible.visible_pixels[row]),
            "bbox": [float(side) for side in visible.box_px[row]],
            "category_id": int(species[row]) + 1,
            "iscrowd": 0,
            "plant_id": int(visible.plant_id[row]),
            "segmentation": codes[int(visible.plant_id[row])],
            "truncated": bool(visible.truncated[row]),
            "visible_area_px": float(visible.visible_area_px[row]),
        }
        for row in np.flatnonzero(visible.has_box)
    )


def coco_dataset(frames: Iterable[FrameRecord], species_names: Sequence[str]) -> dict[str, Any]:
    """The content of coco.json.

    Images are numbered from 1 in the order of their folders' names, annotations from 1 in that order and by plant_id;
    an image's `file_name` is its preview, relative to coco.json.
    """
    ordered = sorted(frames, key=lambda frame: frame.folder_name)
    names = tuple(species_names)
    images: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    for image_id, frame in enumerate(ordered, start=1):
        if frame.species_names != names:
            raise OutputError(
                "frames of one dataset must share their species",
                where=frame.folder_name,
                expected=", ".join(names),
                got=", ".join(frame.species_names),
            )
        width, height = frame.size_px
        file_name = f"{frame.folder_name}/preview.png"
        images.append({"id": image_id, "file_name": file_name, "width": width, "height": height})
        start = len(found) + 1
        found.extend({**one, "id": start + i, "image_id": image_id} for i, one in enumerate(frame.annotations))
    return {
        "info": {"description": "forestgen dataset", "version": "1"},
        "licenses": [],
        "images": images,
        "categories": [{"id": i, "name": name, "supercategory": "plant"} for i, name in enumerate(names, start=1)],
        "annotations": found,
    }
