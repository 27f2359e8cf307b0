"""Where rain stands on paths and roads: in hollows of their trodden ground, up to where the water would run off.

The level is that of a filled hollow (Planchon and Darboux 2001), less `_DRAINED_M` of water that soaks away: a number
of ours, by which shallow hollows are dry. Water runs off at the edges of a path's strip. It is seen, and no label or
depth knows of it.

Reference
---------
Planchon, O., Darboux, F. (2001): A fast, simple and versatile algorithm to fill the depressions of digital elevation
models. Catena 46, 159-176.
"""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Floats
from forestgen.scene.courses import STEP_M
from forestgen.scene.shaped_ground import ShapedGround
from forestgen.scene.terrain import HeightField

_DRAINED_M = 0.01
_BESIDE_M = 0.5  # of a path's edge, where water runs off
_NONE_M = -1.0


def puddles_m(ground: HeightField, x_m: Floats, y_m: Floats) -> Floats:
    """(N,) depth of puddles at points, below 0 where the ground is above their level."""
    depth = np.full(len(x_m), _NONE_M)
    if not isinstance(ground, ShapedGround) or not ground.tracks:
        return depth
    from scipy.ndimage import maximum_filter  # late: half a second
    from scipy.spatial import cKDTree

    places = np.column_stack([x_m, y_m])
    for track in ground.tracks:
        side = int(np.ceil((track.half_m + _BESIDE_M) / STEP_M))
        strip = track.course.across_m(np.arange(-side, side + 1) * np.float64(STEP_M))
        z = ground(strip[..., 0], strip[..., 1])
        full = filled(z) - _DRAINED_M
        level = np.asarray(maximum_filter(np.where(full > z, full, -np.inf), size=3)).ravel()
        apart, nearest = (
            np.asarray(one) for one in cKDTree(strip.reshape(-1, 2)).query(places, distance_upper_bound=STEP_M)
        )
        near = np.flatnonzero(np.isfinite(apart))
        here = level[nearest[near]] - ground(*places[near].T)
        depth[near] = np.maximum(depth[near], here)
    return depth


def filled(height_m: Floats) -> Floats:
    """(K, M) level of water that fills all hollows of a grid of heights and runs off at its edges."""
    level = np.full((height_m.shape[0] + 2, height_m.shape[1] + 2), -np.inf)
    inner = level[1:-1, 1:-1]
    inner[...] = np.inf
    while True:
        around = np.min(
            [
                level[1 + i : level.shape[0] - 1 + i, 1 + j : level.shape[1] - 1 + j]
                for i in (-1, 0, 1)
                for j in (-1, 0, 1)
                if (i, j) != (0, 0)
            ],
            axis=0,
        )
        lower = np.maximum(height_m, around)
        if np.array_equal(lower, inner):
            return np.asarray(lower)
        inner[...] = lower
