"""Crowding: how much the bounding spheres of branch modules intersect.

Reference: M. Makowski et al., Synthetic Silviculture, 2019, in the form of the book of 2023, Eq. 1. ::

    f(u) = sum over w of V(B_u and B_w) / V(B_u)                 own light Q = exp(-f)

Decided where the print is silent: the sum is divided by the module's own volume, since the exponent must be a pure
number. Pairs that share a joint (a module and the one that bears it) touch by construction and are left out. Boxes
(obstacles) count like spheres, with the volume that lies in them. Spheres below 1 mm count as spheres of 1 mm: a module
that has just begun feels how many others it stands in.

Method: spheres are sorted by radius into levels, each within a factor of 3; a level is a grid of columns, each with its
own layers of cells from its lowest to its highest sphere, so that grids follow terrain of any height. Cells are about
1.4 radii of the level's largest sphere wide, or hold about one sphere in the mean where spheres are rare. A sphere
looks through the cells of each level within its own radius and the level's largest. So seedlings among trees cost no
more than seedlings, and time and memory are O(M). Each sphere adds up its own neighbours in the order of the grid:
the sums do not depend on the number of threads.

On a torus a sphere meets the nearest image of another; spheres should be smaller than a quarter of the site.

A sphere's volume within a box is the integral of disc and rectangle's common area (exact) over height, by Gauss and
Legendre's rule with 12 points on each of the parts between the heights at which the disc begins or ceases to reach a
side or corner. Its error is below 1e-5 of the sphere's volume (measured in the tests).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import asin, cos, floor, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled, unowned_view
from forestgen.core.threads import parallel_for

Floats = NDArray[np.float64]
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class Boxes:
    """Upright boxes, one row each."""

    base_m: Floats  # (B, 3) centre of the lower face, metres, world frame
    size_m: Floats  # (B, 3) width, depth, height; width along world x where the azimuth is 0
    azimuth_rad: Floats  # (B,) anticlockwise, seen from above

    def __len__(self) -> int:
        return len(self.azimuth_rad)

    @property
    def rows(self) -> Floats:
        """(B, 8) for kernels: centre x, y, z; half the width, depth, height, metres; cosine and sine of the azimuth."""
        centre = self.base_m + np.array([0.0, 0.0, 0.5]) * self.size_m[:, 2:]
        turn = np.stack([np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)], axis=1)
        return np.ascontiguousarray(np.hstack([centre, 0.5 * self.size_m, turn]), dtype=np.float64)

    def cover(self, position_m: Floats, period_m: tuple[float, float] | None = None) -> NDArray[np.bool_]:
        """(N,) whether points of (N, 2) world x and y lie on a box's ground."""
        inside = np.zeros(len(position_m), dtype=np.bool_)
        for row in self.rows:
            offset = position_m[:, :2] - row[:2]
            if period_m is not None:
                offset -= np.round(offset / period_m) * period_m
            along = offset[:, 0] * row[6] + offset[:, 1] * row[7]
            across = offset[:, 1] * row[6] - offset[:, 0] * row[7]
            inside |= (np.abs(along) <= row[3]) & (np.abs(across) <= row[4])
        return inside


