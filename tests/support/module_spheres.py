"""How much the spheres of branch modules intersect as a whole (Makowski 2023, section 2.8, Figure 18 a)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes, SphereGrid, overlap_volumes


def overlap(grid: SphereGrid, parent_row: NDArray[np.integer], boxes: Boxes = NO_BOXES) -> NDArray[np.float32]:
    """(M,) crowding f(u) of each module, in units of its own volume (Eq. 1)."""
    return (overlap_volumes(grid, parent_row, boxes) / grid.volume_m3).astype(np.float32)


def intersection_ratio(grid: SphereGrid, parent_row: NDArray[np.integer] | None = None) -> float:
    """Sum of the common volumes of all pairs over the sum of all volumes; 0 without modules.

    Pairs that share a joint, by the (M,) rows of the modules that bear each, do not count; without rows all pairs do.
    """
    if not len(grid):
        return 0.0
    rows = np.full(len(grid), -1) if parent_row is None else parent_row
    return float(0.5 * overlap_volumes(grid, rows).sum() / grid.volume_m3.sum())
