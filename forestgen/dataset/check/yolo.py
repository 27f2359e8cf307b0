"""YOLO's boxes and outlines: the masks' boxes, and rings that fill to the masks.

A ring's corners are pixels. It fills the pixels whose centre lies inside by the even-odd rule, and those on the lines
between its corners, as OpenCV's fillPoly does.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.files import Finding, categories, finding, read_text
from forestgen.dataset.check.frame_data import FrameData, frame_check
from forestgen.dataset.check.merged import Merged, dataset_check
from forestgen.dataset.safe_path import SafePath

_TASKS = ("boxes", "segmentation")
_TOLERANCE = 1e-6
_FLOOR_TOLERANCE = 1e-3  # of a pixel
_LineCheck = Callable[[FrameData, int, NDArray[np.float64]], Iterator[Finding]]


@dataset_check("yolo files", "yolo", lambda merged: any(merged.has(f"yolo/{task}/data.yaml") for task in _TASKS))
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame has an image and a file of labels in both layouts; data.yaml names the categories."""
    names = (json.dumps(name, ensure_ascii=False) for name in merged.category_names)
    expected = "names:\n" + "".join(f"  {number}: {name}\n" for number, name in enumerate(names))
    for task in _TASKS:
        for name in merged.frames:
            for kind, end in (("images", "png"), ("labels", "txt")):
                file = f"yolo/{task}/{kind}/{name}.{end}"
                if not SafePath(merged.root, file).is_file():
                    yield finding("the file is missing", "one for each frame", file=file, image=name)
        text = read_text(merged.root, f"yolo/{task}/data.yaml")
        if expected not in text:
            yield finding("names are not the recipe's categories", expected, text, file=f"yolo/{task}/data.yaml")


@frame_check("yolo boxes", "yolo", when=lambda frame: _has_lines(frame, "boxes"), shared=True)
def boxes(frame: FrameData) -> Iterator[Finding]:
    """A line a plant of the mask, by rising id: class, centre and size of its box as shares of the image."""
    return _lines(frame, "boxes", _box_line)


def _box_line(frame: FrameData, row: int, values: NDArray[np.float64]) -> Iterator[Finding]:
    width, height = frame.size_px
    x, y, w, h = frame.extents.box_px[row].tolist()
    expected = np.array([(x + w / 2) / width, (y + h / 2) / height, w / width, h / height])
    if len(values) != 5 or not (np.abs(values[1:] - expected) <= _TOLERANCE).all():
        yield finding("the box is not the mask's", expected, values[1:])


@frame_check("yolo outlines", "yolo", when=lambda frame: _has_lines(frame, "segmentation"), shared=True)
def outlines(frame: FrameData) -> Iterator[Finding]:
    """Each ring lies in its box and fills to whole pieces of its plant's mask, and to bridges between them."""
    return _lines(frame, "segmentation", _outline_line)


def _outline_line(frame: FrameData, row: int, values: NDArray[np.float64]) -> Iterator[Finding]:
    """A ring of pixels lies in its box, fills the mask and bridges, and misses no part of a piece."""
    if len(values) < 7 or len(values) % 2 == 0:
        yield finding("the line is no ring", "class and 3 or more points", f"{len(values)} numbers")
        return
    size = np.array(frame.size_px, dtype=np.float64)
    ring = np.floor(values[1:].reshape(-1, 2) * size + _FLOOR_TOLERANCE).astype(np.int64)
    box = frame.extents.box_px[row]
    low, high = ring.min(axis=0), ring.max(axis=0)
    if (low < box[:2]).any() or (high >= box[:2] + box[2:]).any():
        yield finding("the outline leaves the mask's box", box, np.array([*low, *(high - low + 1)]))
        return
    x, y, w, h = box.tolist()
    truth = frame.instance[y : y + h, x : x + w] == frame.extents.plant_id[row]
    added, missing = _differences(ring - box[:2], truth)
    for wrong, expected, got in ((missing, "inside", "outside"), (added, "outside", "inside")):
        if wrong.any():
            line, column = np.argwhere(wrong)[0].tolist()
            yield finding("the outline does not fill to the mask", expected, got, pixel=(x + column, y + line))
            return


def _has_lines(frame: FrameData, task: str) -> bool:
    return SafePath(frame.root, _file(frame, task)).is_file()


def _file(frame: FrameData, task: str) -> str:
    return f"yolo/{task}/labels/{frame.name}.txt"