NO_BOXES = Boxes(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@compiled
def _half_disc(t, rho):  # type: ignore[no-untyped-def]
    """Integral of sqrt(rho^2 - s^2) over s from 0 to t."""
    return 0.5 * (t * sqrt(max(rho * rho - t * t, 0.0)) + rho * rho * asin(min(max(t / rho, -1.0), 1.0)))


@compiled
def _corner(x, y, rho):  # type: ignore[no-untyped-def]
    """Area of the part of a disc about the origin with coordinates below x and y."""
    x, y = min(max(x, -rho), rho), min(max(y, -rho), rho)
    a = sqrt(max(rho * rho - y * y, 0.0))
    m = min(max(x, -a), a)
    cap = _half_disc(m, rho) + _half_disc(a, rho)
    if y >= 0.0:
        return 2.0 * _half_disc(x, rho) + 0.5 * pi * rho * rho - (cap - y * (m + a))
    return cap + y * (m + a)


@compiled
def _disc_and_rectangle(x, y, half_x, half_y, rho):  # type: ignore[no-untyped-def]
    """Common area of a disc of radius rho at x, y and the rectangle |x| <= half_x, |y| <= half_y."""
    if rho <= 0.0:
        return 0.0
    return (
        _corner(half_x - x, half_y - y, rho)
        - _corner(-half_x - x, half_y - y, rho)
        - _corner(half_x - x, -half_y - y, rho)
        + _corner(-half_x - x, -half_y - y, rho)
    )


@compiled
def _kinks(x, y, half_x, half_y, r, low, high, cut):  # type: ignore[no-untyped-def]
    """Put into `cut` the heights from `low` to `high` at which the disc begins to reach a side or corner, in order."""
    cut[0], cut[1], count = low, high, 2
    for k in range(8):  # four corners, then four sides
        px = half_x - x if k % 2 else -half_x - x
        py = half_y - y if (k // 2) % 2 else -half_y - y
        d2 = px * px + py * py
        if k >= 4:
            d2 = px * px if k < 6 else (half_y + (y if k % 2 else -y)) ** 2
        if d2 < r * r:
            z = sqrt(r * r - d2)
            for at in (-z, z):
                if low < at < high:
                    place = count
                    while cut[place - 1] > at:
                        cut[place] = cut[place - 1]
                        place -= 1
                    cut[place] = at
                    count += 1
    return count


@compiled
def _in_upright(x, y, z, r, half_x, half_y, half_z):  # type: ignore[no-untyped-def]
    """Volume of a sphere at x, y, z within the box about the origin."""
    low, high = max(-half_z - z, -r), min(half_z - z, r)
    if low >= high or abs(x) >= half_x + r or abs(y) >= half_y + r:
        return 0.0
    cut = np.empty(20)
    count = _kinks(x, y, half_x, half_y, r, low, high, cut)
    volume = 0.0
    for part in range(count - 1):
        middle, half = 0.5 * (cut[part] + cut[part + 1]), 0.5 * (cut[part + 1] - cut[part])
        for k in range(len(_NODE)):
            # The square roots at both ends of a part become smooth: height = middle + half * sin.
            angle = 0.5 * pi * _NODE[k]
            height = middle + half * sin(angle)
            area = _disc_and_rectangle(x, y, half_x, half_y, sqrt(max(r * r - height * height, 0.0)))
            volume += _WEIGHT[k] * 0.5 * pi * cos(angle) * half * area
    return volume


@compiled
def volume_in_boxes(x, y, z, r, boxes, width, height):  # type: ignore[no-untyped-def]
    """Volume of a sphere within boxes, rows of `Boxes.rows`; a torus of `width` and `height` where width > 0."""
    volume = 0.0
    for b in range(len(boxes)):
        dx, dy, dz = x - boxes[b, 0], y - boxes[b, 1], z - boxes[b, 2]
        if width > 0.0:
            dx -= width * round(dx / width)
            dy -= height * round(dy / height)
        if abs(dz) >= r + boxes[b, 5] or dx * dx + dy * dy >= (boxes[b, 3] + boxes[b, 4] + r) ** 2:
            continue
        along, across = dx * boxes[b, 6] + dy * boxes[b, 7], dy * boxes[b, 6] - dx * boxes[b, 7]
        volume += _in_upright(along, across, dz, r, boxes[b, 3], boxes[b, 4], boxes[b, 5])
    return volume


LEAST_RADIUS_M = 1e-3
_LEVELS = 6
_RATIO = 3.0  # of the largest radii of two levels
_CELL_PER_RADIUS = 1.4  # width of a cell over the level's largest radius
_SPHERES_PER_CELL = 1.0  # at least, in the mean; columns too


class Cells(NamedTuple):  # a tuple: compiled loops take no dataclass
    """Spheres in the order of levels, in each of columns, in each of layers."""

    sphere: Floats  # (M, 4) x, y, z, r, metres; on a torus x and y in [0, W]
    row: NDArray[np.int32]  # (M,) in the caller's arrays
    start: NDArray[np.int32]  # (cells + 1,) first sphere of each cell
    first: NDArray[np.int32]  # (columns + 1,) first cell of each column
    bottom: Floats  # (columns,) z at which its first layer begins
    level: Floats  # (levels, 9) first column, nx, ny, columns per metre in x and y, x0, y0, layers per metre, most r
    width: float  # of the torus; 0: the plane
    height: float


@compiled
def lens(d2, r, s):  # type: ignore[no-untyped-def]
    """Common volume of two spheres of radii r and s, the square of the distance of whose centres is d2."""
    if d2 >= (r + s) * (r + s):
        return 0.0
    if d2 <= (r - s) * (r - s):
        least = min(r, s)
        return 4.0 / 3.0 * pi * least * least * least
    d = sqrt(d2)
    gap = r + s - d
    return pi * gap * gap * (d2 + 2.0 * d * (r + s) - 3.0 * (r - s) * (r - s)) / (12.0 * d)


@compiled
def columns_within(at, reach, first, per_m, n, periodic):  # type: ignore[no-untyped-def]
    """First and number of the columns, along one axis, that the interval at ± reach meets; not yet wrapped."""
    low, high = floor((at - reach - first) * per_m), floor((at + reach - first) * per_m)
    if periodic:
        return (low, high - low + 1) if high - low + 1 < n else (0, n)
    low, high = max(low, 0), min(high, n - 1)
    return low, high - low + 1


@compiled
def nearest_image(d, period):  # type: ignore[no-untyped-def]
    """The difference of two coordinates, each from 0 to the period, on a torus; as it is where the period is 0."""
    if period > 0.0:
        half = 0.5 * period
        if d > half:
            return d - period
        if d < -half:
            return d + period
    return d


@compiled
def _outside(at, low, width):  # type: ignore[no-untyped-def]
    """Distance along one axis of `at` from the column that begins at `low`."""
    return max(low - at, at - low - width, 0.0)


@compiled
def runs(x, y, z, radius, cells, out):  # type: ignore[no-untyped-def]
    """Fill `out` (R, 2) with runs of spheres, first and end, that can meet a sphere; their number, or -1: no room.

    On a torus x and y are from 0 to its sides.
    """
    count, most, periodic = 0, len(out), cells.width > 0.0
    for k in range(len(cells.level)):
        column0, nx, ny = int(cells.level[k, 0]), int(cells.level[k, 1]), int(cells.level[k, 2])
        per_x, per_y, x0, y0 = cells.level[k, 3], cells.level[k, 4], cells.level[k, 5], cells.level[k, 6]
        per_z, reach = cells.level[k, 7], radius + cells.level[k, 8]
        wide, deep = 1.0 / per_x, 1.0 / per_y
        low_y, along = columns_within(y, reach, y0, per_y, ny, periodic)
        low_x, across = columns_within(x, reach, x0, per_x, nx, periodic)
        round_y, round_x = periodic and along == ny, periodic and across == nx
        for row in range(low_y, low_y + along):
            dy = 0.0 if round_y else _outside(y, y0 + row * deep, deep)
            room_y = reach * reach - dy * dy
            line = column0 + (row + ny if row < 0 else (row - ny if row >= ny else row)) * nx
            for column in range(low_x, low_x + across):
                c = line + (column + nx if column < 0 else (column - nx if column >= nx else column))
                cell, end = cells.first[c], cells.first[c + 1]
                dx = 0.0 if round_x else _outside(x, x0 + column * wide, wide)
                room = room_y - dx * dx
                if room <= 0.0 or cell == end:
                    continue
                up, at = sqrt(room), z - cells.bottom[c]
                low = max(floor((at - up) * per_z), 0)
                high = min(floor((at + up) * per_z), end - cell - 1)
                if low > high:
                    continue
                begin, stop = cells.start[cell + low], cells.start[cell + high + 1]
                if begin < stop:
                    if count == most:
                        return -1
                    out[count, 0], out[count, 1] = begin, stop
                    count += 1
    return count


@compiled
def _sum_overlaps(first, end, cells, parent, boxes, total):  # type: ignore[no-untyped-def]
    """Set `total` of the spheres `first` to `end` of the grid to the sum of their common volumes with others, m3."""
    cells, parent, total, boxes = unowned_view(cells), unowned_view(parent), unowned_view(total), unowned_view(boxes)
    sphere, rows, width, height = cells.sphere, cells.row, cells.width, cells.height
    room = np.empty((256, 2), dtype=np.int64)
    run = unowned_view(room)
    for i in range(first, end):
        x, y, z, r, own = sphere[i, 0], sphere[i, 1], sphere[i, 2], sphere[i, 3], rows[i]
        bearer = parent[own]
        count = runs(x, y, z, r, cells, run)
        while count < 0:
            room = np.empty((2 * len(room), 2), dtype=np.int64)
            run = unowned_view(room)
            count = runs(x, y, z, r, cells, run)
        volume = 0.0
        for k in range(count):
            for j in range(run[k, 0], run[k, 1]):
                dz, reach = z - sphere[j, 2], r + sphere[j, 3]
                dx, dy = nearest_image(x - sphere[j, 0], width), nearest_image(y - sphere[j, 1], height)
                d2 = dx * dx + dy * dy + dz * dz
                if d2 < reach * reach and j != i:
                    other = rows[j]
                    if other != bearer and parent[other] != own:
                        volume += lens(d2, r, sphere[j, 3])
        if len(boxes) > 0:
            volume += volume_in_boxes(x, y, z, r, boxes, width, height)
        total[own] = volume


def _levels(radius: Floats) -> NDArray[np.int8]:
    """Level of each sphere by its radius: 0 are the largest."""
    level, least = np.zeros(len(radius), dtype=np.int8), radius.max(initial=LEAST_RADIUS_M)
    for _ in range(_LEVELS - 1):
        least /= _RATIO
        level += radius <= least
    return level


def _shape(
    position_m: Floats, radius_m: Floats, rows: NDArray[np.int64], period_m: tuple[float, float] | None
) -> tuple[float, ...]:
    """A level's row of `Cells.level` without its first column and its layers."""
    most = float(radius_m[rows].max())
    if period_m is None:
        low, high = position_m[rows, :2].min(axis=0), position_m[rows, :2].max(axis=0)
        sides = np.maximum(high - low, 1e-6)
    else:
        low, sides = np.zeros(2), np.array(period_m)
    side = max(_CELL_PER_RADIUS * most, float(np.sqrt(_SPHERES_PER_CELL * sides[0] / len(rows) * sides[1])))
    n = np.clip(np.floor(sides / side), 1, 2 * len(rows) + 1)
    per_m = n / sides
    return float(n[0]), float(n[1]), float(per_m[0]), float(per_m[1]), float(low[0]), float(low[1]), most


def cells_of(position_m: Floats, radius_m: Floats, period_m: tuple[float, float] | None) -> Cells:
    """The cells of (M, 3) float64 centres and (M,) float64 radii, metres; see `SphereGrid`."""
    level = _levels(radius_m)
    order, counts = np.argsort(level, kind="stable"), np.bincount(level)
    edges = np.concatenate([[0], np.cumsum(counts[counts > 0])])
    sphere = np.column_stack([position_m, radius_m])[order]
    if period_m is not None:
        sphere[:, :2] %= period_m
    x, y, z = sphere[:, :3].T
    levels, columns, column = np.zeros((len(edges) - 1, 9)), 0, np.empty(len(sphere), dtype=np.int64)
    for k, (begin, end) in enumerate(pairwise(edges.tolist())):
        nx, ny, per_x, per_y, x0, y0, most = _shape(position_m, radius_m, order[begin:end], period_m)
        levels[k] = columns, nx, ny, per_x, per_y, x0, y0, 0.0, most
        along_x = np.clip(np.floor((x[begin:end] - x0) * per_x), 0, nx - 1)
        along_y = np.clip(np.floor((y[begin:end] - y0) * per_y), 0, ny - 1)
        column[begin:end] = columns + along_y * nx + along_x
        columns += int(nx * ny)
    low, high = np.full(columns, np.inf), np.full(columns, -np.inf)
    np.minimum.at(low, column, z)
    np.maximum.at(high, column, z)
    layers, per_z = np.zeros(columns, dtype=np.int64), np.empty(len(sphere))
    for k, (begin, end) in enumerate(pairwise(edges.tolist())):
        own = slice(int(levels[k, 0]), int(levels[k, 0] + levels[k, 1] * levels[k, 2]))
        tall = np.where(high[own] >= low[own], high[own] - low[own], -1.0)
        thick = max(_CELL_PER_RADIUS * levels[k, 8], _SPHERES_PER_CELL * tall.clip(0).sum() / (end - begin))
        levels[k, 7] = per_z[begin:end] = 1.0 / thick
        layers[own] = np.where(tall >= 0.0, np.floor(tall * levels[k, 7]) + 1, 0)
    first = np.concatenate([[0], np.cumsum(layers)])
    cell = first[column] + np.clip(np.floor((z - low[column]) * per_z), 0, layers[column] - 1).astype(np.int64)
    into, start = np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell, minlength=first[-1]))
    starts = np.concatenate([[0], start]).astype(np.int32)
    width, height = period_m or (0.0, 0.0)
    rows = order[into].astype(np.int32)
    return Cells(sphere[into], rows, starts, first.astype(np.int32), low, levels, float(width), float(height))


