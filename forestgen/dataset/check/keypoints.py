"""Keypoints in plants.parquet: where they are and whether they are seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.frame_data import PLANTS, FrameData
from forestgen.dataset.check.offence import Offence, number

NAMES = ("stem_base", "tip", "crown_centre")


def has_keypoints(frame: FrameData) -> bool:
    return all(frame.known(f"{name}_{end}") for name in NAMES for end in ("x_px", "y_px", "state"))


def keypoints(frame: FrameData) -> Iterator[Offence]:
    """State is 0 outside the image; inside, 2 where the mask's pixel is the plant's, and 1 elsewhere."""
    plants = frame.plants
    for name in NAMES:
        x, y = (plants[f"{name}_{axis}_px"].astype(np.float64) for axis in "xy")
        expected = states(x, y, plants["plant_id"], frame.instance)
        got = plants[f"{name}_state"]
        for row in np.flatnonzero(~(got == expected)):
            yield frame.offence(
                PLANTS,
                f"{name}_state does not follow from the mask",
                expected=f"{expected[row]}: {('outside the image', 'hidden', 'visible')[expected[row]]}",
                got=number(got[row]),
                plant_id=int(plants["plant_id"][row]),
                pixel=(int(x[row]), int(y[row])) if expected[row] else None,
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
