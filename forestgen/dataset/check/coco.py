"""coco.json: its structure, and each annotation against the masks and plants.parquet.

Run-length codes are read from their definition, and checked before any library decodes them. A code's characters carry
5 bits each, low first, from 48 on; bit 5 says that more follow, and the last one's bit 4 is the sign. Numbers are
lengths of runs of zeros and ones in turn, down the columns; from the fourth on each is the difference to the number two
before.

References
----------
maskApi.c of the COCO API: rleToString, rleFrString.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import MISUNDERSTOOD, Finding, finding, misunderstood, read_json
from forestgen.dataset.check.frame_data import FrameData, frame_check
from forestgen.dataset.check.masks import KEYPOINT_COLUMNS, KEYPOINTS
from forestgen.dataset.check.merged import Merged, dataset_check, folder_of
from forestgen.dataset.safe_path import SafePath

_FILE, _SHARD, _FORMAT = "coco.json", "annotations.json", "coco"
_LISTS = ("images", "annotations", "categories", "licenses")
_SAME = ("visible_area_px", "distance_m", "age_yr", "height_m", "crown_width_m", "dbh_m", "leaf_area_m2", "truncated")
_AMODAL = (("amodal_area", "amodal_pixels"), ("visible_fraction", "visible_fraction"), ("truncation", "truncation"))
_CODE = "COCO's compressed code"


def frame_shares(merged: Merged) -> Mapping[str, Any]:
    """Frame -> its image and annotations in coco.json, and the categories' names."""
    if not merged.has(_FILE):
        return {}
    coco = merged.lists(_FILE, *_LISTS)
    names = {entry["id"]: entry["name"] for entry in coco["categories"]}
    frames = {
        folder_of(image["file_name"]): {"image": image, "annotations": [], "categories": names}
        for image in coco["images"]
    }
    by_id = {entry["image"]["id"]: entry["annotations"] for entry in frames.values()}
    for one in coco["annotations"]:
        if one.get("image_id") in by_id:
            by_id[one["image_id"]].append(one)
    return frames


