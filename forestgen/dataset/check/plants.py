"""plants.parquet against the masks: pixels, areas, boxes, keypoints, and what each plant looks like alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, finding
from forestgen.dataset.check.frame_data import CAMERA, PLANTS, FrameData, Wrong, frame_check

_SIZES = ("height_m", "radius_m", "age_yr", "distance_m", "leaf_area_m2", "crown_width_m")
_AREA_TOLERANCE = 1e-3  # relative; shares are stored as float32
_POINT_PX, _RELATIVE = 0.01, 1e-3  # places are stored as they are placed, to within float32 at the least
_GRAZING = 1e-3  # depth by distance, below which a point may or may not count as behind the camera
_BOX = tuple(f"amodal_box_{side}" for side in "xywh")
_FULL = ("full_box_left", "full_box_top", "full_box_right", "full_box_bottom")
_TOLERANCE = 1e-6
_EDGE_PX = 0.01  # rounding of projected vertices against rays
KEYPOINTS = ("stem_base", "tip", "crown_centre")
KEYPOINT_COLUMNS = tuple(f"{name}_{end}" for name in KEYPOINTS for end in ("x_px", "y_px", "state"))
_STATES = np.array(["0: outside the image", "1: hidden", "2: visible"])


@frame_check("plants", PLANTS)
def visible(frame: FrameData) -> Iterator[Wrong]:
    """visible_pixels, box and truncated are those of the mask."""
    extents, plants = frame.extents, frame.plants
    row = np.array([extents.row_of.get(plant, -1) for plant in plants["plant_id"].tolist()], dtype=np.int64)
    is_seen = row >= 0
    pixels = np.append(extents.pixels, 0)[row]
    expected = np.concatenate([extents.box_px, np.zeros((1, 4), dtype=np.int64)])[row]
    box = _columns(frame, *(f"box_{side}" for side in "xywh"))
    yield Wrong(plants["visible_pixels"] != pixels, _differs("visible_pixels"), pixels, plants["visible_pixels"])
    yield Wrong(~is_seen & ~np.isnan(box).all(axis=1), _differs("box of an unseen plant"), "null", box)
    yield Wrong(is_seen & (box != expected).any(axis=1), _differs("box x, y, w, h"), expected, box)
    far = expected[:, :2] + expected[:, 2:]
    touches = is_seen & ((expected[:, :2] == 0) | (far == frame.size_px)).any(axis=1)
    truncated = plants["truncated"]
    yield Wrong(truncated.astype(bool) != touches, _differs("truncated"), touches, truncated)


@frame_check("areas", PLANTS, exr=("coverage rank0.id rank0.coverage",))
def areas(frame: FrameData) -> Iterator[Wrong]:
    """visible_area_px is the sum of coverages; where 8 ranks did not hold all ids it may be more."""
    ids, share = frame.ranks
    known = frame.plants["plant_id"]
    filled = (share > 0) & (ids != 0)
    rows = np.searchsorted(known, ids[filled])
    listed = rows < len(known)
    least = np.bincount(rows[listed], weights=share[filled][listed], minlength=len(known))
    rest = float(np.maximum(1 - share.sum(axis=-1, dtype=np.float64), 0)[share[..., -1] > 0].sum())
    area = frame.plants["visible_area_px"]
    slack = _AREA_TOLERANCE * np.maximum(least, 1)
    yield Wrong(~((area >= least - slack) & (area <= least + slack + rest)), _differs("visible_area_px"), least, area)


@frame_check("stems", PLANTS, columns=("stem_pixels",))
def stems(frame: FrameData) -> Iterator[Wrong]:
    """stem_pixels counts the plant's pixels whose part is the trunk."""
    known = frame.plants["plant_id"]
    trunk = frame.instance[(frame.part == int(Part.TRUNK)) & (frame.instance != 0)]
    rows = np.searchsorted(known, trunk)
    count = np.bincount(rows[rows < len(known)], minlength=len(known))
    stored = frame.plants["stem_pixels"]
    yield Wrong(~(stored == count), _differs("stem_pixels"), count, stored)


