"""Stems in a camera's way: how far a point is from their surfaces, and circles on the map that hold them.

A stem is what an exemplar has as trunk; of a dead tree, whose trunk and branches are one part, all of its dead wood.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.spec import Instances

Floats = NDArray[np.float64]


class Trunks:
    """The stems of a scene's plants, in still air."""

    def __init__(self, exemplars: Sequence[Exemplar], instances: Instances) -> None:
        self._corners = [_corners(one) for one in exemplars]
        self._mine = instances.exemplar.astype(np.intp)
        self._transform = instances.transform
        self._plant_id = instances.plant_id
        low = np.full((len(exemplars), 3), np.inf)
        high = np.full((len(exemplars), 3), -np.inf)
        for index, corners in enumerate(self._corners):
            if len(corners):
                low[index], high[index] = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self._low, self._high = low, high
        self._scale = np.cbrt(np.abs(np.linalg.det(self._transform[:, :, :3])))

    def clearance_m(self, position_m: Floats, reach_m: float) -> tuple[float, int]:
        """Distance from a point to the nearest stem's surface, negative inside, and its plant; at most `reach_m`, 0."""
        nearest, plant = reach_m, 0
        # In the exemplar's frame, which is turned and scaled; a lean changes lengths by little.
        inverse = np.linalg.inv(self._transform[:, :, :3])
        local = np.einsum("nij,nj->ni", inverse, position_m - self._transform[:, :, 3])
        margin = (reach_m / self._scale)[:, None]
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
        """(T, 2) middles and (T,) radii of circles that hold the stems from the plants' feet up to a height."""
        middles, radii = [], []
        for index, corners in enumerate(self._corners):
            rows = np.flatnonzero(self._mine == index)
            if not len(rows) or not len(corners):
                continue
            top = height_m / float(self._scale[rows].min())  # as far up as the smallest of its plants needs
            points = _clipped(corners, 0.0, top)
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
    dots = (np.einsum("fc,fc->f", u, v) for u, v in ((a, b), (b, c), (c, a)))
    ab, bc, ca = dots
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(float(angle.sum())) / (4 * np.pi)
