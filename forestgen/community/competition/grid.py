"""The neighbour grid that competition models share: which circles can meet a circle.

Each circle is entered into every cell that its bounding box meets, so that whoever meets it is found in the cells of
its own box, whatever the two sizes. Cells hold about two centres in the mean, or more where circles are so large that
they would have more than three entries each. Circles themselves are copied into an order of tiles, a few thousand on
the whole site, so that a walk along them reads memory that is still in the cache.

Time and memory are O(N), whatever the size of the site and the mixture of radii.
"""

from __future__ import annotations

from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats
from forestgen.core.compiled import compiled

_TILES = 64  # along each axis: as many places are written to in turn as a cache has room for
_MARGIN = 1e-6  # cells: far above the rounding of x * cells / width, far below what it costs to look further
_CENTRES_PER_CELL = 2.0  # at least, in the mean
_ENTRIES_PER_CIRCLE = 3.0  # at most, in the mean


class Grid(NamedTuple):  # a tuple: compiled loops take no dataclass. They unpack it first, or count references
    """Circles in order of tiles, and the cells whose members they are."""

    circle: Floats  # (N, 4) x, y, r in metres, row in the caller's arrays; a torus has its x, y in [0, W]
    entry: NDArray[np.uint32]  # (E,) index into `circle`, cell after cell
    start: NDArray[np.uint32]  # (ny nx + 1,) first entry of each cell, row after row
    n: tuple[int, int]  # nx, ny
    per_m: tuple[float, float]  # cells per metre along x and y
    size_m: tuple[float, float]
    periodic: bool


@compiled
def _clamped(at, n):  # type: ignore[no-untyped-def]
    """Index of the cell at a coordinate in cells; beyond the edge, the cell at the edge."""
    return floor(min(max(at, 0.0), n - 1.0))


@compiled
def span(at, reach, n, periodic):  # type: ignore[no-untyped-def]
    """First and number of the cells along one axis that the interval at ± reach (in cells) meets, each once.

    Where `periodic`, the cells may begin before 0 or end after n - 1; `wrapped` gives their index.
    """
    reach += _MARGIN
    if not periodic:
        first = _clamped(at - reach, n)
        return first, _clamped(at + reach, n) - first + 1
    if 2 * reach + 2 >= n:
        return 0, n
    first = floor(at - reach)
    return first, floor(at + reach) - first + 1


@compiled
def box(x, y, r, n, per_m, periodic):  # type: ignore[no-untyped-def]
    """Columns and rows of cells that a circle's bounding box meets: first, number, first, number; see `span`."""
    x0, across = span(x * per_m[0], r * per_m[0], n[0], periodic)
    y0, along = span(y * per_m[1], r * per_m[1], n[1], periodic)
    return x0, across, y0, along


@compiled
def wrapped(cell, n):  # type: ignore[no-untyped-def]
    """`cell` of -n ... 2 n - 1 modulo n."""
    return cell + n if cell < 0 else (cell - n if cell >= n else cell)


@compiled
def first_shared(a, b, x0, y0, x, y, r, n, per_m, periodic):  # type: ignore[no-untyped-def]
    """Whether column `a`, row `b` of a box that begins at `x0`, `y0` is the first in it that circle x, y, r also meets.

    Two circles can share several cells; so each pair is counted once.
    """
    other_x, across, other_y, along = box(x, y, r, n, per_m, periodic)
    ahead_x = wrapped(wrapped(other_x, n[0]) - wrapped(x0, n[0]), n[0])
    ahead_y = wrapped(wrapped(other_y, n[1]) - wrapped(y0, n[1]), n[1])
    # The other box begins that many cells ahead, cyclically; or it began before and is still there at the first cell.
    if ahead_x and n[0] - ahead_x < across:
        ahead_x = 0
    if ahead_y and n[1] - ahead_y < along:
        ahead_y = 0
    return a == ahead_x and b == ahead_y


@compiled
def near(x, y, u, v, reach, size_m, periodic):  # type: ignore[no-untyped-def]
    """Whether points x, y and u, v, or images of them, are at most `reach` apart."""
    dx, dy = abs(x - u), abs(y - v)
    if periodic:
        dx, dy = min(dx, size_m[0] - dx), min(dy, size_m[1] - dy)
    return dx * dx + dy * dy <= reach * reach


