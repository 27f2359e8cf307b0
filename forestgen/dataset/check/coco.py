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
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.check import dataset_check, frame_check
from forestgen.dataset.check.files import read_json
from forestgen.dataset.check.finding import MISUNDERSTOOD, Finding, misunderstood, number
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.merged import Merged, folder_of
from forestgen.dataset.check.plants import KEYPOINT_COLUMNS, KEYPOINTS
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


@dataset_check("coco files", "images, ids, categories, licences", _FILE)
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image; ids are unique; images, categories and licences that are named are there."""
    coco = merged.lists(_FILE, *_LISTS)
    for key in _LISTS:
        for one, times in Counter(entry.get("id") for entry in coco[key]).items():
            if times > 1 or one is None:
                problem = f"an id comes twice in {key}" if one is not None else f"an entry of {key} has no id"
                yield Finding(_FILE, problem, expected="each once", got=str(one))
    images, categories = ({entry.get("id") for entry in coco[key]} for key in ("images", "categories"))
    listed, wanted = [str(entry["name"]) for entry in coco["categories"]], merged.category_names
    if listed != wanted:
        yield Finding(_FILE, "the categories are not the recipe's", ", ".join(wanted), ", ".join(listed))
    licences = {entry["id"] for entry in coco["licenses"]}
    folders = [folder_of(image["file_name"]) for image in coco["images"]]
    entries = Counter(folders)
    for name in merged.frames:
        if entries[name] != 1:
            yield Finding(_FILE, "a frame is not one image", "1 entry", str(entries[name]), name)
    for image, folder in zip(coco["images"], folders, strict=True):
        for key in ("file_name", "camera"):
            if key in image and not SafePath(merged.root, str(image[key])).is_file():
                yield Finding(_FILE, f"an image's {key} is not there", got=str(image[key]), image=folder)
        if image.get("license", None) not in licences | {None}:
            yield Finding(_FILE, "an image's licence is not listed", got=str(image["license"]), image=folder)
    for one in coco["annotations"]:
        for key, known in (("image_id", images), ("category_id", categories)):
            if one.get(key) not in known:
                problem, plant = f"annotation {one.get('id')}: no such {key}", one.get("plant_id")
                yield Finding(_FILE, problem, expected="a listed one", got=str(one.get(key)), plant_id=plant)


@frame_check("coco", "annotations are the mask's plants", _FILE, share=_FORMAT, shared=True)
def plants(frame: FrameData) -> Iterator[Finding]:
    """The plants of the image are annotated, each once, with its own box, area and mask."""
    share = frame.task.shared[_FORMAT]
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
                yield misunderstood(_FILE, error, frame.name, one["plant_id"])


def _annotation(frame: FrameData, one: dict[str, Any], categories: dict[int, str]) -> Iterator[Finding]:
    plant = one["plant_id"]
    seen = frame.extents.row_of[plant]
    pixels, box = int(frame.extents.pixels[seen]), frame.extents.box_px[seen].tolist()
    if one["area"] != pixels:
        yield _finding(frame, "area is not the mask's pixel count", pixels, one["area"], plant)
    if list(one["bbox"]) != box:
        yield _finding(frame, "bbox is not tight around the mask", box, one["bbox"], plant)
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
        yield _finding(frame, f"{key} is no run-length code", _CODE, error, plant)
        return
    if mask.area != mask.library_area:
        yield _finding(frame, f"{key}: pycocotools has another area", mask.area, mask.library_area, plant)
    x, y, w, h = _box(frame, plant)
    own = ids[y : y + h, x : x + w] == plant
    if (mask.window(x, y, w, h) != own).any() or mask.area != int(np.count_nonzero(own)):
        truth = ids == plant
        differs = mask.window(0, 0, *frame.size_px) != truth
        line, column = np.argwhere(differs)[0].tolist()
        expected = "in the mask" if truth[line, column] else "outside the mask"
        got = f"the opposite, there and in {int(differs.sum()) - 1} other pixels"
        yield Finding(_FILE, f"{key} is not the mask", expected, got, frame.name, plant, (column, line))


@frame_check("coco stems", "stem masks are the trunks", _FILE, share=_FORMAT, shared=True)
def stems(frame: FrameData) -> Iterator[Finding]:
    """stem_segmentation is the plant's pixels that are trunk; it is absent where there are none."""
    stem = np.where(frame.part == int(Part.TRUNK), frame.instance, 0)
    having = set(np.unique(stem).tolist()) - {0}
    for one in _annotations(frame):
        plant, code = one["plant_id"], one.get("stem_segmentation")
        if (code is not None) != (plant in having):
            expected = "one" if plant in having else "none"
            yield _finding(frame, "stem_segmentation and trunk pixels disagree", expected, str(code)[:40], plant)
        elif code is not None:
            yield from _same_mask(frame, "stem_segmentation", code, plant, stem)