def without(cells: Cells, leave_out: NDArray[np.bool_]) -> Cells:
    """The same cells without the spheres of some of the caller's rows, (M,)."""
    keep = ~leave_out[cells.row]
    start = np.concatenate([[0], np.cumsum(keep)])[cells.start].astype(np.int32)
    return cells._replace(sphere=cells.sphere[keep], row=cells.row[keep], start=start)


@dataclass(frozen=True)
class SphereGrid:
    """The bounding spheres of all modules, sorted into cells."""

    cells: Cells
    radius_m: Floats  # (M,) at least LEAST_RADIUS_M
    period_m: tuple[float, float] | None  # width and height of a torus; None: the plane

    @classmethod
    def of(
        cls, centre_world_m: NDArray[Any], radius_m: NDArray[Any], period_m: tuple[float, float] | None = None
    ) -> SphereGrid:
        """The grid of spheres: centres (M, 3), metres, world frame, and radii (M,), metres, at least 0; all finite."""
        centre = np.ascontiguousarray(centre_world_m, dtype=np.float64)
        radius = np.maximum(np.ascontiguousarray(radius_m, dtype=np.float64), LEAST_RADIUS_M)
        return cls(cells_of(centre, radius, period_m), radius, period_m)

    def __len__(self) -> int:
        return len(self.radius_m)

    @property
    def volume_m3(self) -> Floats:
        """(M,) volume of each sphere."""
        return 4.0 / 3.0 * np.pi * self.radius_m**3


def overlap_volumes(grid: SphereGrid, parent_row: NDArray[np.integer], boxes: Boxes = NO_BOXES) -> Floats:
    """(M,) m3: sum of each sphere's common volumes with all others and boxes; over its own volume it is f(u) of Eq. 1.

    `parent_row` (M,) is the row of the module that bears each, -1 for roots: pairs that share a joint do not count.
    """
    total = np.empty(len(grid))
    parent = np.ascontiguousarray(parent_row, dtype=np.int64)
    if len(grid):
        cells, rows = grid.cells, boxes.rows
        parallel_for(len(grid), lambda first, end: _sum_overlaps(first, end, cells, parent, rows, total))
    return total
