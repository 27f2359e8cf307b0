"""Which points of a pattern stay when no two may be nearer than a distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def stays_apart(
    points_m: NDArray[np.float64], distance_m: float, size_m: tuple[float, float], *, periodic: bool
) -> NDArray[np.bool_]:
    """(N,) whether a point stays: it does unless it is nearer than the distance to one before it that stays.

    Parameters
    ----------
    points_m : (N, 2) metres, in [0, W) x [0, H) if `periodic`.
    """
    keep = np.ones(len(points_m), dtype=np.bool_)
    if len(points_m) < 2:
        return keep
    tree = cKDTree(points_m, boxsize=np.array(size_m) if periodic else None)
    near = tree.query_pairs(np.nextafter(distance_m, 0.0), output_type="ndarray")
    for a, b in near[np.lexsort((near[:, 1], near[:, 0]))].tolist():
        keep[b] = keep[b] and not keep[a]
    return keep
