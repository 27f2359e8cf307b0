"""panoptic.json and its pictures: segments cover the image, each once, with their own area, box and category."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from forestgen.core.parts import Part
from forestgen.dataset.check.check import DatasetCheck, FrameCheck
from forestgen.dataset.check.files import read_picture
from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import FrameData, extents_of
from forestgen.dataset.check.merged import PANOPTIC, Merged, folder_of
from forestgen.dataset.check.pixels import first_of_each, wrong_pixels

_SKY_ID, _GROUND_ID = (1 << 24) - 1, (1 << 24) - 2
_SKY, _GROUND = "sky", "ground"


def has_panoptic(merged: Merged) -> bool:
    return merged.has(PANOPTIC)


def has_share(frame: FrameData) -> bool:
    return PANOPTIC in frame.task.shared


def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is one image with one annotation; image ids are coco.json's."""
    content = merged.panoptic
    listed, wanted = [str(entry["name"]) for entry in content["categories"]], [*merged.category_names, _GROUND, _SKY]
    if listed != wanted:
        yield Finding(PANOPTIC, "the categories are not the recipe's", ", ".join(wanted), ", ".join(listed))
    images = {image["id"]: folder_of(image["file_name"]) for image in content["images"]}
    if len(images) != len(content["images"]):
        yield Finding(PANOPTIC, "an id comes twice in images", expected="each once")
    shown, annotated = Counter(images.values()), Counter(images.get(one["image_id"]) for one in content["annotations"])
    for name in merged.frames:
        for what, count in (("image", shown[name]), ("annotation", annotated[name])):
            if count != 1:
                yield Finding(PANOPTIC, f"a frame has not one {what}", expected="1", got=str(count), image=name)
    if merged.has("coco.json"):
        known = {image["id"]: folder_of(image["file_name"]) for image in merged.coco["images"]}
        for image_id, name in images.items():
            if known.get(image_id, name) != name:
                yield Finding(PANOPTIC, "the image's id is another's in coco.json", got=str(image_id), image=name)


def segments(frame: FrameData) -> Iterator[Finding]:
    """Every pixel has the segment that its plant, or the sky, or the ground asks for; segments_info tells of each."""
    share = frame.task.shared[PANOPTIC]
    name = f"panoptic/{share['file_name']}"
    rgb = read_picture(frame.task.root, name).astype(np.int64)
    if rgb.shape != (*frame.instance.shape, 3):
        yield _finding(frame, name, "the picture has another size or no three colours", None)
        return
    segment = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
    background = np.where(frame.part == int(Part.NOTHING), _SKY_ID, _GROUND_ID)
    truth = np.where(frame.instance != 0, frame.instance, background)
    for x, y, _ in first_of_each(segment != truth, truth):
        yield Finding(
            name,
            "the segment is not the mask's plant, ground or sky",
            expected=str(truth[y, x]),
            got=str(segment[y, x]),
            image=frame.name,
            plant_id=int(frame.instance[y, x]) or None,
            pixel=(x, y),
        )
    found = share["segments_info"]
    listed = Counter(one["id"] for one in found)
    extents = extents_of(segment)
    for one in sorted(set(listed) | set(extents.row_of)):
        if listed[one] != 1 or one not in extents.row_of:
            got = f"{listed[one]} times, {'' if one in extents.row_of else 'not '}in the picture"
            yield _finding(frame, PANOPTIC, "a segment is not listed once", one, "once, and in the picture", got)
    for one in found:
        row = extents.row_of.get(one["id"])
        if row is None:
            continue
        if one["area"] != int(extents.pixels[row]):
            yield _finding(
                frame, PANOPTIC, "area is not the picture's pixel count", one["id"], extents.pixels[row], one["area"]
            )
        if list(one["bbox"]) != extents.box_px[row].tolist():
            yield _finding(frame, PANOPTIC, "bbox is not tight", one["id"], extents.box_px[row].tolist(), one["bbox"])
        yield from _category(frame, one, share["categories"])


def _category(frame: FrameData, one: dict[str, Any], categories: dict[int, str]) -> Iterator[Finding]:
    special = {_SKY_ID: _SKY, _GROUND_ID: _GROUND}
    if one["id"] not in special and one["id"] not in frame.row_of:
        return
    name = special.get(one["id"]) or frame.categories.get(one["id"])
    if categories.get(one["category_id"]) != name:
        got = categories.get(one["category_id"])
        yield _finding(frame, PANOPTIC, "the category is not the segment's", one["id"], name, got)


def own_picture(frame: FrameData) -> Iterator[Finding]:
    """The frame's own panoptic.png is the one beside panoptic.json."""
    share = frame.task.shared[PANOPTIC]
    own = frame.picture("panoptic.png")
    placed = read_picture(frame.task.root, f"panoptic/{share['file_name']}")
    wrong = (own != placed).any(axis=-1) if own.shape == placed.shape else np.ones(frame.instance.shape, dtype=bool)
    yield from wrong_pixels(frame, "panoptic.png", wrong, "the picture differs from the one beside panoptic.json")


def has_own_picture(frame: FrameData) -> bool:
    return has_share(frame) and frame.has("panoptic.png")


def _finding(
    frame: FrameData, file: str, problem: str, segment: int | None, expected: object = "", got: object = ""
) -> Finding:
    plant = segment if segment not in (_SKY_ID, _GROUND_ID) else None
    name = {_SKY_ID: " (sky)", _GROUND_ID: " (ground)"}.get(segment or 0, "")
    return Finding(file, problem + name, str(expected), str(got), frame.name, plant)


FRAME_CHECKS = (
    FrameCheck("panoptic", "segments cover the image", PANOPTIC, has_share, segments, True),
    FrameCheck("panoptic.png", "it is panoptic/'s", "panoptic.png", has_own_picture, own_picture),
)
DATASET_CHECKS = (DatasetCheck("panoptic files", "images and ids", PANOPTIC, has_panoptic, structure),)
