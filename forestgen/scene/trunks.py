"""Stems in a camera's way: how far a point is from their surfaces, and a walker's way around them on the map.

A stem is what an exemplar has as trunk; of a dead tree, whose trunk and branches are one part, all of its dead wood.

1. Obstacles are circles that hold the stems, widened by the clearance. Each piece of the way is searched on a grid of a
   corridor along it (Dijkstra's shortest path, steps to 16 neighbours). A point of the recipe's that is not free is
   replaced by the nearest free cell.
2. The way on the grid is pulled tight: a piece of it is replaced by a straight line where that is free.
3. The corners are rounded by a running mean, and what comes too near a trunk is pushed away from its middle.

Where there is no way with the clearance asked for, it is halved, down to `LEAST_CLEARANCE_M`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.spec import Instances

Floats = NDArray[np.float64]

LEAST_CLEARANCE_M = 0.1
_CELL_M = 0.2
_MOST_CELLS = 300_000  # of a corridor
_CORRIDOR_M = (4.0, 15.0)  # on both sides of the straight line, tried one after another
_ROUNDED_M = 0.6  # length of the running mean
_STEP_M = 0.05  # of the way while it is rounded
_PUSHES = 8
_NEAREST = 12  # circles that a point is held against, by their middles
_MOVES = [(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)]


class Trunks:
    """The stems of a scene's plants, in still air."""

    def __init__(self, exemplars: Sequence[Exemplar], instances: Instances) -> None:
        self._corners = [_corners(one) for one in exemplars]
        self._roots_m = [one.roots_m for one in exemplars]
        self._lies = [one.lying_m3 > 0.0 for one in exemplars]
        self._mine = instances.exemplar.astype(np.intp)
        self._transform = instances.transform
        self._plant_id = instances.plant_id
        low = np.full((len(exemplars), 3), np.inf)
        high = np.full((len(exemplars), 3), -np.inf)
        for index, corners in enumerate(self._corners):
            if len(corners):
                low[index], high[index] = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self._low, self._high = low, high
        self._scale, self._upright = (np.linalg.norm(self._transform[:, :, k], axis=1) for k in (0, 2))

    def clearance_m(self, position_m: Floats, reach_m: float) -> tuple[float, int]:
        """Distance from a point to the nearest stem's surface, negative inside, and its plant; at most `reach_m`, 0."""
        nearest, plant = reach_m, 0
        # In the exemplar's frame, which is turned and scaled; stems are nearest sideways.
        inverse = np.linalg.inv(self._transform[:, :, :3])
        local = np.einsum("nij,nj->ni", inverse, position_m - self._transform[:, :, 3])
        margin = (reach_m / np.minimum(self._scale, self._upright))[:, None]
        near = np.all((local > self._low[self._mine] - margin) & (local < self._high[self._mine] + margin), axis=1)
        for row in np.flatnonzero(near).tolist():
            corners = self._corners[self._mine[row]]
            apart = _distance_m(corners, local[row]) * float(self._scale[row])
            if _turns(corners, local[row]) > 0.5:
                apart = -apart
            if apart < nearest:
                nearest, plant = apart, int(self._plant_id[row])
        return nearest, plant

    def circles_m(self, height_m: float) -> tuple[Floats, Floats]:
        """(T, 2) middles and (T,) radii of circles that hold standing stems, from the feet up to a height.

        Walkers step over roots.
        """
        middles, radii = [], []
        for index, corners in enumerate(self._corners):
            rows = np.flatnonzero(self._mine == index)
            if not len(rows) or not len(corners) or self._lies[index]:  # walkers step over lying stems
                continue
            top = height_m / float(self._upright[rows].min())  # as far up as the smallest of its plants needs
            points = _clipped(corners, self._roots_m[index], max(top, 2.0 * self._roots_m[index]))
            if not len(points):
                continue
            box = points.min(axis=0), points.max(axis=0)
            middle = (box[0] + box[1]) / 2
            radius = float(np.hypot(*(points - middle)[:, :2].T).max())
            there = np.einsum("nij,j->ni", self._transform[rows, :, :3], middle) + self._transform[rows, :, 3]
            middles.append(there[:, :2])
            radii.append(radius * self._scale[rows])
        if not middles:
            return np.zeros((0, 2)), np.zeros(0)
        return np.concatenate(middles), np.concatenate(radii)


