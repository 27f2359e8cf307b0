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
    """Fill `out` (R,) with integrals of `value` (Z, Y, X) along start + t step, t from 0 to `length`, where it is."""
    value = borrowed(value)
    layers, rows, columns = value.shape
    for ray in range(first_ray, end_ray):
        x, y, z = start[ray, 0], start[ray, 1], start[ray, 2]
        dx, dy, dz = step[ray, 0], step[ray, 1], step[ray, 2]
        t, end = _clipped(0.0, length[ray], x, dx, columns - 0.5)
        t, end = _clipped(t, end, y, dy, rows - 0.5)
        t, end = _clipped(t, end, z, dz, layers - 0.5)
        if not t < end:
            continue
        i, j, k = _piece_at(x + t * dx, columns), _piece_at(y + t * dy, rows), _piece_at(z + t * dz, layers)
        # t at which the ray leaves its piece along each axis: each from its number, so that no error adds up.
        ahead_x, ahead_y, ahead_z = _leaves(i, x, dx), _leaves(j, y, dy), _leaves(k, z, dz)
        total = 0.0
        while total <= enough:
            ahead = min(ahead_x, ahead_y, ahead_z)
            until = min(ahead, end)
            if until > t:
                total += _piece(value, i, j, k, x, y, z, dx, dy, dz, t, until)
                t = until
            if ahead >= end:
                break
            if ahead == ahead_x:
                i += 1 if dx > 0.0 else -1
                ahead_x = _leaves(i, x, dx)
            elif ahead == ahead_y:
                j += 1 if dy > 0.0 else -1
                ahead_y = _leaves(j, y, dy)
            else:
                k += 1 if dz > 0.0 else -1
                ahead_z = _leaves(k, z, dz)
            if not (-1 <= i < columns and -1 <= j < rows and -1 <= k < layers):
                break
        out[ray] = total


@compiled
def _clipped(first, last, start, step, high):  # type: ignore[no-untyped-def]
    """The part of [first, last] in which start + t step lies between -0.5 and `high`."""
    if step == 0.0:
        return (first, last) if -0.5 <= start <= high else (1.0, 0.0)
    a, b = (-0.5 - start) / step, (high - start) / step
    return max(first, min(a, b)), min(last, max(a, b))


@compiled
def _piece_at(place, size):  # type: ignore[no-untyped-def]
    """Number of the piece [n, n + 1] that holds a place; -1 and size - 1 are the halves of cells at the border."""
    return min(max(int(np.floor(place)), -1), size - 1)


@compiled
def _leaves(index, start, step):  # type: ignore[no-untyped-def]
    """t at which start + t step leaves [index, index + 1]."""
    if step == 0.0:
        return np.inf
    return ((index + 1 if step > 0.0 else index) - start) / step


@compiled
def _piece(value, i, j, k, x, y, z, dx, dy, dz, first, last):  # type: ignore[no-untyped-def]
    """Integral over [first, last], all of it between the same eight values."""
    layers, rows, columns = value.shape
    i0, i1 = max(i, 0), min(i + 1, columns - 1)
    j0, j1 = max(j, 0), min(j + 1, rows - 1)
    k0, k1 = max(k, 0), min(k + 1, layers - 1)
    a, b, c, d = value[k0, j0, i0], value[k0, j0, i1], value[k0, j1, i0], value[k0, j1, i1]
    e, f, g, h = value[k1, j0, i0], value[k1, j0, i1], value[k1, j1, i0], value[k1, j1, i1]
    if a == b == c == d == e == f == g == h:
        return (last - first) * np.float64(a)
    middle, reach = 0.5 * (first + last), 0.5 * (last - first) / np.sqrt(3.0)
    total = 0.0
    for t in (middle - reach, middle + reach):
        u, v, w = x + t * dx - i, y + t * dy - j, z + t * dz - k
        below = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v
        above = (e * (1.0 - u) + f * u) * (1.0 - v) + (g * (1.0 - u) + h * u) * v
        total += below * (1.0 - w) + above * w
    return 0.5 * (last - first) * total
