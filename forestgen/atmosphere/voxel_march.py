"""Helpers of compiled loops that follow straight lines through a grid, box by box, and read values between cells.

The march is that of Amanatides and Woo (1987). But where a line leaves a box is computed from the box' number, so that
no error adds up. Lengths are in cells: along an axis, box n is all from low + n side to low + (n + 1) side.

Reference
---------
Amanatides, J., Woo, A. (1987): A fast voxel traversal algorithm for ray tracing. Eurographics 1987, 3-10.
"""

from __future__ import annotations

import numpy as np

from forestgen.core.compiled import inlined_exactly


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
