"""coco.json: COCO instances of all frames, with amodal masks and keypoints.

Files: ``FRAME/annotations.json``, the shard, and ``coco.json``, merged. Images are numbered from 1 in the order of
their folders' names, annotations from 1 in that order and by plant_id, categories from 1. Categories are the recipe's
species or, where labels.classes are given, the classes that list species (labels/classes.py).

A plant is an instance in an image if it wins at least one pixel of the instance mask. Plants that are hidden wholly, or
that win no pixel though some samples hit them, are in plants.parquet alone. `iscrowd` is always 0.

Beyond COCO's own fields an annotation holds:

| field | what it is |
|---|---|
| `plant_id` | key of plants.parquet, the EXR and the other formats |
| `visible_area_px` | sum of the plant's coverage over all pixels, won or lost; `area` counts pixels won |
| `truncated` | a won pixel touches the image's border |
| `amodal_segmentation`, `amodal_bbox`, `amodal_area` | the plant alone, in the image: RLE, tight box, pixels |
| `visible_fraction` | visible_area_px by the amodal coverage, 0 to 1 |
| `full_bbox` | x, y, width, height of the projected plant, beyond the image too |
| `truncation` | share of full_bbox that lies outside the image |
| `stem_segmentation` | RLE of the pixels won by its trunk; absent where there are none |
| `species`, `status`, `age_yr` | the plant; a null, here and below, is unknown or none |
| `height_m`, `crown_width_m`, `dbh_m`, `leaf_area_m2` | its measures |
| `distance_m` | camera to stem base |

The amodal fields, `visible_fraction`, `full_bbox` and `truncation` are absent where the recipe leaves out `amodal`.

Pixels are squares: x and y run from 0 to the image's width and height, and a pixel's centre lies at +0.5. This holds
for boxes and keypoints. The keypoints are stem base, tip and crown centre, with COCO's v: 0 outside the image
(x = y = 0), 1 inside the image but hidden, 2 visible.

References
----------
Lin et al. 2014, "Microsoft COCO: Common Objects in Context"; the data format page of cocodataset.org.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.formats.format import (
    DatasetFormat,
    finite,
    in_order,
    json_text,
    numbering,
    read_frame,
    whole_file,
    write_list,
    write_shard,
)
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.tables import STATUS_NAMES
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import AmodalMasks, rows_of
from forestgen.labels.plants_table import KEYPOINTS

SHARD_NAME = "annotations.json"
FILE_NAME = "coco.json"
SKELETON = ((1, 3), (3, 2))  # COCO counts keypoints from 1

_SHARD: dict[str, type] = {"annotations": list[dict[str, Any]], "image": dict}


class Coco(DatasetFormat):
    """COCO instances of all frames."""

    name = "coco"
    check_module = "forestgen.dataset.check.coco"
    bytes_per_plant = 3000

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's annotations into its folder; a failure raises `OutputError`."""
        width, height = labelled.frame.camera.size_px
        shard = {
            "annotations": frame_annotations(labelled),
            "image": {"height": int(height), "width": int(width)},
            **numbering(settings),
        }
        write_shard(folder / SHARD_NAME, shard)

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write coco.json over all frames; see `DatasetFormat.merge`."""
        shards = ((folder, read_frame(root / folder / SHARD_NAME, _SHARD, settings)) for folder in in_order(folders))
        numbers = itertools.count(1)
        keypoints = {"keypoints": list(KEYPOINTS), "skeleton": [list(pair) for pair in SKELETON]}
        categories = [
            {"id": i, "name": name, "supercategory": "plant", **keypoints}
            for i, name in enumerate(settings.category_names, start=1)
        ]
        write_merged(
            root / FILE_NAME,
            shards,
            lambda _, shard: [{**one, "id": next(numbers)} for one in shard["annotations"]],
            categories,
            settings,
        )

    def card(self) -> str:
        return (
            "`SPLIT/coco.json` opens in pycocotools and in every loader of COCO; paths in it are relative to the "
            "split's folder."
        )


FORMAT = Coco()


def write_merged(
    path: Path,
    shards: Iterable[tuple[str, Mapping[str, Any]]],
    annotations_of: Callable[[str, Mapping[str, Any]], Iterable[Mapping[str, Any]]],
    categories: list[dict[str, Any]],
    settings: DatasetSettings,
) -> None:
    """Write a COCO file over all frames, `shards` being each one's folder and share in the order of the images.

    `annotations_of` such a frame have no `image_id` yet. No date in the file: equal data sets have equal files.
    """
    images: list[dict[str, Any]] = []
    licences = [{"id": 1, "name": settings.licence_name, "url": settings.licence_url}] if settings.licence_name else []

    def annotations() -> Iterator[dict[str, Any]]:
        for image_id, (folder, shard) in enumerate(shards, start=1):
            paths = {"camera": f"{folder}/camera.json", "file_name": f"{folder}/preview.png"}
            images.append({**shard["image"], **paths, "id": image_id, **({"license": 1} if licences else {})})
            yield from ({**one, "image_id": image_id} for one in annotations_of(folder, shard))

    info = {"contributor": settings.contributor, "description": settings.description, "version": "1"}
    with whole_file(path) as stream:
        stream.write('{"annotations":')
        write_list(stream, annotations())
        stream.write(',\n"categories":' + json_text(categories) + ',\n"images":')
        write_list(stream, images)
        stream.write(f',\n"info":{json_text(info)},\n"licenses":{json_text(licences)}}}\n')


def frame_annotations(labelled: LabelledFrame) -> list[dict[str, Any]]:
    """COCO annotations, without `id` and `image_id`, of the plants that win a pixel, by rising plant_id."""
    rows = np.flatnonzero(labelled.views.visible.has_box)
    masks = encode_masks(labelled.pixels.instance)
    is_stem = labelled.pixels.part == Part.TRUNK
    stems = encode_masks(np.where(is_stem, labelled.pixels.instance, np.uint32(0)))
    extra = _amodal_fields(labelled, rows)
    found = []
    for one, more in zip(_records(_fields(labelled, rows)), extra, strict=True):
        one["segmentation"] = masks[one["plant_id"]]
        if one["plant_id"] in stems:
            one["stem_segmentation"] = stems[one["plant_id"]]
        found.append({**one, **more, "iscrowd": 0})
    return found


def _fields(labelled: LabelledFrame, rows: NDArray[np.intp]) -> dict[str, list[Any]]:
    """Values of all plants of `rows`, by field."""
    population, views, measures = labelled.population, labelled.views, labelled.measures
    species = labelled.species[rows]
    state = views.keypoint_state[rows]
    return {
        "plant_id": population.plant_id[rows].tolist(),
        "category_id": (labelled.category[rows] + 1).tolist(),
        "species": [labelled.classes.species_names[i] for i in species],
        "status": [STATUS_NAMES[i] for i in population.status[rows].tolist()],
        "area": views.visible.visible_pixels[rows].tolist(),
        "bbox": views.visible.box_px[rows].astype(np.float64).tolist(),
        "visible_area_px": views.visible.visible_area_px[rows].tolist(),
        "truncated": views.visible.truncated[rows].tolist(),
        "keypoints": _keypoints(views.keypoint_px[rows], state),
        "num_keypoints": (state > 0).sum(axis=1).tolist(),
        "distance_m": _finite(views.distance_m[rows]),
        "age_yr": _finite(population.age_yr[rows]),
        "height_m": _finite(population.height_m[rows]),
        "crown_width_m": _finite(measures.crown_width_m[rows]),
        "dbh_m": _finite(measures.dbh_m[rows]),
        "leaf_area_m2": _finite(measures.leaf_area_m2[rows]),
    }


def _amodal_fields(labelled: LabelledFrame, rows: NDArray[np.intp]) -> list[dict[str, Any]]:
    amodal, views = labelled.amodal, labelled.views
    if amodal is None:
        return [{} for _ in rows]
    size_px = labelled.frame.camera.size_px
    own = rows_of(labelled.population.plant_id[rows], amodal.plant_id)
    left, top, right, bottom = amodal.full_box_px[own].T
    full = np.stack([left, top, right - left, bottom - top], axis=1)
    fields = {
        "amodal_segmentation": [_encode_amodal(amodal, row, size_px) for row in own.tolist()],
        "amodal_bbox": amodal.box_px[own].astype(np.float64).tolist(),
        "amodal_area": amodal.pixels[own].tolist(),
        "visible_fraction": _finite(views.visible_fraction[rows]),
        "truncation": _finite(views.truncation[rows]),
        "full_bbox": [box if np.isfinite(box).all() else None for box in full.tolist()],
    }
    return list(_records(fields))


def _keypoints(points_px: NDArray[np.float64], state: NDArray[np.uint8]) -> list[list[float]]:
    """Per plant x, y, v of each keypoint; 0, 0, 0 for those outside the image."""
    shown = np.where(state[..., None] > 0, points_px, 0.0)
    return [
        [value for (x, y), v in zip(points, states, strict=True) for value in (x, y, v)]
        for points, states in zip(shown.tolist(), state.tolist(), strict=True)
    ]


def _finite(values: NDArray[np.float64]) -> list[float | None]:
    return [finite(value) for value in values.tolist()]


def _records(fields: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(fields, values, strict=True)) for values in zip(*fields.values(), strict=True)]


def encode_masks(instance: NDArray[np.uint32]) -> dict[int, dict[str, Any]]:
    """Run-length codes of the plants of a mask (H, W) in one pass, plant_id -> {"size": [H, W], "counts": str}."""
    height, width = instance.shape
    flat = instance.T.ravel()
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


def _encode_amodal(amodal: AmodalMasks, row: int, size_px: tuple[int, int]) -> dict[str, Any]:
    """Run-length code, over the whole image of width and height `size_px`, of a row's amodal mask."""
    width, height = size_px
    left, top, _, _ = amodal.box_px[row].tolist()
    column, line = np.nonzero(amodal.mask_of(row).T)
    pixel = (column + left) * height + line + top
    if len(pixel) == 0:
        return _compress(pixel, pixel, height, width)
    breaks = np.flatnonzero(np.diff(pixel) != 1)
    first = pixel[np.concatenate([[0], breaks + 1])]
    end = pixel[np.concatenate([breaks, [len(pixel) - 1]])] + 1
    return _compress(first, end, height, width)


def _compress(first: NDArray[np.intp], end: NDArray[np.intp], height: int, width: int) -> dict[str, Any]:
    """RLE of runs [first, end) of ones: alternating lengths of zeros and ones, zeros first."""
    from pycocotools import mask

    edges = np.stack([first, end], axis=1).ravel()
    counts = np.diff(edges, prepend=0)
    if len(edges) == 0 or edges[-1] != height * width:
        counts = np.append(counts, height * width - (edges[-1] if len(edges) else 0))
    rle = mask.frPyObjects({"size": [height, width], "counts": counts.tolist()}, height, width)
    return {"size": [height, width], "counts": rle["counts"].decode("ascii")}