@dataset_check("coco files", _FILE)
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image; ids are unique; images, categories and licences that are named are there."""
    coco = merged.lists(_FILE, *_LISTS)
    for key in _LISTS:
        for one, times in Counter(entry.get("id") for entry in coco[key]).items():
            if times > 1 or one is None:
                problem = f"an id comes twice in {key}" if one is not None else f"an entry of {key} has no id"
                yield finding(problem, "each once", one)
    images, categories = ({entry.get("id") for entry in coco[key]} for key in ("images", "categories"))
    listed, wanted = [str(entry["name"]) for entry in coco["categories"]], merged.category_names
    if listed != wanted:
        yield finding("the categories are not the recipe's", ", ".join(wanted), ", ".join(listed))
    licences = {entry["id"] for entry in coco["licenses"]}
    folders = [folder_of(image["file_name"]) for image in coco["images"]]
    entries = Counter(folders)
    for name in merged.frames:
        if entries[name] != 1:
            yield finding("a frame is not one image", "1 entry", entries[name], image=name)
    for image, folder in zip(coco["images"], folders, strict=True):
        for key in ("file_name", "camera"):
            if key in image and not SafePath(merged.root, str(image[key])).is_file():
                yield finding(f"an image's {key} is not there", got=image[key], image=folder)
        if image.get("license", None) not in licences | {None}:
            yield finding("an image's licence is not listed", got=image["license"], image=folder)
    for one in coco["annotations"]:
        for key, known in (("image_id", images), ("category_id", categories)):
            if one.get(key) not in known:
                problem = f"annotation {one.get('id')}: no such {key}"
                yield finding(problem, "a listed one", one.get(key), one.get("plant_id"))


@frame_check("coco", _FILE, share=_FORMAT, shared=True)
def plants(frame: FrameData) -> Iterator[Finding]:
    """The plants of the image are annotated, each once, with its own box, area and mask."""
    share = frame.shared[_FORMAT]
    image, found = share["image"], share["annotations"]
    if (image["width"], image["height"]) != frame.size_px:
        yield finding("the image has another size", frame.size_px, (image["width"], image["height"]))
        return
    listed = Counter(one["plant_id"] for one in found)
    for plant, times in sorted(listed.items()):
        if times > 1:
            yield finding("a plant is annotated twice", "once", times, plant)
        if plant not in frame.extents.row_of:
            yield finding("an annotated plant is not in the image", "a plant of the mask", "none", plant)
    for plant in frame.extents.row_of:
        if plant not in listed:
            yield finding("a plant of the image has no annotation", "one", "none", plant)
    for one in found:
        if one["plant_id"] in frame.extents.row_of:
            try:
                yield from _annotation(frame, one, share["categories"])
            except MISUNDERSTOOD as error:  # the other plants' annotations are checked all the same
                yield misunderstood(_FILE, error, frame.name, one["plant_id"])


def _annotation(frame: FrameData, one: dict[str, Any], categories: dict[int, str]) -> Iterator[Finding]:
    plant = one["plant_id"]
    seen = frame.extents.row_of[plant]
    pixels, box = int(frame.extents.pixels[seen]), frame.extents.box_px[seen].tolist()
    if one["area"] != pixels:
        yield finding("area is not the mask's pixel count", pixels, one["area"], plant)
    if list(one["bbox"]) != box:
        yield finding("bbox is not tight around the mask", box, one["bbox"], plant)
    species = frame.plants["species"][frame.row_of[plant]] if plant in frame.row_of else None
    if one.get("species", species) != species:
        yield finding("species is not plants.parquet's", species, one["species"], plant)
    category, got = frame.categories.get(plant), categories.get(one["category_id"])
    if got != category:
        yield finding("the category is not that of the plant's species", category, got, plant)
    yield from _same_mask(frame, "segmentation", one["segmentation"], plant, frame.instance)


def _same_mask(frame: FrameData, key: str, code: Any, plant: int, ids: NDArray[np.integer]) -> Iterator[Finding]:
    """A run-length code and the pixels of `ids` (H, W) that it should be; none of them is outside the plant's box."""
    try:
        runs = runs_of_ones(code, frame.size_px)
    except ValueError as error:
        yield finding(f"{key} is no run-length code", _CODE, error, plant)
        return
    height = frame.size_px[1]
    x, y, w, h = _box(frame, plant)
    own = ids[y : y + h, x : x + w] == plant
    if (window(runs, height, x, y, w, h) != own).any() or area(runs) != int(np.count_nonzero(own)):
        truth = ids == plant
        differs = window(runs, height, 0, 0, *frame.size_px) != truth
        line, column = np.argwhere(differs)[0].tolist()
        expected = "in the mask" if truth[line, column] else "outside the mask"
        got = f"the opposite, there and in {int(differs.sum()) - 1} other pixels"
        yield finding(f"{key} is not the mask", expected, got, plant, pixel=(column, line))


@frame_check("coco stems", _FILE, share=_FORMAT, shared=True)
def stems(frame: FrameData) -> Iterator[Finding]:
    """stem_segmentation is the plant's pixels that are trunk; it is absent where there are none."""
    stem = np.where(frame.part == int(Part.TRUNK), frame.instance, 0)
    having = set(np.unique(stem).tolist()) - {0}
    for one in _annotations(frame):
        plant, code = one["plant_id"], one.get("stem_segmentation")
        if (code is not None) != (plant in having):
            expected = "one" if plant in having else "none"
            yield finding("stem_segmentation and trunk pixels disagree", expected, str(code)[:40], plant)
        elif code is not None:
            yield from _same_mask(frame, "stem_segmentation", code, plant, stem)


