"""Optical depth of clouds along rays: the integral of the very field that is rendered, exactly.

The renderer reads the grid's values as those of the cells' centres, interpolates them trilinearly, holds the border's
values out to the faces of the box, and knows nothing outside it. Between the planes through the cells' centres such a
field is a cubic polynomial along a ray, which Gauss and Legendre's rule integrates exactly from two points a piece. A
ray costs O(pieces that it crosses), in double precision, and no step has to be chosen. Of clouds with detail
(atmosphere/cloud_detail.py) the same rule takes steps of at most a sixteenth of a cell where the edge is in it, and of
half a cell inside: the mean over rays is right, and a single one's edges within such a step.

The first functions serve all compiled loops that follow straight lines through a grid, box by box, and read values
between cells. The march is that of Amanatides and Woo (1987), but where a line leaves a box is computed from the box'
number, so that no error adds up. Lengths are in cells: along an axis, box n is all from low + n side to
low + (n + 1) side.

Reference
---------
Amanatides, J., Woo, A. (1987): A fast voxel traversal algorithm for ray tracing. Eurographics 1987, 3-10.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.cloud_detail import EMPTY, FULL, SUB, share_inside
from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.compiled import compiled, inlined_exactly, unowned_view
from forestgen.core.threads import parallel_for

_OPAQUE = 40.0  # 1 - exp(-40) is 1 in single precision
_HALVINGS = 14  # of a ray across the box: to a 16,000th
_EDGES = ((np.min, "low_m"), (np.max, "high_m"))  # of all layers


@inlined_exactly
def clipped(start, step, last, low, high):  # type: ignore[no-untyped-def]
    """The part of [0, last] in which start + t step is between `low` and the three of `high`; empty: (1, 0)."""
    first = 0.0
    for axis in range(3):
        if step[axis] == 0.0:
            if not low <= start[axis] <= high[axis]:
                return 1.0, 0.0
        else:
            a, b = (low - start[axis]) / step[axis], (high[axis] - start[axis]) / step[axis]
            first, last = max(first, min(a, b)), min(last, max(a, b))
    return first, last


@inlined_exactly
def entered(start, step, t, low, side, least, count):  # type: ignore[no-untyped-def]
    """Box (3,) at t, each of its numbers from `least` to that of `count` - 1, and t (3,) where each axis leaves it."""
    i = min(max(int(np.floor((start[0] + t * step[0] - low) / side)), least), count[0] - 1)
    j = min(max(int(np.floor((start[1] + t * step[1] - low) / side)), least), count[1] - 1)
    k = min(max(int(np.floor((start[2] + t * step[2] - low) / side)), least), count[2] - 1)
    leaves = (
        _leaves(i, start[0], step[0], low, side),
        _leaves(j, start[1], step[1], low, side),
        _leaves(k, start[2], step[2], low, side),
    )
    return (i, j, k), leaves


@inlined_exactly
def advanced(box, leaves, start, step, low, side):  # type: ignore[no-untyped-def]
    """The next box, and t (3,) where each axis leaves it."""
    i, j, k = box
    x, y, z = leaves
    nearest = min(x, y, z)
    if nearest == x:
        i += 1 if step[0] > 0.0 else -1
        x = _leaves(i, start[0], step[0], low, side)
    elif nearest == y:
        j += 1 if step[1] > 0.0 else -1
        y = _leaves(j, start[1], step[1], low, side)
    else:
        k += 1 if step[2] > 0.0 else -1
        z = _leaves(k, start[2], step[2], low, side)
    return (i, j, k), (x, y, z)


@inlined_exactly
def inside(box, least, count):  # type: ignore[no-untyped-def]
    """Whether a box is one of the grid's."""
    i, j, k = box
    return least <= i < count[0] and least <= j < count[1] and least <= k < count[2]


@inlined_exactly
def _leaves(number, start, step, low, side):  # type: ignore[no-untyped-def]
    """t at which start + t step leaves a box along one axis."""
    if step == 0.0:
        return np.inf
    return ((number + 1 if step > 0.0 else number) * side + low - start) / step


@inlined_exactly
def corners(value, i, j, k):  # type: ignore[no-untyped-def]
    """The eight values (Z, Y, X) about a place whose whole numbers are i, j, k; those of the border hold beyond it."""
    layers, rows, columns = value.shape
    i0, i1 = min(max(i, 0), columns - 1), min(max(i + 1, 0), columns - 1)
    j0, j1 = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    k0, k1 = min(max(k, 0), layers - 1), min(max(k + 1, 0), layers - 1)
    return (
        value[k0, j0, i0], value[k0, j0, i1], value[k0, j1, i0], value[k0, j1, i1],
        value[k1, j0, i0], value[k1, j0, i1], value[k1, j1, i0], value[k1, j1, i1],
    )  # fmt: skip


