"""coco.json: its structure, and each annotation against the masks and plants.parquet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.check import DatasetCheck, FrameCheck
from forestgen.dataset.check.files import read_json
from forestgen.dataset.check.finding import MISUNDERSTOOD, Finding, misunderstood, number
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.keypoints import NAMES, has_keypoints
from forestgen.dataset.check.merged import COCO, Merged, folder_of
from forestgen.dataset.check.rle import decode
from forestgen.dataset.safe_path import SafePath

SHARD = "annotations.json"
_SAME = ("visible_area_px", "distance_m", "age_yr", "height_m", "crown_width_m", "dbh_m", "leaf_area_m2")
_AMODAL = (("amodal_area", "amodal_pixels"), ("visible_fraction", "visible_fraction"), ("truncation", "truncation"))
_TOLERANCE = 1e-6


def has_coco(merged: Merged) -> bool:
    return merged.has(COCO)


def has_share(frame: FrameData) -> bool:
    return COCO in frame.task.shared


def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image; ids are unique; images, categories and licences that are named are there."""
    coco = merged.coco
    for key in ("images", "annotations", "categories", "licenses"):
        for one, times in Counter(entry.get("id") for entry in coco[key]).items():
            if times > 1 or one is None:
                problem = f"an id comes twice in {key}" if one is not None else f"an entry of {key} has no id"
                yield Finding(COCO, problem, expected="each once", got=str(one))
    images, categories = ({entry.get("id") for entry in coco[key]} for key in ("images", "categories"))
    listed, wanted = [str(entry["name"]) for entry in coco["categories"]], merged.category_names
    if listed != wanted:
        yield Finding(COCO, "the categories are not the recipe's", ", ".join(wanted), ", ".join(listed))
    licences = {entry["id"] for entry in coco["licenses"]}
    folders = [folder_of(image["file_name"]) for image in coco["images"]]
    entries = Counter(folders)
    for name in merged.frames:
        if entries[name] != 1:
            yield Finding(COCO, "a frame is not one image", "1 entry", str(entries[name]), name)
    for image, folder in zip(coco["images"], folders, strict=True):
        for key in ("file_name", "camera"):
            if key in image and not SafePath(merged.root, str(image[key])).is_file():
                yield Finding(COCO, f"an image's {key} is not there", got=str(image[key]), image=folder)
        if image.get("license", None) not in licences | {None}:
            yield Finding(COCO, "an image's licence is not listed", got=str(image["license"]), image=folder)
    for one in coco["annotations"]:
        for key, known in (("image_id", images), ("category_id", categories)):
            if one.get(key) not in known:
                problem = f"annotation {one.get('id')}: no such {key}"
                got = str(one.get(key))
                yield Finding(COCO, problem, expected="a listed one", got=got, plant_id=one.get("plant_id"))


def plants(frame: FrameData) -> Iterator[Finding]:
    """The plants of the image are annotated, each once, with its own box, area and mask."""
    share = frame.task.shared[COCO]
    image, found = share["image"], share["annotations"]
    if (image["width"], image["height"]) != frame.size_px:
        got = f"{image['width']} x {image['height']}"
        yield _finding(frame, "the image has another size", "{} x {}".format(*frame.size_px), got)
        return
    listed = Counter(one["plant_id"] for one in found)
    for plant, times in sorted(listed.items()):
        if times > 1:
            yield _finding(frame, "a plant is annotated twice", "once", times, plant)
        if plant not in frame.extents.row_of:
            yield _finding(frame, "an annotated plant is not in the image", "a plant of the mask", "none", plant)
    for plant in frame.extents.row_of:
        if plant not in listed:
            yield _finding(frame, "a plant of the image has no annotation", "one", "none", plant)
    for one in found:
        if one["plant_id"] in frame.extents.row_of:
            try:
                yield from _annotation(frame, one, share["categories"])
            except MISUNDERSTOOD as error:  # the other plants' annotations are checked all the same
                yield misunderstood(COCO, error, frame.name, one["plant_id"])


