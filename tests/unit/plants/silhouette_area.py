"""Area that a plant covers, seen along a direction from far away: every triangle drawn on a fine grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from forestgen.plants.exemplar import Exemplar


@njit(nogil=True)  # type: ignore[untyped-decorator]
def _draw(corner: Any, grid: Any) -> None:
    """Set the cells whose middles lie within a triangle; corners (F, 3, 2) in cells."""
    for f in range(len(corner)):
        ax, ay, bx, by, cx, cy = (
            corner[f, 0, 0], corner[f, 0, 1], corner[f, 1, 0], corner[f, 1, 1], corner[f, 2, 0], corner[f, 2, 1],
        )  # fmt: skip
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0:
            continue
        for i in range(int(np.ceil(min(ax, bx, cx) - 0.5)), int(np.floor(max(ax, bx, cx) - 0.5)) + 1):
            for j in range(int(np.ceil(min(ay, by, cy) - 0.5)), int(np.floor(max(ay, by, cy) - 0.5)) + 1):
                x, y = i + 0.5, j + 0.5
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / twice
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / twice
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    grid[i, j] = True


def drawn(exemplar: Exemplar, direction: tuple[float, float, float], cell_m: float) -> NDArray[np.bool_]:
    """Cells of `cell_m` that the plant covers, seen along a direction, on a grid that belongs to the direction."""
    along = np.asarray(direction) / np.linalg.norm(direction)
    across = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(across, along)], axis=1)
    reach = 2.0 + np.linalg.norm(exemplar.bounds_m(), axis=1).max()
    grid = np.zeros((int(2 * reach / cell_m),) * 2, dtype=np.bool_)
    for organ in exemplar.organs:
        flat = (organ.mesh.vertices_m.astype(np.float64) @ axes + reach) / cell_m
        _draw(flat[organ.mesh.faces], grid)
    return grid