@frame_check("coco measures", "numbers are plants.parquet's", _FILE, share=_FORMAT, shared=True)
def measures(frame: FrameData) -> Iterator[Finding]:
    """Numbers that plants.parquet holds too are the same; null is null."""
    for one in _annotations(frame):
        row = frame.row_of.get(one["plant_id"])
        for key, column in (*((key, key) for key in _SAME), *_AMODAL):
            if row is not None and key in one and frame.known(column):
                stored = float(frame.plants[column][row])
                got = np.nan if one[key] is None else float(one[key])
                if not (got == stored or (np.isnan(got) and np.isnan(stored))):
                    problem = f"{key} is not plants.parquet's"
                    yield _finding(frame, problem, number(stored), number(got), one["plant_id"])


@frame_check(
    "coco amodal", "amodal masks hold visible ones", _FILE, share=_FORMAT, shared=True,
    when=lambda frame: any("amodal_segmentation" in one for one in _annotations(frame)),
)  # fmt: skip
def amodal(frame: FrameData) -> Iterator[Finding]:
    """amodal_segmentation holds the visible mask; its area and box are its own."""
    for one in _annotations(frame):
        plant = one["plant_id"]
        if "amodal_segmentation" not in one or plant not in frame.extents.row_of:
            continue
        try:
            mask = decode(one["amodal_segmentation"], frame.size_px)
        except ValueError as error:
            yield _finding(frame, "amodal_segmentation is no run-length code", _CODE, error, plant)
            continue
        if not one["amodal_area"] == mask.area == mask.library_area:
            problem = "amodal_area is not the amodal mask's pixel count"
            yield _finding(frame, problem, mask.area, one["amodal_area"], plant)
        box, got = mask.library_box, list(one["amodal_bbox"])
        if got != box:
            yield _finding(frame, "amodal_bbox is not tight around the amodal mask", box, one["amodal_bbox"], plant)
        if plant in frame.row_of and frame.known("amodal_box_x"):
            stored = [frame.plants[f"amodal_box_{side}"][frame.row_of[plant]] for side in "xywh"]
            if got != stored:
                yield _finding(frame, "amodal_bbox is not plants.parquet's", stored, one["amodal_bbox"], plant)
        x, y, w, h = _box(frame, plant)
        lost = (frame.instance[y : y + h, x : x + w] == plant) & ~mask.window(x, y, w, h)
        if lost.any():
            line, column = np.argwhere(lost)[0].tolist()
            problem = "a visible pixel is outside the amodal mask"
            yield Finding(_FILE, problem, image=frame.name, plant_id=plant, pixel=(x + column, y + line))


@frame_check(
    "coco keypoints", "keypoints are plants.parquet's", _FILE, columns=KEYPOINT_COLUMNS, share=_FORMAT, shared=True
)
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
            yield _finding(frame, "keypoints are not plants.parquet's", expected, one["keypoints"], plant)
        shown = sum(v > 0 for v in one["keypoints"][2::3])
        if one.get("num_keypoints") != shown:
            problem = "num_keypoints does not count the keypoints inside the image"
            yield _finding(frame, problem, shown, one.get("num_keypoints"), plant)