def _annotation(frame: FrameData, one: dict[str, Any], categories: dict[int, str]) -> Iterator[Finding]:
    plant = one["plant_id"]
    seen = frame.extents.row_of[plant]
    pixels, box = int(frame.extents.pixels[seen]), frame.extents.box_px[seen]
    if one["area"] != pixels:
        yield _finding(frame, "area is not the mask's pixel count", pixels, one["area"], plant)
    if list(one["bbox"]) != box.tolist():
        yield _finding(frame, "bbox is not tight around the mask", box.tolist(), one["bbox"], plant)
    species = frame.plants["species"][frame.row_of[plant]] if plant in frame.row_of else None
    if one.get("species", species) != species:
        yield _finding(frame, "species is not plants.parquet's", species, one["species"], plant)
    category, got = frame.categories.get(plant), categories.get(one["category_id"])
    if got != category:
        yield _finding(frame, "the category is not that of the plant's species", category, got, plant)
    yield from _same_mask(frame, "segmentation", one["segmentation"], plant, frame.instance)


def _same_mask(frame: FrameData, key: str, code: Any, plant: int, ids: NDArray[np.integer]) -> Iterator[Finding]:
    """A run-length code and the pixels of `ids` (H, W) that it should be; none of them is outside the plant's box."""
    try:
        mask = decode(code, frame.size_px)
    except ValueError as error:
        yield _finding(frame, f"{key} is no run-length code", "COCO's compressed code", str(error), plant)
        return
    if mask.area != mask.library_area:
        yield _finding(frame, f"{key}: pycocotools has another area", mask.area, mask.library_area, plant)
    x, y, w, h = (int(side) for side in frame.extents.box_px[frame.extents.row_of[plant]])
    own = ids[y : y + h, x : x + w] == plant
    if (mask.window(x, y, w, h) != own).any() or mask.area != int(np.count_nonzero(own)):
        truth = ids == plant
        differs = mask.window(0, 0, *frame.size_px) != truth
        line, column = np.argwhere(differs)[0].tolist()
        yield Finding(
            COCO,
            f"{key} is not the mask",
            expected="in the mask" if truth[line, column] else "outside the mask",
            got=f"the opposite, there and in {int(differs.sum()) - 1} other pixels",
            image=frame.name,
            plant_id=plant,
            pixel=(column, line),
        )


def stems(frame: FrameData) -> Iterator[Finding]:
    """stem_segmentation is the plant's pixels that are trunk; it is absent where there are none."""
    trunk = frame.part == int(Part.TRUNK)
    stem = np.where(trunk, frame.instance, 0)
    having = set(np.unique(stem).tolist()) - {0}
    for one in frame.task.shared[COCO]["annotations"]:
        plant, code = one["plant_id"], one.get("stem_segmentation")
        if (code is not None) != (plant in having):
            expected = "one" if plant in having else "none"
            yield _finding(frame, "stem_segmentation and trunk pixels disagree", expected, str(code)[:40], plant)
        elif code is not None:
            yield from _same_mask(frame, "stem_segmentation", code, plant, stem)


def measures(frame: FrameData) -> Iterator[Finding]:
    """Numbers that plants.parquet holds too are the same; null is null."""
    plants = frame.plants
    for one in frame.task.shared[COCO]["annotations"]:
        plant = one["plant_id"]
        row = frame.row_of.get(plant)
        if row is None:
            continue
        pairs = [(key, key) for key in _SAME] + [pair for pair in _AMODAL if pair[0] in one] + [("truncated",) * 2]
        for key, column in pairs:
            if key in one and frame.known(column):
                stored = float(plants[column][row])
                got = np.nan if one[key] is None else float(one[key])
                if not (got == stored or (np.isnan(got) and np.isnan(stored))):
                    yield _finding(frame, f"{key} is not plants.parquet's", number(stored), number(got), plant)


def amodal(frame: FrameData) -> Iterator[Finding]:
    """amodal_segmentation holds the visible mask; its area and box are its own."""
    for one in frame.task.shared[COCO]["annotations"]:
        if "amodal_segmentation" not in one or one["plant_id"] not in frame.extents.row_of:
            continue
        plant = one["plant_id"]
        try:
            mask = decode(one["amodal_segmentation"], frame.size_px)
        except ValueError as error:
            problem = "amodal_segmentation is no run-length code"
            yield _finding(frame, problem, "COCO's compressed code", str(error), plant)
            continue
        if not one["amodal_area"] == mask.area == mask.library_area:
            problem = "amodal_area is not the amodal mask's pixel count"
            yield _finding(frame, problem, mask.area, one["amodal_area"], plant)
        box = mask.library_box
        if list(one["amodal_bbox"]) != box:
            yield _finding(frame, "amodal_bbox is not tight around the amodal mask", box, one["amodal_bbox"], plant)
        if plant in frame.row_of and frame.known("amodal_box_x"):
            stored = [frame.plants[f"amodal_box_{side}"][frame.row_of[plant]] for side in "xywh"]
            if list(one["amodal_bbox"]) != stored:
                yield _finding(frame, "amodal_bbox is not plants.parquet's", stored, one["amodal_bbox"], plant)
        x, y, w, h = (int(side) for side in frame.extents.box_px[frame.extents.row_of[plant]])
        lost = (frame.instance[y : y + h, x : x + w] == plant) & ~mask.window(x, y, w, h)
        if lost.any():
            line, column = np.argwhere(lost)[0].tolist()
            problem = "a visible pixel is outside the amodal mask"
            yield Finding(COCO, problem, image=frame.name, plant_id=plant, pixel=(x + column, y + line))


