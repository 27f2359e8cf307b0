"""Keypoints in plants.parquet: where they are and whether they are seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, number, numbers
from forestgen.dataset.check.frame_data import CAMERA, PLANTS, FrameData

_TOLERANCE_PX, _RELATIVE = 0.01, 1e-3  # places are stored as they are placed, to within float32 at the least
_GRAZING = 1e-3  # depth by distance, below which a point may or may not count as behind the camera
NAMES = ("stem_base", "tip", "crown_centre")


def has_keypoints(frame: FrameData) -> bool:
    return all(frame.known(f"{name}_{end}") for name in NAMES for end in ("x_px", "y_px", "state"))


def keypoints(frame: FrameData) -> Iterator[Finding]:
    """State is 0 outside the image; inside, 2 where the mask's pixel is the plant's, and 1 elsewhere."""
    plants = frame.plants
    for name in NAMES:
        x, y = (plants[f"{name}_{axis}_px"].astype(np.float64) for axis in "xy")
        expected = states(x, y, plants["plant_id"], frame.instance)
        got = plants[f"{name}_state"]
        for row in np.flatnonzero(~(got == expected)):
            yield frame.finding(
                PLANTS,
                f"{name}_state does not follow from the mask",
                expected=f"{expected[row]}: {('outside the image', 'hidden', 'visible')[expected[row]]}",
                got=number(got[row]),
                plant_id=int(plants["plant_id"][row]),
                pixel=(int(x[row]), int(y[row])) if expected[row] else None,
            )


def has_places(frame: FrameData) -> bool:
    return frame.has(CAMERA) and all(map(frame.known, ("x_m", "y_m", "z_m", "stem_base_x_px", "stem_base_y_px")))


def places(frame: FrameData) -> Iterator[Finding]:
    """The stem base is where the camera projects the plant's place; none where it cannot see it."""
    plants, camera = frame.plants, frame.camera
    place = np.stack([plants[f"{axis}_m"].astype(np.float64) for axis in "xyz"], axis=1)
    own = (place - camera.position_m) @ camera.rotation.T
    expected, depth = camera.geometry.project(own)
    got = np.stack([plants[f"stem_base_{axis}_px"].astype(np.float64) for axis in "xy"], axis=1)
    off = np.abs(got - expected)
    if camera.projection.wraps_x:
        off[:, 0] = np.minimum(off[:, 0], np.abs(off[:, 0] - camera.size_px[0]))  # at the seam: either end
    there = ~np.isnan(got).any(axis=1)
    sure = np.abs(depth) > _GRAZING * np.sqrt((own**2).sum(axis=1))
    beyond_px = camera.geometry.beyond_rim_px(expected)
    if beyond_px is not None:
        sure = np.abs(beyond_px) > _TOLERANCE_PX
    wrong = sure & (there != (depth > 0))
    wrong |= there & sure & ~(off <= _TOLERANCE_PX + _RELATIVE * np.abs(expected)).all(axis=1)
    for row in np.flatnonzero(wrong):
        yield frame.finding(
            PLANTS,
            "stem_base_x_px, stem_base_y_px are not the plant's place as the camera sees it",
            expected=numbers(expected[row]) if depth[row] > 0 else "null: not in view",
            got=numbers(got[row]),
            plant_id=int(plants["plant_id"][row]),
        )


def states(
    x: NDArray[np.float64], y: NDArray[np.float64], plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> NDArray[np.int64]:
    """(N,) states of points at x, y (N,) of plants; NaN lies outside."""
    height, width = instance.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    column = np.where(inside, x, 0).astype(np.int64)
    line = np.where(inside, y, 0).astype(np.int64)
    seen = instance[line, column] == plant_id
    return np.where(inside, np.where(seen, 2, 1), 0)