@inlined_exactly
def mixed(corner, u, v, w):  # type: ignore[no-untyped-def]
    """The trilinear value between eight, at shares of the way along x, y and z."""
    a, b, c, d, e, f, g, h = corner
    below = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v
    above = (e * (1.0 - u) + f * u) * (1.0 - v) + (g * (1.0 - u) + h * u) * v
    return below * (1.0 - w) + above * w


@inlined_exactly
def piece(corner, box, start, step, first, last, reach):  # type: ignore[no-untyped-def]
    """Integral between eight values over [first, last], from two points `reach` off the middle.

    With a reach of (last - first) / (2 sqrt 3) it is Gauss and Legendre's rule, which is exact: the value is a cubic.
    """
    i, j, k = box
    x, y, z = start
    dx, dy, dz = step
    middle, total = 0.5 * (first + last), 0.0
    for t in (middle - reach, middle + reach):
        total += mixed(corner, x + t * dx - i, y + t * dy - j, z + t * dz - k)
    return 0.5 * (last - first) * total


def largest_in_boxes(value: NDArray[np.float32], starts: Sequence[NDArray[np.integer]]) -> NDArray[np.float32]:
    """Largest value that a point of each box can have; boxes begin at the cells `starts` along z, y and x.

    It lies in one of the box' own cells or the next on any side.
    """
    from scipy.ndimage import maximum_filter

    most = maximum_filter(value, size=3, mode="nearest")
    for axis, first in enumerate(starts):
        most = np.maximum.reduceat(most, first, axis=axis)
    return np.ascontiguousarray(most)


def optical_depth(
    grid: CloudGrid,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    distance_m: NDArray[np.floating] | float,
    *,
    enough: float = np.inf,
) -> NDArray[np.float64]:
    """(...) optical depth along rays, from origins (3,) or (..., 3) in (..., 3) unit directions, world.

    `distance_m` (...), or one for all, is how far each ray goes, inf for all the way. A ray ends where its optical
    depth has passed `enough`.
    """
    shape = direction.shape[:-1]
    low, high = np.asarray(grid.low_m, dtype=np.float64), np.asarray(grid.high_m, dtype=np.float64)
    cells = np.array(grid.extinction_per_m.shape[::-1])
    # In units of cells, from the first cell's centre: the values stand at whole numbers.
    per_m = cells / (high - low)
    start = np.broadcast_to((np.asarray(origin_m, dtype=np.float64) - low) * per_m - 0.5, (*shape, 3))
    out = np.zeros(int(np.prod(shape)))
    value = np.ascontiguousarray(grid.inside_per_m)
    start = np.ascontiguousarray(start.reshape(-1, 3))
    step = np.ascontiguousarray((direction * per_m).reshape(-1, 3), dtype=np.float64)
    length = np.ascontiguousarray(np.broadcast_to(distance_m, shape).reshape(-1), dtype=np.float64)
    given, detail = (value, start, step, length, enough), grid.detail
    if detail.brick.size:
        parallel_for(len(out), lambda first, end: _integrate_detail(detail, *given, first, end, out))
    else:
        parallel_for(len(out), lambda first, end: _integrate(*given, first, end, out))
    if grid.above is not None:
        out += optical_depth(grid.above, origin_m, direction, distance_m, enough=enough).ravel()
    return out.reshape(shape)


