"""What a forester would measure on the plants of a scene, from the geometry that is rendered.

Each exemplar is measured once, and its measures go through the instances' transforms: lengths with their scales across
the plant's axis and along it, areas with those and the attitude of each triangle, points as they are. A lean turns a
plant as a whole.

- Diameter at breast height: that of the circle whose area the trunk's section has, 1.3 m from the stem base along the
  plant's own axis, across that axis. Stems that overlap there count once; several stems give the diameter of one stem
  of their basal area, sqrt(sum d^2). No trunk there: NaN, as for plants below 1.3 m, and for dead trees, whose trunk
  and branches are one part. Bark and the root's flare count, as under a tape. A stem that leans within its plant is cut
  at its slant: 7% wider at 30 degrees.
- Crown width: the mean of the extents along the exemplar's x and y.
- Leaf area: one side of all blades.
- Crown base: the height that 2% of the leaf area lie below, along the plant's axis.
- Stem volume: the integral of the trunk's section over the height, from the stem base to the tip; bark counts.
- Wood volume: stem and branches above the ground, `Exemplar.wood_volume_m3`.
- Stem base: the origin of the plant, where it stands. Tip: its highest vertex in the world. Crown centre: the centroid
  of the surface of the leaves, else of the flowers, else of all, in the exemplar; carried along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, hull_of
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.tree_fit import BELOW_CROWN
from forestgen.scene.spec import Instances

Floats = NDArray[np.float64]

_DIRECTIONS_AT_ONCE = 1024
_ATTITUDES = 64  # classes of the leaves' attitude
_MOST_SECTIONS = 64  # of an exemplar: its instances are of many scales
_VOLUME_SECTIONS = 40  # of a stem, at equal distances
_LEVELS = 128  # of a profile of leaves


@dataclass(frozen=True)
class PlantMeasures:
    """One row an instance of the scene, in its order (the population's)."""

    exemplar: NDArray[np.uint32]  # (N,) index into SceneSpec.exemplars
    world_from_exemplar: NDArray[np.float64]  # (N, 3, 4) metres: the instance's transform
    crown_width_m: NDArray[np.float64]  # (N,) mean of its geometry's extents in x and y of its own frame
    dbh_m: NDArray[np.float64]  # (N,) stem diameter at 1.3 m; NaN for plants that have no trunk there
    crown_base_m: NDArray[np.float64]  # (N,) above its foot, along its axis; NaN of plants without leaves
    leaf_area_m2: NDArray[np.float64]  # (N,) one side of all blades
    stem_base_m: NDArray[np.float64]  # (N, 3) world
    tip_m: NDArray[np.float64]  # (N, 3) world: the highest point of its geometry
    crown_centre_m: NDArray[np.float64]  # (N, 3) world: area-weighted centre of leaves, or of all where there are none

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> PlantMeasures:
        """Those of some rows."""
        return PlantMeasures(**{name: values[rows] for name, values in vars(self).items()})


class PlantMeter:
    """Exemplars, measured once: O(their triangles). Then any instances of them: O(instances)."""

    def __init__(self, exemplars: Sequence[Exemplar]) -> None:
        self._exemplars = exemplars
        self._centre = np.array([crown_centre(exemplar) for exemplar in exemplars]).reshape(-1, 3)
        self._top = np.array([_top(exemplar) for exemplar in exemplars]).reshape(-1, 3)
        self._leaves = [_Leaves.of(exemplar) for exemplar in exemplars]
        self._hulls: dict[int, Floats] = {}  # of exemplars that have been seen leaning
        self._stems: dict[int, float] = {}  # volumes, of exemplars whose stems were asked for

    def measure(self, instances: Instances) -> PlantMeasures:
        """Measures of plants as they stand."""
        linear, origin = instances.transform[:, :, :3], instances.transform[:, :, 3]
        across, along = (np.linalg.norm(linear[:, :, k], axis=1) for k in (0, 2))  # scales of widths and of lengths
        mine = instances.exemplar.astype(np.intp)
        tip, diameter = self._top[mine], np.full(len(instances), np.nan)
        for index in np.unique(mine).tolist():
            rows = np.flatnonzero(mine == index)
            diameter[rows] = stem_diameter_m(self._exemplars[index], BREAST_HEIGHT_M / along[rows])
            lean = rows[np.any(linear[rows, 2, :2], axis=1)]
            if len(lean):
                tip[lean] = _furthest(self._hull(index), linear[lean, 2])
        width = np.array([exemplar.crown_width_m for exemplar in self._exemplars], dtype=np.float64)[mine]
        base = np.array([one.base_m for one in self._leaves], dtype=np.float64)[mine]
        leaf_area = np.zeros(len(instances))
        for index in np.unique(mine).tolist():
            rows = mine == index
            whole = self._exemplars[index].leaf_area_m2
            leaf_area[rows] = whole * self._leaves[index].area_factor(across[rows], along[rows])
        return PlantMeasures(
            exemplar=instances.exemplar.astype(np.uint32),
            world_from_exemplar=instances.transform,
            crown_width_m=width * across,
            dbh_m=diameter * across,
            crown_base_m=base * along,
            leaf_area_m2=leaf_area,
            stem_base_m=origin.copy(),
            tip_m=_moved(linear, tip) + origin,
            crown_centre_m=_moved(linear, self._centre[mine]) + origin,
        )

    def volumes_m3(self, instances: Instances) -> tuple[Floats, Floats]:
        """(N,) volumes of the stems, and (N,) of all wood above the ground."""
        across, along = (np.linalg.norm(instances.transform[:, :, k], axis=1) for k in (0, 2))
        mine = instances.exemplar.astype(np.intp)
        for index in set(np.unique(mine).tolist()) - self._stems.keys():
            self._stems[index] = stem_volume_m3(self._exemplars[index])
        stem, wood = np.zeros(len(self._exemplars)), np.array([one.wood_volume_m3 for one in self._exemplars])
        stem[list(self._stems)] = list(self._stems.values())
        return stem[mine] * across**2 * along, wood[mine] * across**2 * along

    def leaf_area_by_height_m2(
        self, instances: Instances, leaf_area_m2: Floats, group: NDArray[np.integer], edges_m: Floats
    ) -> Floats:
        """(G, K) leaf area of the groups 0 to G - 1 between K + 1 heights above the stem base, along the plants' axes.

        Leaves beyond the heights count in the layer next to them: the sum over all layers is the whole area.

        `leaf_area_m2`: (N,) of the instances, as `measure` has it. `group`: (N,) their groups; -1: left out.
        """
        found = np.zeros((int(group.max(initial=0)) + 1, len(edges_m) - 1))
        along = np.linalg.norm(instances.transform[:, :, 2], axis=1)
        for index in np.unique(instances.exemplar).tolist():
            rows = np.flatnonzero((instances.exemplar == index) & (group >= 0) & (leaf_area_m2 > 0.0))
            leaves = self._leaves[index]
            share = np.interp(edges_m / along[rows, None], leaves.level_m, leaves.below)
            share[:, 0], share[:, -1] = 0.0, 1.0
            np.add.at(found, group[rows], np.diff(share, axis=1) * leaf_area_m2[rows, None])
        return found

    def _hull(self, index: int) -> Floats:
        """(V, 3) corners of an exemplar's convex hull, which hold the highest point of every pose."""
        if index not in self._hulls:
            self._hulls[index] = hull_of([organ.mesh for organ in self._exemplars[index].organs]).vertices_m
        return self._hulls[index]


@dataclass(frozen=True)
class _Leaves:
    """Attitude and heights of an exemplar's leaves."""

    steepness: Floats  # (K,) squares of the normals' z
    share: Floats  # (K,) of the area
    base_m: float
    level_m: Floats  # (L,) heights, the lowest and the highest of the leaves' among them
    below: Floats  # (L,) share of the area below each

    @classmethod
    def of(cls, exemplar: Exemplar) -> _Leaves:
        corners = [
            organ.mesh.vertices_m.astype(np.float64)[organ.mesh.faces]
            for organ in exemplar.organs
            if organ.part == Part.LEAF and len(organ.mesh.faces)
        ]
        if not corners:
            return cls(np.zeros(1), np.zeros(1), np.nan, np.zeros(1), np.zeros(1))
        normal, height = (np.concatenate(one) for one in zip(*map(_normals, corners), strict=True))
        area = np.linalg.norm(normal, axis=1)
        square = np.divide(normal[:, 2] ** 2, area**2, out=np.zeros_like(area), where=area > 0.0)
        share, edges = np.histogram(square, bins=_ATTITUDES, range=(0.0, 1.0), weights=area)
        order = np.argsort(height, kind="stable")
        total = np.cumsum(area[order])
        base_m = float(height[order][np.searchsorted(total, BELOW_CROWN * total[-1])])
        by_level, level_m = np.histogram(height, bins=_LEVELS, weights=area)
        below = np.concatenate([[0.0], np.cumsum(by_level)]) / max(float(by_level.sum()), 1e-300)
        return cls(0.5 * (edges[1:] + edges[:-1]), share / max(float(share.sum()), 1e-300), base_m, level_m, below)

    def area_factor(self, across: Floats, along: Floats) -> Floats:
        """(M,) area of the leaves over that in the exemplar, scaled by (M,) across and (M,) along the axis."""
        steep = (along**2)[:, None] * (1.0 - self.steepness) + (across**2)[:, None] * self.steepness
        return np.asarray(across * (np.sqrt(steep) @ self.share))


def _normals(corners: Floats) -> tuple[Floats, Floats]:
    """(F, 3) normals as long as twice the area, and (F,) heights of the middles, of (F, 3, 3) triangles."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, :, 2].mean(axis=1)


def _top(exemplar: Exemplar) -> Floats:
    points = np.concatenate([organ.mesh.vertices_m for organ in exemplar.organs]).astype(np.float64)
    return np.asarray(points[np.argmax(points[:, 2])])


def _moved(linear: Floats, points: Floats) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", linear, points))


def crown_centre(exemplar: Exemplar) -> Floats:
    """(3,) centroid of the surface of all leaves, else of all flowers, else of everything; the exemplar's frame."""
    for parts in ((Part.LEAF,), (Part.FLOWER,), tuple(Part)):
        meshes = [organ.mesh for organ in exemplar.organs if organ.part in parts]
        if not meshes:
            continue
        total, moment = 0.0, np.zeros(3)
        for mesh in meshes:
            a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
            normal = np.cross(b - a, c - a)
            area = np.sqrt(np.einsum("fk,fk->f", normal, normal))
            total += area.sum()
            moment += np.sum(area[:, None] * (a + b + c), axis=0) / 3.0
        if total > 0.0:
            return np.asarray(moment / total)
    return np.zeros(3)


def stem_diameter_m(exemplar: Exemplar, height_m: Floats) -> Floats:
    """(M,) diameters of the trunk at (M,) heights above the exemplar's origin; NaN where it has no trunk there.

    Beyond `_MOST_SECTIONS` different heights the diameters between as many equidistant ones are interpolated.
    """
    trunks = [organ.mesh for organ in exemplar.organs if organ.part == Part.TRUNK]
    if not trunks or not len(height_m):
        return np.full(len(height_m), np.nan)
    at, which = np.unique(height_m, return_inverse=True)
    exact = len(at) <= _MOST_SECTIONS
    stops = at if exact else np.linspace(at[0], at[-1], _MOST_SECTIONS)
    area = section_area_m2(trunks, stops)
    diameter = np.sqrt(4.0 / np.pi * np.where(area > 0.0, area, np.nan))
    return np.asarray((diameter if exact else np.interp(at, stops, diameter))[which])


def leaf_base_m(exemplar: Exemplar) -> float:
    """Height of the crown's base: 1 in 50 of the leaf area is below it; NaN without leaves."""
    return _Leaves.of(exemplar).base_m


def stem_volume_m3(exemplar: Exemplar) -> float:
    """Volume of the trunk above the origin: its sections at equal heights, by the midpoint rule; 0 without a trunk."""
    trunks = [organ.mesh for organ in exemplar.organs if organ.part == Part.TRUNK and len(organ.mesh.vertices_m)]
    top_m = max((float(mesh.vertices_m[:, 2].max()) for mesh in trunks), default=0.0)
    step_m = max(top_m, 0.0) / _VOLUME_SECTIONS
    height_m = (np.arange(_VOLUME_SECTIONS, dtype=np.float64) + 0.5) * np.float64(step_m)
    return float(section_area_m2(trunks, height_m).sum() * step_m)


def _furthest(points: Floats, directions: Floats) -> Floats:
    """(M, 3) the point that reaches furthest along each of (M, 3) directions: the world's up in the exemplar."""
    chosen = [
        np.argmax(directions[k : k + _DIRECTIONS_AT_ONCE] @ points.T, axis=1)
        for k in range(0, len(directions), _DIRECTIONS_AT_ONCE)
    ]
    return np.asarray(points[np.concatenate(chosen)])


def section_area_m2(meshes: Sequence[Mesh], height_m: Floats) -> Floats:
    """(K,) areas of the meshes' common sections at (K,) heights; 0 where nothing is cut.

    Windings are counter-clockwise seen from outside; a surface that is open at a height encloses nothing there. O(faces
    near the heights, times their number).
    """
    if not len(height_m) or not meshes:
        return np.zeros(len(height_m))
    corners = np.concatenate([_near(mesh, height_m) for mesh in meshes])
    return np.array([_union(_cut(corners, float(one))) for one in height_m])


def _near(mesh: Mesh, height_m: Floats) -> Floats:
    """(F, 3, 3) corners of the triangles that lie in the heights' range at least in part."""
    z = mesh.vertices_m[:, 2].astype(np.float64)[mesh.faces]
    chosen = (z.max(axis=1) >= height_m.min()) & (z.min(axis=1) <= height_m.max())
    return np.asarray(mesh.vertices_m.astype(np.float64)[mesh.faces[chosen]])


def _cut(corners: Floats, height_m: float) -> Floats:
    """(S, 4) x, y of both ends of the cuts through the triangles that the plane crosses, their inside to the left."""
    above = corners[:, :, 2] >= height_m  # a corner in the plane counts as above: each outline closes
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossed], above[crossed]
    up = above.sum(axis=1) == 1
    row, alone = np.arange(len(up)), np.argmax(above == up[:, None], axis=1)  # the corner on its own side
    ends = []
    for other in ((alone + np.where(up, 1, 2)) % 3, (alone + np.where(up, 2, 1)) % 3):
        # From the lower to the upper corner, for both triangles of an edge: they agree to the bit.
        low, high = corners[row, np.where(up, other, alone)], corners[row, np.where(up, alone, other)]
        share = (height_m - low[:, 2]) / (high[:, 2] - low[:, 2])
        ends.append(low[:, :2] + share[:, None] * (high[:, :2] - low[:, :2]))
    return np.concatenate(ends, axis=1)


@compiled
def _union(segments):  # type: ignore[no-untyped-def]
    """Area of the points of winding number other than 0."""
    count = len(segments)
    level = np.empty(2 * count)
    for s in range(count):
        level[2 * s], level[2 * s + 1] = segments[s, 1], segments[s, 3]
    level = np.sort(level)
    crossing, turn = np.empty(count), np.empty(count)
    area = 0.0
    for strip in range(2 * count - 1):
        thickness = level[strip + 1] - level[strip]
        if thickness <= 0.0:
            continue
        y = level[strip] + 0.5 * thickness
        found = 0
        for s in range(count):
            y0, y1 = segments[s, 1], segments[s, 3]
            if (y0 <= y) != (y1 <= y):
                crossing[found] = segments[s, 0] + (y - y0) / (y1 - y0) * (segments[s, 2] - segments[s, 0])
                turn[found] = 1.0 if y1 > y0 else -1.0
                found += 1
        order = np.argsort(crossing[:found])
        winding = 0.0
        for i in range(found - 1):
            winding += turn[order[i]]
            if winding != 0.0:
                area += thickness * (crossing[order[i + 1]] - crossing[order[i]])
    return area