@frame_check("measures", PLANTS)
def measures(frame: FrameData) -> Iterator[Wrong]:
    """Measures that every plant has are finite numbers, sizes not negative."""
    for column in filter(frame.known, ("x_m", "y_m", "z_m", *_SIZES)):
        values = frame.plants[column].astype(np.float64)
        least = 0.0 if column in _SIZES else -np.inf
        yield Wrong(~(np.isfinite(values) & (values >= least)), f"{column} is no measure", "a number", values)


@frame_check("keypoints", PLANTS, columns=KEYPOINT_COLUMNS)
def keypoints(frame: FrameData) -> Iterator[Finding]:
    """State is 0 outside the image; inside, 2 where the mask's pixel is the plant's, and 1 elsewhere."""
    plants = frame.plants
    for name in KEYPOINTS:
        x, y = _columns(frame, f"{name}_x_px", f"{name}_y_px").T
        expected = keypoint_states(x, y, plants["plant_id"], frame.instance)
        got = plants[f"{name}_state"]
        for row in np.flatnonzero(~(got == expected)):
            problem, plant = f"{name}_state does not follow from the mask", int(plants["plant_id"][row])
            pixel = (int(x[row]), int(y[row])) if expected[row] else None
            yield finding(problem, _STATES[expected[row]], got[row], plant, pixel=pixel)


