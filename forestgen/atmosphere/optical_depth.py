"""Optical depth of clouds along rays: the integral of the very field that is rendered, exactly.

The renderer reads the grid's values as those of the cells' centres, interpolates them trilinearly, holds the border's
values out to the faces of the box, and knows nothing outside it. Between the planes through the cells' centres such a
field is a cubic polynomial along a ray, which Gauss and Legendre's rule integrates exactly from two points a piece. A
ray costs O(pieces that it crosses), in double precision, and no step has to be chosen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.voxel_march import advanced, clipped, corners, entered, inside, piece
from forestgen.core.compiled import borrowed, compiled
from forestgen.core.threads import over_ranges

_OPAQUE = 40.0  # 1 - exp(-40) is 1 in single precision
_HALVINGS = 14  # of a ray across the box: to a 16,000th


def optical_depth(
    grid: CloudGrid,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    distance_m: NDArray[np.floating] | float,
    *,
    enough: float = np.inf,
) -> NDArray[np.float64]:
    """Optical depth along rays, from each one's origin to its distance.

    Parameters
    ----------
    origin_m : (3,) or (..., 3) world.
    direction : (..., 3) unit, world.
    distance_m : (...) or one for all: how far each ray goes, inf for all the way.
    enough : a ray ends where its optical depth has passed this.
    """
    shape = direction.shape[:-1]
    low, high = np.asarray(grid.low_m, dtype=np.float64), np.asarray(grid.high_m, dtype=np.float64)
    cells = np.array(grid.extinction_per_m.shape[::-1])
    # In units of cells, from the first cell's centre: the values stand at whole numbers.
    per_m = cells / (high - low)
    start = np.broadcast_to((np.asarray(origin_m, dtype=np.float64) - low) * per_m - 0.5, (*shape, 3))
    out = np.zeros(int(np.prod(shape)))
    value = np.ascontiguousarray(grid.extinction_per_m)
    start = np.ascontiguousarray(start.reshape(-1, 3))
    step = np.ascontiguousarray((direction * per_m).reshape(-1, 3), dtype=np.float64)
    length = np.ascontiguousarray(np.broadcast_to(distance_m, shape).reshape(-1), dtype=np.float64)
    over_ranges(len(out), lambda first, end: _integrate(value, start, step, length, enough, first, end, out))
    return out.reshape(shape)


def cloud_opacity(
    grid: CloudGrid,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    distance_m: NDArray[np.float32],
) -> NDArray[np.float32]:
    """(H, W) share of the light along each pixel centre's ray that clouds scatter or take away, in [0, 1].

    Parameters
    ----------
    origin_m : (3,) or (H, W, 3) world, where the rays begin.
    direction : (H, W, 3) unit, world.
    distance_m : (H, W) along the ray to the surface behind which clouds do not count; inf for the sky, 0: no ray.
    """
    depth = optical_depth(grid, origin_m, direction, distance_m, enough=_OPAQUE)
    return (-np.expm1(-depth)).astype(np.float32)


def distance_into(
    grid: CloudGrid, origin_m: NDArray[np.float64], direction: NDArray[np.float64], share: float = 0.5
) -> NDArray[np.float64]:
    """(...) metres along rays to where a share of what clouds take out of them is taken; inf where that is nothing.

    Parameters
    ----------
    origin_m, direction : as for `optical_depth`.
    """
    size = np.subtract(grid.high_m, grid.low_m)
    middle = (np.asarray(grid.low_m) + grid.high_m) / 2
    far = np.linalg.norm(np.asarray(origin_m) - middle, axis=-1) + np.linalg.norm(size)  # beyond the box
    whole = -np.expm1(-optical_depth(grid, origin_m, direction, np.inf, enough=_OPAQUE))
    low, high = np.zeros(whole.shape), np.broadcast_to(far, whole.shape).astype(np.float64)
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        before = -np.expm1(-optical_depth(grid, origin_m, direction, half, enough=_OPAQUE)) < share * whole
        low, high = np.where(before, half, low), np.where(before, high, half)
    return np.where(whole > 0, high, np.inf)


@compiled
def _integrate(value, start, step, length, enough, first_ray, end_ray, out):  # type: ignore[no-untyped-def]
    """Fill `out` (R,) with integrals of `value` (Z, Y, X) along start + t step, t from 0 to `length`, where it is.

    Piece n along an axis lies between the centres of cells n and n + 1; -1 and the last are the halves of cells at the
    border.
    """
    value = borrowed(value)
    layers, rows, columns = value.shape
    pieces = (columns, rows, layers)
    for ray in range(first_ray, end_ray):
        place = (start[ray, 0], start[ray, 1], start[ray, 2])
        way = (step[ray, 0], step[ray, 1], step[ray, 2])
        t, end = clipped(place, way, length[ray], -0.5, (columns - 0.5, rows - 0.5, layers - 0.5))
        if not t < end:
            continue
        box, leaves = entered(place, way, t, 0.0, 1, -1, pieces)
        total = 0.0
        while total <= enough:
            ahead = min(leaves)
            until = min(ahead, end)
            if until > t:
                total += _piece(value, box, place, way, t, until)
                t = until
            if ahead >= end:
                break
            box, leaves = advanced(box, leaves, place, way, 0.0, 1)
            if not inside(box, -1, pieces):
                break
        out[ray] = total


@compiled
def _piece(value, box, start, step, first, last):  # type: ignore[no-untyped-def]
    """Integral over [first, last], all of it between the same eight values."""
    corner = corners(value, box[0], box[1], box[2])
    a, b, c, d, e, f, g, h = corner
    if a == b == c == d == e == f == g == h:
        return (last - first) * np.float64(a)
    return piece(corner, box, start, step, first, last, 0.5 * (last - first) / np.sqrt(3.0))