def points(frame: FrameData) -> Iterator[Finding]:
    """Keypoints are plants.parquet's: x, y, v of stem base, tip and crown centre; 0, 0, 0 outside the image."""
    plants = frame.plants
    for one in frame.task.shared[COCO]["annotations"]:
        row = frame.row_of.get(one["plant_id"])
        if "keypoints" not in one or row is None:
            continue
        expected: list[float] = []
        for name in NAMES:
            x, y, v = (float(plants[f"{name}_{end}"][row]) for end in ("x_px", "y_px", "state"))
            expected += [x, y, v] if v > 0 else [0.0, 0.0, 0.0]
        if list(one["keypoints"]) != expected:
            yield _finding(frame, "keypoints are not plants.parquet's", expected, one["keypoints"], one["plant_id"])
        shown = sum(v > 0 for v in one["keypoints"][2::3])
        if one.get("num_keypoints") != shown:
            problem = "num_keypoints does not count the keypoints inside the image"
            yield _finding(frame, problem, shown, one.get("num_keypoints"), one["plant_id"])


def shard(frame: FrameData) -> Iterator[Finding]:
    """The frame's own annotations.json holds what coco.json holds of it."""
    own = read_json(frame.task.root, frame.file(SHARD))["annotations"]
    share = frame.task.shared[COCO]["annotations"]
    if len(own) != len(share):
        yield _finding(frame, f"{SHARD} has another number of annotations", len(own), len(share))
    listed = {one["plant_id"]: one for one in own}
    for merged in share:
        mine = listed.get(merged["plant_id"], {})
        plain = {key: value for key, value in merged.items() if key not in ("id", "image_id")}
        for key in sorted({*mine, *plain} if mine else {"plant_id"}):
            if mine.get(key) != plain.get(key):
                got, expected = str(plain.get(key))[:80], str(mine.get(key))[:80]
                yield _finding(frame, f"{key} is not {SHARD}'s", expected, got, plain.get("plant_id"))
    for plant in sorted(listed.keys() - {one["plant_id"] for one in share}):
        yield _finding(frame, f"an annotation of {SHARD} is not in {COCO}", "one", "none", plant)


def has_shard(frame: FrameData) -> bool:
    return has_share(frame) and frame.has(SHARD)


def has_points(frame: FrameData) -> bool:
    return has_share(frame) and has_keypoints(frame)


def has_amodal(frame: FrameData) -> bool:
    return has_share(frame) and any("amodal_segmentation" in one for one in frame.task.shared[COCO]["annotations"])


def _finding(frame: FrameData, problem: str, expected: object, got: object, plant: int | None = None) -> Finding:
    return Finding(COCO, problem, expected=str(expected), got=str(got), image=frame.name, plant_id=plant)


FRAME_CHECKS = (
    FrameCheck("coco", "annotations are the mask's plants", COCO, has_share, plants, True),
    FrameCheck("coco stems", "stem masks are the trunks", COCO, has_share, stems, True),
    FrameCheck("coco amodal", "amodal masks hold visible ones", COCO, has_amodal, amodal, True),
    FrameCheck("coco keypoints", "keypoints are plants.parquet's", COCO, has_points, points, True),
    FrameCheck("coco measures", "numbers are plants.parquet's", COCO, has_share, measures, True),
    FrameCheck("coco shard", "annotations.json is coco.json's share", SHARD, has_shard, shard),
)
DATASET_CHECKS = (DatasetCheck("coco files", "images, ids, categories, licences", COCO, has_coco, structure),)
