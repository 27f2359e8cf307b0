"""plants.parquet's columns of plants seen alone: the visible lies within the amodal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, number, numbers
from forestgen.dataset.check.frame_data import PLANTS, FrameData

_BOX = ("amodal_box_x", "amodal_box_y", "amodal_box_w", "amodal_box_h")
_FULL = ("full_box_left", "full_box_top", "full_box_right", "full_box_bottom")
_TOLERANCE = 1e-6
_EDGE_PX = 0.01  # rounding of projected vertices against rays


def has_amodal(frame: FrameData) -> bool:
    """Whether the columns are there and any plant has an amodal mask."""
    there = all(frame.known(name) for name in ("amodal_pixels", "amodal_area_px", "visible_fraction", *_BOX))
    return there and bool(_asked(frame).any())


def amodal(frame: FrameData) -> Iterator[Finding]:
    """Visible pixels, box and fraction lie within the amodal ones, these within the image and the full box."""
    asked = _asked(frame)
    width, height = frame.size_px
    pixels, seen = _column(frame, "amodal_pixels"), _column(frame, "visible_pixels")
    yield from _rows(frame, (seen > 0) & ~asked, "a plant of the image has no amodal mask", "one", pixels)
    yield from _rows(frame, asked & ~(pixels >= seen), "amodal_pixels is less than visible_pixels", seen, pixels)
    box = np.stack([_column(frame, side) for side in _BOX], axis=1)
    filled = pixels > 0
    disagree = np.asarray(filled == np.isnan(box).any(axis=1))
    yield from _rows(frame, disagree, "amodal_box and amodal_pixels disagree", "both", box)
    inside = np.all(box[:, :2] >= 0, axis=1) & (box[:, 0] + box[:, 2] <= width) & (box[:, 1] + box[:, 3] <= height)
    yield from _rows(frame, filled & ~inside, "amodal_box leaves the image", f"within {width} x {height}", box)
    room = box[:, 2] * box[:, 3]
    yield from _rows(frame, filled & ~(pixels <= room), "amodal_box is smaller than amodal_pixels", pixels, room)
    yield from _visible_inside(frame, box)
    yield from _fractions(frame, asked)
    if all(frame.known(side) for side in _FULL):
        yield from _full_boxes(frame, box, filled)


def _visible_inside(frame: FrameData, box: NDArray[np.float64]) -> Iterator[Finding]:
    own = np.stack([_column(frame, f"box_{side}") for side in "xywh"], axis=1)
    seen = ~np.isnan(own).any(axis=1)
    low = own[:, :2] >= box[:, :2]
    high = own[:, :2] + own[:, 2:] <= box[:, :2] + box[:, 2:]
    within = np.all(low & high, axis=1)
    yield from _rows(frame, seen & ~within, "the box is not within amodal_box", own, box)


def _fractions(frame: FrameData, asked: NDArray[np.bool_]) -> Iterator[Finding]:
    """visible_fraction = visible area / amodal area, at most 1; null where that is nothing."""
    area, seen = _column(frame, "amodal_area_px"), _column(frame, "visible_area_px")
    fraction = _column(frame, "visible_fraction")
    yield from _rows(frame, asked & ~(area >= 0), "amodal_area_px is no area", "0 or more", area)
    share = np.divide(seen, area, out=np.full(len(seen), np.nan), where=area > 0)
    expected = np.minimum(share, 1.0)
    agree = (np.abs(fraction - expected) <= _TOLERANCE) | (np.isnan(fraction) & np.isnan(expected))
    yield from _rows(frame, ~agree, "visible_fraction is not visible by amodal area", expected, fraction)


def _full_boxes(frame: FrameData, box: NDArray[np.float64], filled: NDArray[np.bool_]) -> Iterator[Finding]:
    width, height = frame.size_px
    full = np.stack([_column(frame, side) for side in _FULL], axis=1)
    known = ~np.isnan(full).any(axis=1)
    yield from _rows(frame, filled & ~known, "a plant with an amodal mask has no full box", "four numbers", full)
    low = np.floor(full[:, :2] - _EDGE_PX) <= box[:, :2]
    high = np.ceil(full[:, 2:] + _EDGE_PX) >= box[:, :2] + box[:, 2:]
    wrong = filled & known & ~(low & high).all(axis=1)
    yield from _rows(frame, wrong, "amodal_box is not within full_box", full, box)
    if frame.known("truncation"):
        kept = np.clip(full, 0, (width, height, width, height))
        extent = (full[:, 2] - full[:, 0]) * (full[:, 3] - full[:, 1])
        part = np.maximum(kept[:, 2] - kept[:, 0], 0) * np.maximum(kept[:, 3] - kept[:, 1], 0)
        share = 1 - np.divide(part, extent, out=np.ones_like(part), where=extent > 0)
        got = _column(frame, "truncation")
        wrong = known & (extent > 0) & ~(np.abs(got - share) <= _TOLERANCE)
        yield from _rows(frame, wrong, "truncation is not the full box' share outside the image", share, got)
        yield from _rows(frame, known & ~((got >= 0) & (got <= 1)), "truncation lies outside 0 to 1", "0 to 1", got)


def _asked(frame: FrameData) -> NDArray[np.bool_]:
    return ~np.isnan(_column(frame, "amodal_area_px"))


def _column(frame: FrameData, name: str) -> NDArray[np.float64]:
    return frame.plants[name].astype(np.float64)


def _rows(
    frame: FrameData,
    wrong: NDArray[np.bool_],
    problem: str,
    expected: NDArray[np.float64] | str,
    got: NDArray[np.float64],
) -> Iterator[Finding]:
    for row in np.flatnonzero(wrong):
        yield frame.finding(
            PLANTS,
            problem,
            expected=expected if isinstance(expected, str) else numbers(expected[row]),
            got=numbers(got[row]) if got.ndim > 1 else number(got[row]),
            plant_id=int(frame.plants["plant_id"][row]),
        )