@frame_check("coco shard", "annotations.json is coco.json's share", _SHARD, files=(_SHARD,), share=_FORMAT)
def shard(frame: FrameData) -> Iterator[Finding]:
    """The frame's own annotations.json holds what coco.json holds of it."""
    own, share = read_json(frame.task.root, frame.file(_SHARD))["annotations"], _annotations(frame)
    if len(own) != len(share):
        yield _finding(frame, f"{_SHARD} has another number of annotations", len(own), len(share))
    listed = {one["plant_id"]: one for one in own}
    for merged in share:
        mine = listed.get(merged["plant_id"], {})
        plain = {key: value for key, value in merged.items() if key not in ("id", "image_id")}
        for key in sorted({*mine, *plain} if mine else {"plant_id"}):
            if mine.get(key) != plain.get(key):
                got, expected = str(plain.get(key))[:80], str(mine.get(key))[:80]
                yield _finding(frame, f"{key} is not {_SHARD}'s", expected, got, plain.get("plant_id"))
    for plant in sorted(listed.keys() - {one["plant_id"] for one in share}):
        yield _finding(frame, f"an annotation of {_SHARD} is not in {_FILE}", "one", "none", plant)


def _annotations(frame: FrameData) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = frame.task.shared[_FORMAT]["annotations"]
    return found


def _box(frame: FrameData, plant: int) -> list[int]:
    """x, y, width and height of a plant of the mask."""
    box: list[int] = frame.extents.box_px[frame.extents.row_of[plant]].tolist()
    return box


def _finding(frame: FrameData, problem: str, expected: object, got: object, plant: int | None = None) -> Finding:
    return Finding(_FILE, problem, expected=str(expected), got=str(got), image=frame.name, plant_id=plant)


def run_lengths(code: Any, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(R,) lengths of runs of zeros and ones in turn.

    Raises
    ------
    ValueError : the code is none, or its runs do not fill an image of width and height `size_px`.
    """
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


@dataclass(frozen=True)
class RunMask:
    """A decoded mask, held as its runs: an image of each would take most of the time."""

    begin: NDArray[np.int64]  # (R,) first pixel of each run of ones, counted down the columns
    end: NDArray[np.int64]  # (R,) one past its last
    size_px: tuple[int, int]
    library_area: int  # pixels and box x, y, width, height as pycocotools has them, which trainers use
    library_box: list[int]

    @property
    def area(self) -> int:
        return int((self.end - self.begin).sum())

    def window(self, x: int, y: int, w: int, h: int) -> NDArray[np.bool_]:
        """(h, w) part of the mask."""
        height = self.size_px[1]
        low, high = x * height, (x + w) * height
        begin, end = np.clip(self.begin, low, high) - low, np.clip(self.end, low, high) - low
        there = end > begin
        turns = np.zeros(w * height + 1, dtype=np.int8)
        turns[begin[there]] += 1
        turns[end[there]] -= 1
        inside = np.cumsum(turns[:-1], dtype=np.int8).reshape(w, height) > 0
        return np.asarray(inside.T[y : y + h])


def decode(code: Any, size_px: tuple[int, int]) -> RunMask:
    """Read a code of an image of width and height `size_px`; what is none raises `ValueError`."""
    from pycocotools import mask

    edges = np.concatenate([[0], np.cumsum(run_lengths(code, size_px))])
    filled = edges[1:-1:2] < edges[2::2]
    plain = {"size": code["size"], "counts": code["counts"].encode("ascii")}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its arrays are of NumPy 1's protocol
        area, box = int(mask.area(plain)), mask.toBbox(plain).astype(np.int64).tolist()
    return RunMask(edges[1:-1:2][filled], edges[2::2][filled], size_px, area, box)


FRAME_CHECKS, DATASET_CHECKS = (plants, stems, amodal, keypoints, measures, shard), (structure,)
