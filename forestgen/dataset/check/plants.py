"""plants.parquet against the masks: pixels, areas, boxes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.dataset.check.finding import Finding, number, numbers
from forestgen.dataset.check.frame_data import PLANTS, FrameData

_BOX = ("box_x", "box_y", "box_w", "box_h")
_PLACES = ("x_m", "y_m", "z_m")
_SIZES = ("height_m", "radius_m", "age_yr", "distance_m", "leaf_area_m2", "crown_width_m")
_AREA_TOLERANCE = 1e-3  # relative; shares are stored as float32


def visible(frame: FrameData) -> Iterator[Finding]:
    """visible_pixels, box and truncated are those of the mask."""
    extents, plants = frame.extents, frame.plants
    width, height = frame.size_px
    row_of = extents.row_of
    boxes = np.stack([plants[side].astype(np.float64) for side in _BOX], axis=1)
    for row, plant in enumerate(plants["plant_id"].tolist()):
        seen = row_of.get(plant)
        pixels = 0 if seen is None else int(extents.pixels[seen])
        if plants["visible_pixels"][row] != pixels:
            yield _differs(frame, plant, "visible_pixels", pixels, plants["visible_pixels"][row])
        if seen is None:
            if not np.isnan(boxes[row]).all():
                yield _differs(frame, plant, "box of an unseen plant", "null", numbers(boxes[row]))
            touches = False
        else:
            x, y, w, h = (int(side) for side in extents.box_px[seen])
            if not np.array_equal(boxes[row], (x, y, w, h)):
                yield _differs(frame, plant, "box x, y, w, h", f"{x} {y} {w} {h}", numbers(boxes[row]))
            touches = x == 0 or y == 0 or x + w == width or y + h == height
        if bool(plants["truncated"][row]) != touches:
            yield _differs(frame, plant, "truncated", touches, plants["truncated"][row])


def areas(frame: FrameData) -> Iterator[Finding]:
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
    wrong = ~((area >= least - slack) & (area <= least + slack + rest))
    for row in np.flatnonzero(wrong):
        yield _differs(frame, int(known[row]), "visible_area_px", number(least[row]), area[row])


def stems(frame: FrameData) -> Iterator[Finding]:
    """stem_pixels counts the plant's pixels whose part is the trunk."""
    known = frame.plants["plant_id"]
    trunk = frame.instance[(frame.part == int(Part.TRUNK)) & (frame.instance != 0)]
    rows = np.searchsorted(known, trunk)
    count = np.bincount(rows[rows < len(known)], minlength=len(known))
    stored = frame.plants["stem_pixels"]
    for row in np.flatnonzero(~(stored == count)):
        yield _differs(frame, int(known[row]), "stem_pixels", int(count[row]), stored[row])


def has_stems(frame: FrameData) -> bool:
    return frame.known("stem_pixels")


def finite(frame: FrameData) -> Iterator[Finding]:
    """Measures that every plant has are finite numbers, sizes not negative."""
    for column in (*_PLACES, *_SIZES):
        if not frame.known(column):
            continue
        values = frame.plants[column].astype(np.float64)
        wrong: NDArray[np.bool_] = ~np.isfinite(values)
        if column in _SIZES:
            wrong |= ~(values >= 0)
        for row in np.flatnonzero(wrong):
            plant = int(frame.plants["plant_id"][row])
            yield frame.finding(
                PLANTS, f"{column} is no measure", expected="a number", got=number(values[row]), plant_id=plant
            )


def _differs(frame: FrameData, plant: int, column: str, expected: object, got: object) -> Finding:
    return frame.finding(
        PLANTS, f"{column} differs from the mask's", expected=str(expected), got=number(got), plant_id=plant
    )
