"""panoptic.json and its pictures: segments cover the image, each once, with their own area, box and category."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, finding, read_picture
from forestgen.dataset.check.frame_data import FrameData, Wrong, extents_of, first_of_each, frame_check
from forestgen.dataset.check.merged import Merged, dataset_check, folder_of

_FILE, _PICTURE, _FORMAT = "panoptic.json", "panoptic.png", "panoptic"
_SKY_ID, _GROUND_ID = (1 << 24) - 1, (1 << 24) - 2
_STUFF = {_SKY_ID: "sky", _GROUND_ID: "ground"}


def _content(merged: Merged) -> dict[str, Any]:
    return merged.lists(_FILE, "images", "annotations", "categories")


def frame_shares(merged: Merged) -> Mapping[str, Any]:
    """Frame -> its annotation in panoptic.json, with the categories' names."""
    if not merged.has(_FILE):
        return {}
    content = _content(merged)
    names = {entry["id"]: entry["name"] for entry in content["categories"]}
    frames = {entry["id"]: folder_of(entry["file_name"]) for entry in content["images"]}
    return {frames[one["image_id"]]: {**one, "categories": names} for one in content["annotations"]}


@dataset_check("panoptic files", _FILE)
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image with one annotation; image ids are coco.json's."""
    content = _content(merged)
    listed = [str(entry["name"]) for entry in content["categories"]]
    wanted = [*merged.category_names, _STUFF[_GROUND_ID], _STUFF[_SKY_ID]]
    if listed != wanted:
        yield finding("the categories are not the recipe's", ", ".join(wanted), ", ".join(listed))
    images = {image["id"]: folder_of(image["file_name"]) for image in content["images"]}
    if len(images) != len(content["images"]):
        yield finding("an id comes twice in images", "each once")
    shown, annotated = Counter(images.values()), Counter(images.get(one["image_id"]) for one in content["annotations"])
    for name in merged.frames:
        for what, count in (("image", shown[name]), ("annotation", annotated[name])):
            if count != 1:
                yield finding(f"a frame has not one {what}", 1, count, image=name)
    if merged.has("coco.json"):
        coco_images = merged.lists("coco.json", "images", "annotations", "categories", "licenses")["images"]
        known = {image["id"]: folder_of(image["file_name"]) for image in coco_images}
        for image_id, name in images.items():
            if known.get(image_id, name) != name:
                yield finding("the image's id is another's in coco.json", got=image_id, image=name)


@frame_check("panoptic", _FILE, share=_FORMAT, shared=True)
def segments(frame: FrameData) -> Iterator[Finding]:
    """Every pixel has the segment of its plant, or of sky or ground; segments_info describes each segment."""
    share = frame.shared[_FORMAT]
    name = f"panoptic/{share['file_name']}"
    rgb = read_picture(frame.root, name).astype(np.int64)
    if rgb.shape != (*frame.instance.shape, 3):
        yield finding("the picture has another size or no three colours", file=name)
        return
    segment = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
    background = np.where(frame.part == int(Part.NOTHING), _SKY_ID, _GROUND_ID)
    truth = np.where(frame.instance != 0, frame.instance, background)
    for x, y, _ in first_of_each(segment != truth, truth):
        problem, plant = "the segment is not the mask's plant, ground or sky", int(frame.instance[y, x]) or None
        yield finding(problem, truth[y, x], segment[y, x], plant, pixel=(x, y), file=name)
    found = share["segments_info"]
    listed = Counter(one["id"] for one in found)
    extents = extents_of(segment)
    for one in sorted(set(listed) | set(extents.row_of)):
        if listed[one] != 1 or one not in extents.row_of:
            got = f"{listed[one]} times, {'' if one in extents.row_of else 'not '}in the picture"
            yield _of_segment("a segment is not listed once", one, "once, and in the picture", got)
    for one in found:
        number, row = one["id"], extents.row_of.get(one["id"])
        if row is None:
            continue
        area, box = int(extents.pixels[row]), extents.box_px[row].tolist()
        if one["area"] != area:
            yield _of_segment("area is not the picture's pixel count", number, area, one["area"])
        if list(one["bbox"]) != box:
            yield _of_segment("bbox is not tight", number, box, one["bbox"])
        category, got = _STUFF.get(number) or frame.categories.get(number), share["categories"].get(one["category_id"])
        if got != category and (number in _STUFF or number in frame.row_of):
            yield _of_segment("the category is not the segment's", number, category, got)


@frame_check("panoptic.png", _PICTURE, files=(_PICTURE,), share=_FORMAT)
def own_picture(frame: FrameData) -> Iterator[Wrong]:
    """The frame's own panoptic.png is the one beside panoptic.json."""
    own = frame.picture(_PICTURE)
    placed = read_picture(frame.root, f"panoptic/{frame.shared[_FORMAT]['file_name']}")
    wrong = (own != placed).any(axis=-1) if own.shape == placed.shape else np.ones(frame.instance.shape, dtype=bool)
    yield Wrong(wrong, "the picture differs from the one beside panoptic.json")


def _of_segment(problem: str, segment: int, expected: object, got: object) -> Finding:
    if segment in _STUFF:
        return finding(f"{problem} ({_STUFF[segment]})", expected, got)
    return finding(problem, expected, got, segment)


FRAME_CHECKS, DATASET_CHECKS = (segments, own_picture), (structure,)