def cloud_opacity(
    grid: CloudGrid, origin_m: NDArray[np.float64], direction: NDArray[np.float64], distance_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(H, W) share of the light along each pixel centre's ray that clouds scatter or take away, in [0, 1].

    Rays are as for `optical_depth`. Clouds do not count behind the surface at `distance_m`; inf for the sky, 0: no ray.
    """
    depth = optical_depth(grid, origin_m, direction, distance_m, enough=_OPAQUE)
    return (-np.expm1(-depth)).astype(np.float32)


def distance_into(
    grid: CloudGrid, origin_m: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(...) metres along rays to where half of what clouds take out of them is taken; inf where that is nothing."""
    low_m, high_m = (edge([getattr(one, name) for one in grid.layers], axis=0) for edge, name in _EDGES)
    size, middle = high_m - low_m, (low_m + high_m) / 2
    far = np.linalg.norm(np.asarray(origin_m) - middle, axis=-1) + np.linalg.norm(size)  # beyond the box
    whole = -np.expm1(-optical_depth(grid, origin_m, direction, np.inf, enough=_OPAQUE))
    low, high = np.zeros(whole.shape), np.broadcast_to(far, whole.shape).astype(np.float64)
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        before = -np.expm1(-optical_depth(grid, origin_m, direction, half, enough=_OPAQUE)) < 0.5 * whole
        low, high = np.where(before, half, low), np.where(before, high, half)
    return np.where(whole > 0, high, np.inf)


@compiled
def _integrate(value, start, step, length, enough, first_ray, end_ray, out):  # type: ignore[no-untyped-def]
    """Fill `out` (R,) with integrals of `value` (Z, Y, X) along start + t step, t from 0 to `length`, where it is.

    Piece n along an axis lies between the centres of cells n and n + 1; -1 and the last are the halves of cells at the
    border.
    """
    value = unowned_view(value)
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


@compiled
def _integrate_detail(detail, value, start, step, length, enough, first_ray, end_ray, out):  # type: ignore[no-untyped-def]
    """As `_integrate`, of a field with detail: from cell to cell."""
    detail, value = unowned_view((detail, value))
    layers, rows, columns = value.shape
    cells = (columns, rows, layers)
    for ray in range(first_ray, end_ray):
        place = (start[ray, 0], start[ray, 1], start[ray, 2])
        way = (step[ray, 0], step[ray, 1], step[ray, 2])
        t, end = clipped(place, way, length[ray], -0.5, (columns - 0.5, rows - 0.5, layers - 0.5))
        if not t < end:
            continue
        box, leaves = entered(place, way, t, -0.5, 1, 0, cells)
        cells_per_m = max(abs(way[0]), abs(way[1]), abs(way[2]))
        total = 0.0
        while total <= enough:
            ahead = min(leaves)
            until = min(ahead, end)
            number = detail.brick[box[2], box[1], box[0]]
            if until > t:
                if number != EMPTY:
                    steps = 2.0 if number == FULL else 2.0 * SUB
                    total += _shares(
                        detail, value, place, way, t, until, int(np.ceil((until - t) * cells_per_m * steps))
                    )
                t = until
            if ahead >= end:
                break
            box, leaves = advanced(box, leaves, place, way, -0.5, 1)
            if not inside(box, 0, cells):
                break
        out[ray] = total


@compiled
def _shares(detail, value, start, step, first, last, count):  # type: ignore[no-untyped-def]
    """Integral over [first, last] inside one cell, in `count` steps of two points each."""
    size, total = (last - first) / count, 0.0
    for n in range(2 * count):
        t = first + (n // 2 + 0.5 + (n % 2 - 0.5) * 0.5773502691896258) * size
        x, y, z = start[0] + t * step[0], start[1] + t * step[1], start[2] + t * step[2]
        share = share_inside(detail, x, y, z)
        if share > 0.0:
            i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
            total += share * mixed(corners(value, i, j, k), x - i, y - j, z - k)
    return 0.5 * size * total


def distance_to_depth(
    grid: CloudGrid, origin_m: NDArray[np.float64], direction: NDArray[np.float64], depth: float
) -> NDArray[np.float64]:
    """(...) metres along rays to where clouds with detail have an optical depth, within a step; inf: nowhere."""
    low, high = np.asarray(grid.low_m, dtype=np.float64), np.asarray(grid.high_m, dtype=np.float64)
    per_m = np.array(grid.inside_per_m.shape[::-1]) / (high - low)
    shape = direction.shape[:-1]
    start = np.broadcast_to((np.asarray(origin_m, dtype=np.float64) - low) * per_m - 0.5, (*shape, 3))
    start = np.ascontiguousarray(start.reshape(-1, 3))
    step = np.ascontiguousarray((direction * per_m).reshape(-1, 3), dtype=np.float64)
    value, out = np.ascontiguousarray(grid.inside_per_m), np.full(len(step), np.inf)
    parallel_for(len(out), lambda first, end: _reach(grid.detail, value, start, step, depth, first, end, out))
    return out.reshape(shape)


@compiled
def _reach(detail, value, start, step, depth, first_ray, end_ray, out):  # type: ignore[no-untyped-def]
    """Fill `out` (R,) with t at which a ray's integral of the field with detail has passed `depth`."""
    detail, value = unowned_view((detail, value))
    layers, rows, columns = value.shape
    cells = (columns, rows, layers)
    for ray in range(first_ray, end_ray):
        place = (start[ray, 0], start[ray, 1], start[ray, 2])
        way = (step[ray, 0], step[ray, 1], step[ray, 2])
        t, end = clipped(place, way, np.inf, -0.5, (columns - 0.5, rows - 0.5, layers - 0.5))
        if not t < end:
            continue
        box, leaves = entered(place, way, t, -0.5, 1, 0, cells)
        cells_per_m = max(abs(way[0]), abs(way[1]), abs(way[2]))
        total = 0.0
        while total < depth:
            ahead = min(leaves)
            until = min(ahead, end)
            if until > t:
                if detail.brick[box[2], box[1], box[0]] != EMPTY:
                    count = int(np.ceil((until - t) * cells_per_m * 2.0 * SUB))
                    size = (until - t) / count
                    for n in range(count):
                        total += _shares(detail, value, place, way, t + n * size, t + (n + 1) * size, 1)
                        if total >= depth:
                            out[ray] = t + (n + 1) * size
                            break
                t = until
            if ahead >= end:
                break
            box, leaves = advanced(box, leaves, place, way, -0.5, 1)
            if not inside(box, 0, cells):
                break