@frame_check("coco measures", _FILE, share=_FORMAT, shared=True)
def measures(frame: FrameData) -> Iterator[Finding]:
    """Numbers that plants.parquet holds too are the same; null is null."""
    for one in _annotations(frame):
        row = frame.row_of.get(one["plant_id"])
        for key, column in (*((key, key) for key in _SAME), *_AMODAL):
            if row is not None and key in one and frame.known(column):
                stored = float(frame.plants[column][row])
                got = np.nan if one[key] is None else float(one[key])
                if not (got == stored or (np.isnan(got) and np.isnan(stored))):
                    yield finding(f"{key} is not plants.parquet's", stored, got, one["plant_id"])


@frame_check(
    "coco amodal", _FILE, share=_FORMAT, shared=True,
    when=lambda frame: any("amodal_segmentation" in one for one in _annotations(frame)),
)  # fmt: skip
def amodal(frame: FrameData) -> Iterator[Finding]:
    """amodal_segmentation holds the visible mask; its area and box are its own."""
    for one in _annotations(frame):
        plant = one["plant_id"]
        if "amodal_segmentation" not in one or plant not in frame.extents.row_of:
            continue
        code, got = one["amodal_segmentation"], list(one["amodal_bbox"])
        try:
            runs = runs_of_ones(code, frame.size_px)
        except ValueError as error:
            yield finding("amodal_segmentation is no run-length code", _CODE, error, plant)
            continue
        if one["amodal_area"] != area(runs):
            problem = "amodal_area is not the amodal mask's pixel count"
            yield finding(problem, area(runs), one["amodal_area"], plant)
        if got != (box := library_box(code)):
            yield finding("amodal_bbox is not tight around the amodal mask", box, got, plant)
        if plant in frame.row_of and frame.known("amodal_box_x"):
            stored = [frame.plants[f"amodal_box_{side}"][frame.row_of[plant]] for side in "xywh"]
            if got != stored:
                yield finding("amodal_bbox is not plants.parquet's", stored, got, plant)
        x, y, w, h = _box(frame, plant)
        lost = (frame.instance[y : y + h, x : x + w] == plant) & ~window(runs, frame.size_px[1], x, y, w, h)
        if lost.any():
            line, column = np.argwhere(lost)[0].tolist()
            pixel = (x + column, y + line)
            yield finding("a visible pixel is outside the amodal mask", plant_id=plant, pixel=pixel)


@frame_check("coco keypoints", _FILE, columns=KEYPOINT_COLUMNS, share=_FORMAT, shared=True)
def keypoints(frame: FrameData) -> Iterator[Finding]:
    """Keypoints are plants.parquet's: x, y, v of stem base, tip and crown centre; 0, 0, 0 outside the image."""
    for one in _annotations(frame):
        plant, row = one["plant_id"], frame.row_of.get(one["plant_id"])
        if "keypoints" not in one or row is None:
            continue
        expected: list[float] = []
        for name in KEYPOINTS:
            x, y, v = (float(frame.plants[f"{name}_{end}"][row]) for end in ("x_px", "y_px", "state"))
            expected += [x, y, v] if v > 0 else [0.0, 0.0, 0.0]
        if list(one["keypoints"]) != expected:
            yield finding("keypoints are not plants.parquet's", expected, one["keypoints"], plant)
        shown = sum(v > 0 for v in one["keypoints"][2::3])
        if one.get("num_keypoints") != shown:
            problem = "num_keypoints does not count the keypoints inside the image"
            yield finding(problem, shown, one.get("num_keypoints"), plant)


@frame_check("coco shard", _SHARD, files=(_SHARD,), share=_FORMAT)
def shard(frame: FrameData) -> Iterator[Finding]:
    """The frame's own annotations.json holds what coco.json holds of it."""
    own, share = read_json(frame.root, frame.file(_SHARD))["annotations"], _annotations(frame)
    if len(own) != len(share):
        yield finding(f"{_SHARD} has another number of annotations", len(own), len(share), file=_FILE)
    listed = {one["plant_id"]: one for one in own}
    for merged in share:
        mine = listed.get(merged["plant_id"], {})
        plain = {key: value for key, value in merged.items() if key not in ("id", "image_id")}
        for key in sorted({*mine, *plain} if mine else {"plant_id"}):
            if mine.get(key) != plain.get(key):
                got, expected = str(plain.get(key))[:80], str(mine.get(key))[:80]
                yield finding(f"{key} is not {_SHARD}'s", expected, got, plain.get("plant_id"), file=_FILE)
    for plant in sorted(listed.keys() - {one["plant_id"] for one in share}):
        yield finding(f"an annotation of {_SHARD} is not in {_FILE}", "one", "none", plant, file=_FILE)