def keypoint_states(
    x: NDArray[np.float64], y: NDArray[np.float64], plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> NDArray[np.int64]:
    """(N,) states of points at x, y (N,) of plants; NaN lies outside."""
    height, width = instance.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    column = np.where(inside, x, 0).astype(np.int64)
    line = np.where(inside, y, 0).astype(np.int64)
    seen = instance[line, column] == plant_id
    return np.where(inside, np.where(seen, 2, 1), 0)


@frame_check(
    "stem places", PLANTS,
    files=(CAMERA,), columns=("x_m", "y_m", "z_m", "stem_base_x_px", "stem_base_y_px"),
)  # fmt: skip
def places(frame: FrameData) -> Iterator[Finding]:
    """The stem base is where the camera projects the plant's place; none where it cannot see it."""
    camera = frame.camera
    own = (_columns(frame, "x_m", "y_m", "z_m") - camera.position_m) @ camera.rotation.T
    expected, depth = camera.geometry.project(own)
    got = _columns(frame, "stem_base_x_px", "stem_base_y_px")
    off = np.abs(got - expected)
    if camera.projection.wraps_x:
        off[:, 0] = np.minimum(off[:, 0], np.abs(off[:, 0] - camera.size_px[0]))  # at the seam: either end
    there = ~np.isnan(got).any(axis=1)
    sure = np.abs(depth) > _GRAZING * np.sqrt((own**2).sum(axis=1))
    beyond_px = camera.geometry.beyond_rim_px(expected)
    if beyond_px is not None:
        sure = np.abs(beyond_px) > _POINT_PX
    wrong = sure & (there != (depth > 0))
    wrong |= there & sure & ~(off <= _POINT_PX + _RELATIVE * np.abs(expected)).all(axis=1)
    problem = "stem_base_x_px, stem_base_y_px are not the plant's place as the camera sees it"
    for row in np.flatnonzero(wrong):
        place = expected[row] if depth[row] > 0 else "null: not in view"
        yield finding(problem, place, got[row], int(frame.plants["plant_id"][row]))


@frame_check(
    "amodal", PLANTS,
    columns=("amodal_pixels", "amodal_area_px", "visible_fraction", *_BOX),
    when=lambda frame: not np.isnan(_columns(frame, "amodal_area_px")).all(),
)  # fmt: skip
def amodal(frame: FrameData) -> Iterator[Wrong]:
    """Visible pixels, box and fraction lie within the amodal ones, these within the image and the full box."""
    area, visible_area, fraction = _columns(frame, "amodal_area_px", "visible_area_px", "visible_fraction").T
    pixels, seen = _columns(frame, "amodal_pixels", "visible_pixels").T
    has_mask, filled = ~np.isnan(area), pixels > 0
    width, height = frame.size_px
    box, own = _columns(frame, *_BOX), _columns(frame, *(f"box_{side}" for side in "xywh"))
    yield Wrong((seen > 0) & ~has_mask, "a plant of the image has no amodal mask", "one", pixels)
    yield Wrong(has_mask & ~(pixels >= seen), "amodal_pixels is less than visible_pixels", seen, pixels)
    yield Wrong(filled == np.isnan(box).any(axis=1), "amodal_box and amodal_pixels disagree", "both", box)
    inside = np.all(box[:, :2] >= 0, axis=1) & (box[:, 0] + box[:, 2] <= width) & (box[:, 1] + box[:, 3] <= height)
    yield Wrong(filled & ~inside, "amodal_box leaves the image", f"within {width} x {height}", box)
    room = box[:, 2] * box[:, 3]
    yield Wrong(filled & ~(pixels <= room), "amodal_box is smaller than amodal_pixels", pixels, room)
    low = own[:, :2] >= box[:, :2]
    high = own[:, :2] + own[:, 2:] <= box[:, :2] + box[:, 2:]
    has_box = ~np.isnan(own).any(axis=1)
    yield Wrong(has_box & ~np.all(low & high, axis=1), "the box is not within amodal_box", own, box)
    yield Wrong(has_mask & ~(area >= 0), "amodal_area_px is no area", "0 or more", area)
    expected = np.minimum(np.divide(visible_area, area, out=np.full(len(area), np.nan), where=area > 0), 1.0)
    agree = (np.abs(fraction - expected) <= _TOLERANCE) | (np.isnan(fraction) & np.isnan(expected))
    yield Wrong(~agree, "visible_fraction is not visible by amodal area", expected, fraction)
    if all(map(frame.known, _FULL)):
        yield from _full_boxes(frame, box, filled)


def _full_boxes(frame: FrameData, box: NDArray[np.float64], filled: NDArray[np.bool_]) -> Iterator[Wrong]:
    width, height = frame.size_px
    full = _columns(frame, *_FULL)
    known = ~np.isnan(full).any(axis=1)
    yield Wrong(filled & ~known, "a plant with an amodal mask has no full box", "four numbers", full)
    low = np.floor(full[:, :2] - _EDGE_PX) <= box[:, :2]
    high = np.ceil(full[:, 2:] + _EDGE_PX) >= box[:, :2] + box[:, 2:]
    yield Wrong(filled & known & ~(low & high).all(axis=1), "amodal_box is not within full_box", full, box)
    if frame.known("truncation"):
        kept = np.clip(full, 0, (width, height, width, height))
        extent = (full[:, 2] - full[:, 0]) * (full[:, 3] - full[:, 1])
        part = np.maximum(kept[:, 2] - kept[:, 0], 0) * np.maximum(kept[:, 3] - kept[:, 1], 0)
        share = 1 - np.divide(part, extent, out=np.ones_like(part), where=extent > 0)
        got = frame.plants["truncation"].astype(np.float64)
        wrong = known & (extent > 0) & ~(np.abs(got - share) <= _TOLERANCE)
        yield Wrong(wrong, "truncation is not the full box' share outside the image", share, got)
        yield Wrong(known & ~((got >= 0) & (got <= 1)), "truncation lies outside 0 to 1", "0 to 1", got)


def _columns(frame: FrameData, *names: str) -> NDArray[np.float64]:
    """(N, columns) numbers of plants.parquet."""
    return np.stack([frame.plants[name].astype(np.float64) for name in names], axis=1)


def _differs(column: str) -> str:
    return f"{column} differs from the mask's"
