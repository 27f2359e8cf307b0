"""The environment of a community: circles on the ground, and which of them are dominated.

Lane 2002, section 4.3: of any two circles that intersect (touching counts, section 4.5) the smaller is dominated. Of
two equal circles the one with the higher plant_id, the later born, is dominated, so that the answer depends on
neither the order of rows nor on rounding.

Method: circles are ranked by decreasing radius, then increasing id, and sorted into levels that halve the radius; each
level has its own grid whose cells are at least one largest diameter of that level wide. A circle asks the levels of
its own size and above, nine cells each, and stops at the first circle that dominates it; a cell is in order of rank,
so the search in it ends at the circle's own rank. A few large trees among many seedlings therefore cost nothing extra:
time is O(N log N) for the ranking plus O(N L) for the search, L being the number of non-empty levels
(<= 1 + log2(r_max / r_min)), as long as each small neighbourhood holds a bounded number of undominated circles, which
circles of one level that do not intersect always do. Memory is O(N), whatever the size of the site.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

# Bytes that `dominated` holds at its peak for each circle, all arrays counted (tests/unit/community measure it).
BYTES_PER_CIRCLE = 160


def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    try:
        compiled: Callable[..., Any] = numba.njit(cache=True)(function)
    except RuntimeError:  # neither the package nor the home directory can be written to: no place for a cache
        compiled = numba.njit(function)
    return compiled


def _near(at, cell, n, reach, periodic, step):  # type: ignore[no-untyped-def]
    """Index of the cell `step` away along one axis, or -1 where it does not exist or is out of reach.

    `at` and `reach` are in cells. A periodic axis of one or two cells wraps onto cells already searched.
    """
    if step == 0:
        return cell
    if periodic and n < 3:
        return (cell + 1) % n if step == 1 and n == 2 else -1
    if (step == 1 and at + reach < cell + 1) or (step == -1 and at - reach > cell):
        return -1
    other = cell + step
    if periodic:
        return other + n if other < 0 else (0 if other == n else other)
    return -1 if other == n else other


_near_compiled = _compile(_near)


def _blocked(i, x, y, r, periodic, width, height, reach, nx, ny, offset, cell_start, cell_rank):  # type: ignore[no-untyped-def]
    """Whether a circle of smaller rank in one level's grid intersects circle `i`; `reach` bounds both radii."""
    across, along = x[i] * nx / width, y[i] * ny / height
    cx, cy = min(max(int(across), 0), nx - 1), min(max(int(along), 0), ny - 1)
    for b in range(3):  # 0, +1, -1: the circle's own cell, the likeliest, comes first
        gy = _near_compiled(along, cy, ny, reach * ny / height, periodic, (b + 1) % 3 - 1)
        for a in range(3):
            gx = _near_compiled(across, cx, nx, reach * nx / width, periodic, (a + 1) % 3 - 1)
            if gx < 0 or gy < 0:
                continue
            cell = offset + gy * nx + gx
            for k in range(cell_start[cell], cell_start[cell + 1]):
                j = cell_rank[k]
                if j >= i:
                    break
                dx, dy = abs(x[i] - x[j]), abs(y[i] - y[j])
                if periodic:
                    dx, dy = min(dx, width - dx), min(dy, height - dy)
                if dx * dx + dy * dy <= (r[i] + r[j]) ** 2:
                    return True
    return False


_blocked_compiled = _compile(_blocked)


def _search(x, y, r, periodic, width, height, first, nx, ny, offset, cell_start, cell_rank, out):  # type: ignore[no-untyped-def]
    """Set `out` for circles in order of rank; `first`, `nx`, `ny`, `offset` have one entry a level."""
    for i in range(len(x)):
        for level in range(len(nx)):
            if first[level] >= i:
                break
            reach = (r[i] + r[first[level]]) * (1 + 1e-9)
            if _blocked_compiled(
                i, x, y, r, periodic, width, height, reach, nx[level], ny[level], offset[level], cell_start, cell_rank
            ):
                out[i] = True
                break


_search_compiled = _compile(_search)


def _levels(r: NDArray[np.float64]) -> NDArray[np.int64]:
    """First rank of each level, for radii in decreasing order; radii within a level differ by less than 2 or so."""
    exponent = np.frexp(r)[1]
    return np.concatenate([[0], 1 + np.flatnonzero(np.diff(exponent))]).astype(np.int64)


def _grids(
    x: NDArray[np.float64], y: NDArray[np.float64], r: NDArray[np.float64], size_m: tuple[float, float]
) -> tuple[NDArray[np.int64], ...]:
    """first, nx, ny, offset (a level each); cell_start (all cells + 1,), cell_rank (N,): the cells' members."""
    first = _levels(r)
    count = np.diff(np.append(first, len(r)))
    # Cells at least one diameter wide make the nine cells suffice; about one a circle bounds memory.
    # The 1e-9 covers the rounding of x * nx / width.
    side = np.maximum(2 * r[first] * (1 + 1e-9), np.sqrt(size_m[0] * size_m[1] / count))
    nx = np.maximum(1, np.minimum(size_m[0] / side, count)).astype(np.int64)
    ny = np.maximum(1, np.minimum(size_m[1] / side, count)).astype(np.int64)
    offset = np.cumsum(nx * ny) - nx * ny
    level = np.repeat(np.arange(len(first)), count)
    cx = np.clip((x * nx[level] / size_m[0]).astype(np.int64), 0, nx[level] - 1)
    cy = np.clip((y * ny[level] / size_m[1]).astype(np.int64), 0, ny[level] - 1)
    cell = offset[level] + cy * nx[level] + cx
    del level, cx, cy
    members = np.bincount(cell, minlength=int(offset[-1] + nx[-1] * ny[-1]))
    cell_start = np.concatenate([[0], np.cumsum(members)]).astype(np.int64)
    return first, nx, ny, offset, cell_start, np.argsort(cell, kind="stable").astype(np.int64, copy=False)


def dominated(
    position_m: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    plant_id: NDArray[np.uint32],
    size_m: tuple[float, float],
    *,
    periodic: bool,
) -> NDArray[np.bool_]:
    """Which circles intersect a larger one.

    Parameters
    ----------
    position_m : (N, 2) float64, metres, world x and y.
    radius_m : (N,) float64, metres.
    plant_id : (N,) decides between equal radii.
    size_m : width and height of the site.
    periodic : the site is a torus: its left edge continues at its right, its lower at its upper. Otherwise the plane.

    Returns
    -------
    (N,) bool
    """
    out = np.zeros(len(radius_m), dtype=np.bool_)
    if len(radius_m) < 2:
        return out
    rank = np.lexsort((plant_id, -radius_m))
    x, y, r = position_m[rank, 0], position_m[rank, 1], radius_m[rank]
    width, height = size_m
    if periodic:
        x, y = np.mod(x, width), np.mod(y, height)
    first, nx, ny, offset, cell_start, cell_rank = _grids(x, y, r, size_m)
    by_rank = np.zeros(len(r), dtype=np.bool_)
    _search_compiled(x, y, r, periodic, width, height, first, nx, ny, offset, cell_start, cell_rank, by_rank)
    out[rank] = by_rank
    return out