def _annotations(frame: FrameData) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = frame.shared[_FORMAT]["annotations"]
    return found


def _box(frame: FrameData, plant: int) -> list[int]:
    """x, y, width and height of a plant of the mask."""
    box: list[int] = frame.extents.box_px[frame.extents.row_of[plant]].tolist()
    return box


def run_lengths(code: Any, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(R,) lengths of runs of zeros and ones in turn; `ValueError`: they do not fill an image of width and height."""
    width, height = size_px
    if not isinstance(code, dict) or list(code.get("size", ())) != [height, width]:
        raise ValueError(f"the code's size is not [{height}, {width}]")
    text = code.get("counts")
    if not isinstance(text, str) or not text or not text.isascii():
        raise ValueError("the code's counts are no text")
    values = np.frombuffer(text.encode("ascii"), dtype=np.uint8).astype(np.int64) - 48
    if values.min() < 0 or values.max() > 63 or values[-1] & 0x20:
        raise ValueError("the code's counts are cut short or no code")
    last = np.flatnonzero((values & 0x20) == 0)
    first = np.concatenate([[0], last[:-1] + 1])
    place = np.arange(len(values)) - np.repeat(first, last - first + 1)
    if place.max() > 8:
        raise ValueError("a run of the code is longer than any image")
    number = np.add.reduceat((values & 0x1F) << (5 * place), first)
    negative = (values[last] & 0x10) != 0
    number -= np.where(negative, np.int64(1) << (5 * (place[last] + 1)), 0)
    counts = number.copy()
    counts[1::2] = np.cumsum(number[1::2])
    counts[2::2] = np.cumsum(number[2::2])
    if (counts < 0).any() or counts.sum() != width * height:
        raise ValueError("the code's runs do not fill the image")
    return counts


def runs_of_ones(code: Any, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(R, 2) first pixel of each run of ones, counted down the columns, and one past its last; see `run_lengths`.

    A mask is held as its runs: an image of each would take most of the time.
    """
    edges = np.concatenate([[0], np.cumsum(run_lengths(code, size_px))])
    runs = np.stack([edges[1:-1:2], edges[2::2]], axis=1)
    return runs[runs[:, 0] < runs[:, 1]]


def area(runs: NDArray[np.int64]) -> int:
    """Pixels of a mask."""
    return int(np.diff(runs).sum())


def window(runs: NDArray[np.int64], height: int, x: int, y: int, w: int, h: int) -> NDArray[np.bool_]:
    """(h, w) part of a mask of an image of a height."""
    low, high = x * height, (x + w) * height
    inside = np.clip(runs, low, high) - low
    begin, end = inside[inside[:, 0] < inside[:, 1]].T
    turns = np.zeros(w * height + 1, dtype=np.int8)
    turns[begin] += 1
    turns[end] -= 1
    return np.asarray((np.cumsum(turns[:-1], dtype=np.int8).reshape(w, height) > 0).T[y : y + h])


def library_box(code: dict[str, Any]) -> list[int]:
    """x, y, width and height as pycocotools, which trainers use, has them of a code that was checked."""
    from pycocotools import mask

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its arrays are of NumPy 1's protocol
        box = mask.toBbox({"size": code["size"], "counts": code["counts"].encode("ascii")})
    return [int(side) for side in box]


FRAME_CHECKS, DATASET_CHECKS = (plants, stems, amodal, keypoints, measures, shard), (structure,)
