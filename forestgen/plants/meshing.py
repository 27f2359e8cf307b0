"""From a skeleton and its organs to meshes: swept wood and instanced blades."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.blades import instance
from forestgen.geometry.mesh import Mesh
from forestgen.geometry.sweep import Polylines, sides_for_radius, sweep
from forestgen.geometry.vectors import concatenate, unit
from forestgen.plants.exemplar import OrganMesh
from forestgen.plants.foliage import OrganShape
from forestgen.plants.parameters import Wood
from forestgen.plants.skeleton import Skeleton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_FOOT_M = 0.3  # stems reach this far below the ground, so that none hangs over a slope
_MESHED_FLARE_RADIUS_M = 0.012  # thinner stems get no flare and no bark relief
_COLLAR = np.array([0.0, 0.05, 0.12, 0.22, 0.36, 0.55, 0.77, 1.0])  # extra rings of the flare, shares of its height


def wood_mesh(skeleton: Skeleton, trunk: bool, flare: float) -> Mesh:
    """Swept tubes of the stems (`trunk`) or of all branches."""
    first, last = _axis_ranges(skeleton)
    is_trunk = skeleton.order[first] == 0
    chosen = is_trunk if trunk else ~is_trunk
    first, last = first[chosen], last[chosen]
    if trunk:
        meshes = [_stem(_stem_line(skeleton, int(a), int(b)), flare) for a, b in zip(first, last, strict=True)]
        return concatenate(meshes)
    lines = branch_lines(skeleton, first, last)
    return sweep(lines, sides_for_radius(lines.radius_m[lines.offset[:-1]]))


def organ_meshes(skeleton: Skeleton, shapes: Mapping[str, OrganShape], wood: Wood) -> tuple[OrganMesh, ...]:
    """All surfaces of a plant, one mesh per part and material; empty ones are left out."""
    parts: dict[tuple[Part, str], list[Mesh]] = {}
    parts[Part.TRUNK, wood.material] = [wood_mesh(skeleton, True, wood.flare)]
    parts[Part.BRANCH, wood.branch_material or wood.material] = [wood_mesh(skeleton, False, wood.flare)]
    for placement in skeleton.organs:
        shape = shapes[placement.shape]
        mesh = instance(shape.template(), placement.frame)
        parts.setdefault((shape.label, shape.material), []).append(mesh)
    joined = ((part, material, concatenate(meshes)) for (part, material), meshes in parts.items())
    return tuple(OrganMesh(part, material, mesh) for part, material, mesh in joined if mesh.triangles)


def _axis_ranges(skeleton: Skeleton) -> tuple[Ints, Ints]:
    """First node, and one beyond the last, of each axis."""
    first = np.flatnonzero(np.diff(skeleton.axis, prepend=-1))
    return first, np.append(first[1:], len(skeleton.axis))


def branch_lines(skeleton: Skeleton, first: Ints, last: Ints) -> Polylines:
    """Branches from the middle of the axis that bears them, so that no gap shows, to their tips."""
    lengths = last - first + 1
    offset = np.concatenate([[0], np.cumsum(lengths)])
    index = np.arange(offset[-1]) - np.repeat(offset[:-1], lengths) + np.repeat(first - 1, lengths)
    foot = offset[:-1]
    bearer = skeleton.parent[first]
    index[foot] = bearer
    radius = skeleton.radius_m[index].astype(np.float64)
    radius[foot] = np.minimum(0.8 * radius[foot], 1.15 * radius[foot + 1])
    radius[foot] = np.maximum(radius[foot], radius[foot + 1])
    return Polylines(skeleton.position_m[index].astype(np.float64), radius, offset.astype(np.int64))


def _stem_line(skeleton: Skeleton, first: int, last: int) -> Polylines:
    """A stem from below the ground, with close rings where the root collar flares."""
    index = np.arange(first, last)
    if skeleton.parent[first] >= 0:
        index = np.concatenate([[skeleton.parent[first]], index])
    points = skeleton.position_m[index].astype(np.float64)
    radius = skeleton.radius_m[index].astype(np.float64)
    if skeleton.parent[first] >= 0:  # a further stem of a clump has its own girth at the common foot
        radius[0] = radius[1]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    stops = (
        np.union1d(arc, _COLLAR * min(14.0 * radius[0], 0.5 * arc[-1])) if radius[0] > _MESHED_FLARE_RADIUS_M else arc
    )
    stops = stops[np.diff(stops, prepend=-1.0) > 0.3 * radius[0]]  # slivers would show in the shading
    stops = np.append(stops[stops < arc[-1]], arc[-1])
    line = np.stack([np.interp(stops, arc, points[:, k]) for k in range(3)], axis=1)
    foot = line[0] - _FOOT_M * unit(line[1] - line[0] + [0.0, 0.0, 1e-9])
    line = np.concatenate([[foot], line])
    girth = np.concatenate([[radius[0]], np.interp(stops, arc, radius)])
    return Polylines(line, girth, np.array([0, len(line)]))


def _stem(line: Polylines, flare: float) -> Mesh:
    """A stem with its flare, whose ridges run into the main roots, and faint relief further up."""
    base = float(line.radius_m[0])
    sides = sides_for_radius(line.radius_m[:1])
    if base < _MESHED_FLARE_RADIUS_M:
        return sweep(line, sides)
    step = np.linalg.norm(np.diff(line.points_m, axis=0), axis=1)
    height = np.concatenate([[0.0], np.cumsum(step)]) - _FOOT_M
    count = int(sides[0])
    angle = np.arange(count) * (2.0 * np.pi / count)
    phase = 40.0 * line.points_m[min(8, len(height) - 1), :2]  # differs from tree to tree, needs no random number
    near_ground = np.exp(-np.maximum(height, 0.0) / (3.5 * base))[:, None]
    ridges = 1.0 + 0.55 * np.cos(5.0 * angle + phase[0]) + 0.35 * np.cos(3.0 * angle + phase[1])
    relief = 0.03 * np.sin(3.0 * angle + 1.7 * height[:, None]) + 0.025 * np.sin(2.0 * angle - 2.9 * height[:, None])
    return sweep(line, sides, radial_factor=1.0 + flare * near_ground * ridges + relief)