@compiled
def images(d, reach, length, periodic):  # type: ignore[no-untyped-def]
    """First and last of the whole numbers k with abs(d + k length) < reach; 0 in the plane."""
    if not periodic:
        return 0, 0
    return floor((-reach - d) / length) + 1, ceil((reach - d) / length) - 1


@compiled
def _tile(x, y, periodic, width, height, tiles):  # type: ignore[no-untyped-def]
    """x and y within a torus, and the tile."""
    if periodic:
        x, y = x % width, y % height
    return x, y, _clamped(y / height * tiles, tiles) * tiles + _clamped(x / width * tiles, tiles)


@compiled
def _gather(position, radius, periodic, width, height, tiles, start, circle):  # type: ignore[no-untyped-def]
    """Copy circles in order of tiles, within a tile in that of rows; `start` (tiles^2 + 1,) is zeros, and scratch."""
    for i in range(len(radius)):
        start[_tile(position[i, 0], position[i, 1], periodic, width, height, tiles)[2] + 1] += 1
    for tile in range(1, len(start)):
        start[tile] += start[tile - 1]
    for i in range(len(radius)):
        x, y, tile = _tile(position[i, 0], position[i, 1], periodic, width, height, tiles)
        k = start[tile]
        start[tile] += 1
        circle[k, 0], circle[k, 1], circle[k, 2], circle[k, 3] = x, y, radius[i], i


@compiled
def _enter(circle, periodic, n, per_m, start, entry):  # type: ignore[no-untyped-def]
    """Without room in `entry`: turn `start` (cells + 2,), zeros, into each cell's first entry, one place late.

    With room: fill `entry`, in each cell in the order of `circle`; afterwards `start` is right.
    """
    counting = len(entry) == 0
    for i in range(len(circle)):
        x0, across, y0, along = box(circle[i, 0], circle[i, 1], circle[i, 2], n, per_m, periodic)
        for b in range(along):
            line = wrapped(y0 + b, n[1]) * n[0]
            for a in range(across):
                c = line + wrapped(x0 + a, n[0]) + 1
                if counting:
                    start[c + 1] += 1
                else:
                    entry[start[c]] = i
                    start[c] += 1
    if counting:
        for c in range(2, len(start)):
            start[c] += start[c - 1]


def _cells(radius_m: Floats, size_m: tuple[float, float]) -> tuple[int, int]:
    """Number of cells along x and y."""
    count = len(radius_m)
    mean, square = radius_m.mean(), np.square(radius_m).mean()
    # (1 + 2 r / side)^2 entries a circle in the mean are to be at most _ENTRIES_PER_CIRCLE.
    spare = _ENTRIES_PER_CIRCLE - 1
    widest = 2 * (mean + np.sqrt(mean**2 + spare * square)) / spare
    side = max(widest, np.sqrt(_CENTRES_PER_CELL * size_m[0] / count * size_m[1]))
    return (max(1, int(min(size_m[0] / side, count))), max(1, int(min(size_m[1] / side, count))))


def build(position_m: Floats, radius_m: Floats, size_m: tuple[float, float], *, periodic: bool) -> Grid:
    """The grid of at least one circle, (N, 2) positions and (N,) radii in metres; `periodic`: the site is a torus."""
    position_m = np.ascontiguousarray(position_m, dtype=np.float64)
    radius_m = np.ascontiguousarray(radius_m, dtype=np.float64)
    n = _cells(radius_m, size_m)
    per_m = (n[0] / size_m[0], n[1] / size_m[1])
    circle = np.empty((len(radius_m), 4))
    _gather(position_m, radius_m, periodic, *size_m, _TILES, np.zeros(_TILES**2 + 1, dtype=np.int64), circle)
    start = np.zeros(n[0] * n[1] + 2, dtype=np.uint32)
    _enter(circle, periodic, n, per_m, start, np.empty(0, dtype=np.uint32))
    entry = np.empty(start[-1], dtype=np.uint32)
    _enter(circle, periodic, n, per_m, start, entry)
    return Grid(circle, entry, start[:-1], n, per_m, size_m, periodic)
