"""Shapes that last: persistent homology of point patterns and of fields.

`holes` is that of degree 1 of the union of discs that grow about points. As the discs grow, they enclose holes (a hole
is born) and fill them (it dies). Long-lived holes are clearings: a regular pattern has many of one size, a clustered
one a few that live long.

O(N log N) by the alpha complex, which lives on the Delaunay triangulation: a hundred thousand points take seconds.

`field_features` is that of the cells of a grid above a falling level.

References
----------
Edelsbrunner and Harer 2010, Computational Topology, ch. III and VII. The GUDHI library, `AlphaComplex` and
`CubicalComplex`.
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


def field_features(field: NDArray[np.floating], dimension: int, *, periodic: bool) -> NDArray[np.float64]:
    """Persistence diagram of a field over a grid, as the level from which one looks at it falls.

    Of dimension 0 are islands: a maximum rises from the water, and ends where its island joins a higher one. Of
    dimension 1 are lakes: land closes around one, and it ends where its last cell is land too. So spots are islands
    that live long, gaps lakes that do. Of a torus, loops around it are no lakes and are left out, and so is its lowest
    lake, which is its sea.

    Parameters
    ----------
    field : (rows, cols), finite; cells that share a corner are joined.
    dimension : 0 or 1.
    periodic : the grid is a torus.

    Returns
    -------
    (M, 2) float64, levels of birth and death, in the field's unit: birth above death, longest-lived first. The island
    of the highest cell never joins another; its death is the field's least value.
    """
    import gudhi

    cells = -np.asarray(field, dtype=np.float64)
    if cells.ndim != 2 or not np.isfinite(cells).all():
        raise ValueError(f"field: expected finite values on a grid of two axes, got shape {cells.shape}")
    if dimension not in (0, 1):
        raise ValueError(f"dimension: expected 0 (islands) or 1 (lakes), got {dimension!r}")
    if periodic:
        filled = gudhi.PeriodicCubicalComplex(top_dimensional_cells=cells, periodic_dimensions=[True, True])
    else:
        filled = gudhi.CubicalComplex(top_dimensional_cells=cells)
    filled.compute_persistence()
    levels = np.asarray(filled.persistence_intervals_in_dimension(dimension), dtype=np.float64).reshape(-1, 2)
    lasting = np.isinf(levels[:, 1])
    if dimension == 0:
        levels[lasting, 1] = cells.max()
    else:
        levels = levels[~lasting]
    return -levels[np.argsort(levels[:, 0] - levels[:, 1], kind="stable")]