def _lines(frame: FrameData, task: str, check_line: _LineCheck) -> Iterator[Finding]:
    """Check a file of labels, line by line."""
    file, plants = _file(frame, task), frame.extents.plant_id.tolist()
    lines = read_text(frame.root, file).splitlines()
    for row, line in enumerate(lines):
        for one in _line(frame, row, line, check_line):
            yield replace(one, file=file, plant_id=plants[row] if row < len(plants) else None)
    if len(lines) != len(plants):
        yield finding("there is not a line for each plant of the mask", len(plants), len(lines), file=file)


def _line(frame: FrameData, row: int, line: str, check_line: _LineCheck) -> Iterator[Finding]:
    """A line is numbers, has the class of its plant, and what `check_line` asks for."""
    try:
        values = np.array(line.split(), dtype=np.float64)
        if not len(values) or not np.isfinite(values).all():
            raise ValueError
    except ValueError:
        yield finding(f"line {row + 1} is not numbers alone", got=line[:60])
        return
    if row >= len(frame.extents.plant_id):
        return
    names, _ = categories(frame.recipe)
    own = frame.categories.get(int(frame.extents.plant_id[row]))
    if own not in names or values[0] != names.index(own):
        yield finding("the class is not that of the plant's species", own, values[0])
    yield from check_line(frame, row, values)


def _differences(ring: NDArray[np.int64], truth: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(H, W) pixels that a ring adds to a mask farther than a pixel from its bridges, and those that it must not miss.

    The ring's edges along rows, columns and diagonals with all their pixels in the mask are borders, the others
    bridges. It must not miss a pixel of a piece with a border, nor of the largest piece.
    """
    from scipy.ndimage import binary_dilation, label

    pixels, edge = line_pixels(ring)
    step = np.abs(np.roll(ring, -1, axis=0) - ring)
    own = truth[pixels[:, 1], pixels[:, 0]]
    inside_mask = np.bincount(edge, weights=~own, minlength=len(ring)) == 0
    border = inside_mask & ((step == 0).any(axis=1) | (step[:, 0] == step[:, 1]))
    on_line, near_bridge = np.zeros_like(truth), np.zeros_like(truth)
    on_line[pixels[:, 1], pixels[:, 0]] = True
    bridge = pixels[~border[edge]]
    near_bridge[bridge[:, 1], bridge[:, 0]] = True
    filled = on_line | fill(ring.astype(np.float64) + 0.5, (truth.shape[1], truth.shape[0]))
    pieces, number = label(truth, np.ones((3, 3), dtype=np.int8))
    whole = np.zeros(number + 1, dtype=bool)
    bordered = pixels[border[edge] & (step.max(axis=1) > 0)[edge]]
    whole[pieces[bordered[:, 1], bordered[:, 0]]] = True
    whole[1 + np.bincount(pieces[truth], minlength=number + 1)[1:].argmax()] = True
    near_bridge = binary_dilation(near_bridge, np.ones((3, 3), dtype=bool))
    return filled & ~truth & ~near_bridge, whole[pieces] & truth & ~filled


def line_pixels(ring: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """(K, 2) pixels of the lines between a ring's corners, one a step along the longer axis, and each one's edge."""
    step = np.roll(ring, -1, axis=0) - ring
    count = np.abs(step).max(axis=1)
    edge = np.repeat(np.arange(len(ring)), count + 1)
    done = np.arange(len(edge)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    share = done / np.maximum(count, 1)[edge]
    return np.floor(ring[edge] + step[edge] * share[:, None] + 0.5).astype(np.int64), edge


def fill(ring: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) pixels whose centre lies inside a ring (N, 2) by the even-odd rule.

    An edge turns over all centres to its right in the rows that it crosses; edges walked there and back cancel.
    """
    width, height = size_px
    start, end = ring, np.roll(ring, -1, axis=0)
    up = start[:, 1] > end[:, 1]
    top, bottom = np.where(up[:, None], end, start), np.where(up[:, None], start, end)
    first = np.ceil(top[:, 1] - 0.5).astype(np.int64)
    count = np.ceil(bottom[:, 1] - 0.5).astype(np.int64) - first
    edge = np.repeat(np.arange(len(ring)), count)
    row = first[edge] + np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (bottom[:, 0] - top[:, 0]) / (bottom[:, 1] - top[:, 1])
    crossing = top[edge, 0] + (row + 0.5 - top[edge, 1]) * slope[edge]
    column = np.ceil(crossing - 0.5).astype(np.int64)
    kept = (row >= 0) & (row < height)
    cell = row[kept] * (width + 1) + np.clip(column[kept], 0, width)
    turns = np.bincount(cell, minlength=height * (width + 1)).reshape(height, width + 1)
    return np.asarray(np.cumsum(turns[:, :width], axis=1) % 2 == 1)


FRAME_CHECKS, DATASET_CHECKS = (boxes, outlines), (structure,)