def _corners(exemplar: Exemplar) -> Floats:
    """(F, 3, 3) triangles of the stem."""
    for part in (Part.TRUNK, Part.DEAD_WOOD):
        meshes = [organ.mesh for organ in exemplar.organs if organ.part == part and len(organ.mesh.faces)]
        if meshes:
            return np.concatenate([mesh.vertices_m[mesh.faces] for mesh in meshes]).astype(np.float64)
    return np.zeros((0, 3, 3))


def _clipped(corners: Floats, low_m: float, high_m: float) -> Floats:
    """(P, 3) ends of the parts of triangles' edges between two heights."""
    start = corners.reshape(-1, 3)
    way = np.roll(corners, -1, axis=1).reshape(-1, 3) - start
    rise = way[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.stack([(low_m - start[:, 2]) / rise, (high_m - start[:, 2]) / rise])
    level = (start[:, 2] >= low_m) & (start[:, 2] <= high_m)
    first = np.where(rise == 0, 0.0, np.maximum(crossings.min(axis=0), 0.0))
    last = np.where(rise == 0, 1.0, np.minimum(crossings.max(axis=0), 1.0))
    kept = np.where(rise == 0, level, first <= last)
    ends = np.concatenate([first[kept], last[kept]])
    return np.asarray(np.tile(start[kept], (2, 1)) + ends[:, None] * np.tile(way[kept], (2, 1)))


def _distance_m(corners: Floats, point: Floats) -> float:
    """From a point to the nearest of (F, 3, 3) triangles: to a plane where the foot lies inside, else to an edge."""
    a = corners[:, 0] - point
    sides = np.roll(corners, -1, axis=1) - corners
    along = np.einsum("fkc,fkc->fk", point - corners, sides) / np.maximum(np.einsum("fkc,fkc->fk", sides, sides), 1e-30)
    feet = corners + np.clip(along, 0.0, 1.0)[..., None] * sides
    edge = np.linalg.norm(feet - point, axis=2).min()
    normal = np.cross(sides[:, 0], -sides[:, 2])
    outward = np.cross(normal[:, None], sides)  # in the plane, to the left of each side: inward
    inside = np.all(np.einsum("fkc,fkc->fk", point - corners, outward) >= 0, axis=1)
    length = np.linalg.norm(normal, axis=1)
    good = inside & (length > 0)
    if not good.any():
        return float(edge)
    return float(min(edge, np.abs(np.einsum("fc,fc->f", a, normal)[good] / length[good]).min()))


def _turns(corners: Floats, point: Floats) -> float:
    """How often closed surfaces wind around a point: 0 outside, 1 inside; an open end takes off what it shows.

    References
    ----------
    van Oosterom, A., Strackee, J. (1983). The solid angle of a plane triangle. IEEE Transactions on Biomedical
    Engineering 30(2), 125-126, equation 8.
    """
    a, b, c = (corners[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("fc,fc->f", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("fc,fc->f", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(float(angle.sum())) / (4 * np.pi)


class BlockedError(ValueError):
    """There is no way from one point to the next."""

    def __init__(self, piece: int) -> None:
        super().__init__(f"no way between waypoints {piece} and {piece + 1}")
        self.piece = piece


def way_around(waypoints_m: Floats, middles_m: Floats, radii_m: Floats, clearance_m: float) -> Floats:
    """(P, 2) polyline from the first to the last of (K, 2) waypoints that leaves (T,) circles a clearance.

    Raises `BlockedError`: trunks stand too close together.
    """
    clearance = max(clearance_m, LEAST_CLEARANCE_M)
    while True:
        try:
            return _way(waypoints_m, middles_m, radii_m + clearance)
        except BlockedError:
            if clearance <= LEAST_CLEARANCE_M:
                raise
            clearance = max(clearance / 2, LEAST_CLEARANCE_M)


def _way(waypoints_m: Floats, middles_m: Floats, keep_m: Floats) -> Floats:
    low, high = waypoints_m.min(axis=0) - _CORRIDOR_M[-1], waypoints_m.max(axis=0) + _CORRIDOR_M[-1]
    near = ((middles_m + keep_m[:, None] > low) & (middles_m - keep_m[:, None] < high)).all(axis=1)
    middles_m, keep_m = middles_m[near], keep_m[near]
    stops = [_freed(point, middles_m, keep_m, index) for index, point in enumerate(waypoints_m)]
    way = [stops[0]]
    for piece, (start, end) in enumerate(pairwise(stops)):
        way += list(_piece(start, end, middles_m, keep_m, piece))[1:]
    rounded = _rounded(np.array(way), middles_m, keep_m)
    apart = _depth(rounded, middles_m, keep_m)
    if len(apart) and float(apart.max()) > 0.02:  # squeezed between two trunks
        return np.array(way)
    return rounded


def _depth(points_m: Floats, middles_m: Floats, keep_m: Floats) -> Floats:
    """(P,) how far points lie inside the deepest of the nearest circles, metres; negative outside of all."""
    from scipy.spatial import cKDTree

    if not len(keep_m):
        return np.full(len(points_m), -np.inf)
    away, which = cKDTree(middles_m).query(points_m, k=_NEAREST, distance_upper_bound=float(keep_m.max()) + 1e-6)
    return np.asarray((np.append(keep_m, 0.0)[which] - away).max(axis=1))


def _freed(point_m: Floats, middles_m: Floats, keep_m: Floats, index: int) -> Floats:
    """The point, or the nearest that no circle holds: on rings around it, from the north clockwise."""
    if _depth(point_m[None], middles_m, keep_m)[0] <= 0:
        return point_m
    angle = np.arange(64) / 64 * 2 * np.pi
    ring = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    for reach in np.arange(1, 200) * _CELL_M:
        there = point_m + reach * ring
        free = np.flatnonzero(_depth(there, middles_m, keep_m) <= 0)
        if len(free):
            return np.asarray(there[free[0]])
    raise BlockedError(max(index - 1, 0))


def _free_line(start: Floats, end: Floats, middles_m: Floats, keep_m: Floats) -> bool:
    """Whether a straight line stays out of all circles."""
    way = end - start
    share = np.clip(((middles_m - start) @ way) / max(float(way @ way), 1e-12), 0.0, 1.0)
    away = np.hypot(*(start + share[:, None] * way - middles_m).T)
    return bool(np.all(away >= keep_m - 1e-6))


def _piece(start: Floats, end: Floats, middles_m: Floats, keep_m: Floats, number: int) -> Floats:
    if _free_line(start, end, middles_m, keep_m):
        return np.array([start, end])
    for wide_m in _CORRIDOR_M:
        found = _searched(start, end, middles_m, keep_m, wide_m)
        if found is not None:
            return _tight(found, middles_m, keep_m)
    raise BlockedError(number)


def _searched(start: Floats, end: Floats, middles_m: Floats, keep_m: Floats, wide_m: float) -> Floats | None:
    """The shortest way on a grid along the straight line; None if there is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    across = np.array([-along[1], along[0]])
    cell = max(_CELL_M, float(np.sqrt((length + 2 * wide_m) * 2 * wide_m / _MOST_CELLS)))
    beside = int(np.ceil(wide_m / cell))  # cells on both sides, and beyond both ends
    columns, rows = 2 * beside + int(np.ceil(length / cell)) + 1, 2 * beside + 1
    stretch = length / int(np.ceil(length / cell))  # so that the end is on the grid
    x, y = np.meshgrid((np.arange(columns) - beside) * stretch, (np.arange(rows) - beside) * cell)
    points = start + x.reshape(-1, 1) * along + y.reshape(-1, 1) * across
    free = (_depth(points, middles_m, keep_m) <= 0).reshape(rows, columns)
    first, last = beside * columns + beside, beside * columns + columns - 1 - beside
    free.flat[[first, last]] = True
    number = np.arange(rows * columns).reshape(rows, columns)
    froms, tos, costs = [], [], []
    for dx, dy in _MOVES:
        a = (slice(max(-dy, 0), rows - max(dy, 0)), slice(0, columns - dx))
        b = (slice(max(dy, 0), rows - max(-dy, 0)), slice(dx, columns))
        both = free[a] & free[b]
        froms.append(number[a][both])
        tos.append(number[b][both])
        costs.append(np.full(int(both.sum()), np.hypot(dx * stretch, dy * cell)))
    size = rows * columns
    graph = coo_array((np.concatenate(costs), (np.concatenate(froms), np.concatenate(tos))), shape=(size, size)).tocsr()
    _, back = dijkstra(graph, directed=False, indices=np.array(first), return_predecessors=True)
    if back[last] < 0:
        return None
    way = [last]
    while way[-1] != first:
        way.append(int(back[way[-1]]))
    return np.concatenate([start[None], points[way[::-1]][1:-1], end[None]])


def _tight(way: Floats, middles_m: Floats, keep_m: Floats) -> Floats:
    """The way with every stretch straight that may be."""
    kept, here = [way[0]], 0
    while here < len(way) - 1:
        low, high = here + 1, len(way) - 1
        while low < high:  # the farthest point in sight; sight is not quite monotone, and a nearer one will do
            middle = (low + high + 1) // 2
            if _free_line(way[here], way[middle], middles_m, keep_m):
                low = middle
            else:
                high = middle - 1
        kept.append(way[low])
        here = low
    return np.array(kept)


def _rounded(way: Floats, middles_m: Floats, keep_m: Floats) -> Floats:
    """The way in small steps, its corners rounded, pushed out of the circles."""
    from scipy.ndimage import uniform_filter1d

    fine = at_lengths(way, np.linspace(0.0, length_m(way), max(2, int(np.ceil(length_m(way) / _STEP_M)))))
    wide = int(_ROUNDED_M / _STEP_M) | 1
    ends = fine[[0, -1]]
    padded = np.concatenate([2 * ends[:1] - fine[wide:0:-1], fine, 2 * ends[1:] - fine[-2 : -wide - 2 : -1]])
    if len(fine) > wide + 1:
        for _ in range(2):
            padded = uniform_filter1d(padded, wide, axis=0, mode="nearest")
        fine = padded[wide:-wide]
    fine[[0, -1]] = ends
    for _ in range(_PUSHES if len(keep_m) else 0):
        inside = np.flatnonzero(_depth(fine, middles_m, keep_m) > 1e-9)
        if not len(inside):
            break
        for index in inside.tolist():
            away = fine[index] - middles_m
            distance = np.hypot(away[:, 0], away[:, 1])
            deepest = int(np.argmax(keep_m - distance))
            outward = away[deepest] / max(float(distance[deepest]), 1e-9)
            fine[index] = middles_m[deepest] + outward * keep_m[deepest]
    return fine


def length_m(way: Floats) -> float:
    """Of a polyline."""
    return float(np.hypot(*np.diff(way, axis=0).T).sum())


def at_lengths(way: Floats, length: Floats) -> Floats:
    """(N, 2) points of a polyline at lengths from its start; beyond its ends it goes on straight."""
    pieces = np.hypot(*np.diff(way, axis=0).T)
    kept = np.concatenate([[True], pieces > 1e-9])
    way = way[kept]
    reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    points = np.stack([np.interp(length, reached, way[:, axis]) for axis in (0, 1)], axis=1)
    after = np.maximum(length - reached[-1], 0.0)[:, None]
    last = (way[-1] - way[-2]) / (reached[-1] - reached[-2])
    return np.asarray(points + after * last)
