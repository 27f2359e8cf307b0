"""Holes in a point pattern: persistent homology of degree 1 of the union of discs that grow about the points.

As the discs grow, they enclose holes (a hole is born) and fill them (it dies). Long-lived holes are clearings: a
regular pattern has many of one size, a clustered one a few that live long.

O(N log N) by the alpha complex, which lives on the Delaunay triangulation: a hundred thousand points take seconds.

References
----------
Edelsbrunner and Harer 2010, Computational Topology, ch. III and VII. The GUDHI library, `AlphaComplex`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ROUNDING = 1e-9  # triangles with corners on a common circle make holes of no life


def holes(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Persistence diagram of the holes: when each is born and dies.

    Parameters
    ----------
    points_m : (N, 2) float64, metres.

    Returns
    -------
    (M, 2) float64, radii of the discs at birth and death in metres, longest-lived first.
    """
    import gudhi  # late: only those who ask for holes wait for it

    if len(points_m) < 3:
        return np.empty((0, 2))
    tree = gudhi.AlphaComplex(points=np.asarray(points_m, dtype=np.float64)).create_simplex_tree()
    tree.compute_persistence()
    squares = np.asarray(tree.persistence_intervals_in_dimension(1), dtype=np.float64).reshape(-1, 2)
    radii = np.sqrt(squares)
    radii = radii[radii[:, 1] - radii[:, 0] > _ROUNDING * radii[:, 1]]
    return radii[np.argsort(radii[:, 0] - radii[:, 1], kind="stable")]


def total_persistence(diagram_m: NDArray[np.float64], power: float = 1.0) -> float:
    """Sum of lifetimes, each to a power: metres to that power."""
    return float(np.sum((diagram_m[:, 1] - diagram_m[:, 0]) ** power))
