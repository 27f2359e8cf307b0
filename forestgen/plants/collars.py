"""Where a branch leaves the axis that bears it: rings that swell towards the bearer's surface.

The swelling is a fillet: strong in the axil, where the two surfaces face each other, none below, where they nearly
continue one another. Near the bearer the normals turn into the bearer's, so that the shading has no crease.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.geometry.mesh import Floats, Ints, Mesh, unit
from forestgen.geometry.sweep import Polylines, rotation_minimising_frames, sides_for_radius, sweep_tubes
from forestgen.plants.skeleton import Skeleton

_COLLARED_M = 0.008  # thinner branches have no collar
_MANY_RINGS_M = 0.015  # radius from which a collar has all its rings
_SWELLING = 1.0  # of the branch's radius, on the bearer's surface, where the surfaces face each other
_REACH = 2.4  # of the branch's radius: distance from the bearer's surface at which the swelling ends
_WITHIN = 0.95  # of the bearer's radius, which a collar never exceeds
_RINGS = 6  # of a thick branch; half as many of a thin one
_BLEND = 0.9  # of the branch's radius: distance from the bearer's surface at which the normals are the branch's own
_MOST_BLEND = 0.6
_FARTHEST = 8.0  # of both radii: no collar reaches further from the bearing node
_LEAST_SINE = 0.4  # of the angle between branch and bearer, for the collar's length
_LEAST_GAP = 0.15  # of the branch's radius, from a new ring to the next node


class _Bearers(NamedTuple):
    """The segments before and after C bearing nodes, as cones with round ends."""

    position_m: Floats  # (C, 3) of the node
    radius_m: Floats  # (C,)
    way_m: Floats  # (C, 2, 3) to the node before and to the node after
    end_radius_m: Floats  # (C, 2) at those nodes


def _bearers(skeleton: Skeleton, node: Ints) -> _Bearers:
    before = np.where(skeleton.parent[node] >= 0, skeleton.parent[node], node)
    after = np.minimum(node + 1, len(skeleton.axis) - 1)
    after = np.where(skeleton.axis[after] == skeleton.axis[node], after, node)
    around = np.stack([before, after], axis=1)
    position = skeleton.position_m[node].astype(np.float64)
    way = skeleton.position_m[around] - position[:, None]
    radius, end_radius = skeleton.radius_m[node].astype(np.float64), skeleton.radius_m[around].astype(np.float64)
    return _Bearers(position, radius, way, end_radius)


def sweep_with_collars(
    skeleton: Skeleton,
    lines: Polylines,
    bearer: Ints,
    *,
    pointed: NDArray[np.bool_],
    height_ratio: float,
    tile_m: tuple[float, float],
) -> tuple[Mesh, Ints]:
    """Branches as tubes with collars, and where each tube's vertices begin; see `sweep_tubes`.

    `lines`: A branches from the middle of their bearers on. `bearer`: (A,) node that bears each.
    """
    base = lines.radius_m[lines.offset[:-1]]
    sides = sides_for_radius(base)
    chosen = np.flatnonzero((base >= _COLLARED_M) & (base < 2.0 * skeleton.radius_m[bearer]))
    if not len(chosen):
        return sweep_tubes(lines, sides, pointed=pointed, height_ratio=height_ratio, tile_m=tile_m)
    sides[chosen] = np.maximum(sides[chosen], np.where(base[chosen] < _MANY_RINGS_M, 6, 8))
    surfaces = _bearers(skeleton, bearer[chosen])
    lines = _with_rings(lines, chosen, _stops(lines, chosen, surfaces))
    factor = np.ones((len(lines.radius_m), int(sides.max())))
    _, normal, binormal = rotation_minimising_frames(lines)
    points = np.ascontiguousarray(lines.points_m)
    _swell(points, lines.radius_m, lines.offset, sides, chosen, surfaces, normal, binormal, factor)
    mesh, vertex_start = sweep_tubes(
        lines, sides, pointed=pointed, radial_factor=factor, height_ratio=height_ratio, tile_m=tile_m
    )
    if mesh.normals is not None:
        _blend(mesh.vertices_m, mesh.normals, vertex_start, chosen, base[chosen], surfaces)
    return mesh, vertex_start


@compiled
def _nearest(x: float, y: float, z: float, c: int, bearers: _Bearers) -> Any:
    """Signed distance from bearer c's surface, negative inside, and the unit vector away from its axis."""
    least, nx, ny, nz = np.inf, 0.0, 0.0, 0.0
    position, radius, way, end = bearers
    for side in range(2):
        dx, dy, dz = x - position[c, 0], y - position[c, 1], z - position[c, 2]
        wx, wy, wz = way[c, side, 0], way[c, side, 1], way[c, side, 2]
        share = (dx * wx + dy * wy + dz * wz) / max(wx * wx + wy * wy + wz * wz, 1e-30)
        share = min(max(share, 0.0), 1.0)
        dx, dy, dz = dx - share * wx, dy - share * wy, dz - share * wz
        apart = sqrt(dx * dx + dy * dy + dz * dz)
        distance = apart - radius[c] - share * (end[c, side] - radius[c])
        if distance < least:
            least = distance
            apart = max(apart, 1e-12)
            nx, ny, nz = dx / apart, dy / apart, dz / apart
    return least, nx, ny, nz


@compiled
def _swell(  # type: ignore[no-untyped-def]
    points, radius, offset, sides, chosen, bearers, normal, binormal, factor
):
    """Factors of the vertices that lie near the bearer's surface."""
    position, bearing_radius = bearers.position_m, bearers.radius_m
    for c in range(len(chosen)):
        tube = chosen[c]
        reach = _FARTHEST * (bearing_radius[c] + radius[offset[tube]])
        for i in range(offset[tube], offset[tube + 1]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            r = radius[i]
            apart = sqrt((x - position[c, 0]) ** 2 + (y - position[c, 1]) ** 2 + (z - position[c, 2]) ** 2)
            if apart > reach or r <= 0.0:
                break
            for j in range(sides[tube]):
                a = 2.0 * pi * j / sides[tube]
                ox = cos(a) * normal[i, 0] + sin(a) * binormal[i, 0]
                oy = cos(a) * normal[i, 1] + sin(a) * binormal[i, 1]
                oz = cos(a) * normal[i, 2] + sin(a) * binormal[i, 2]
                distance, nx, ny, nz = _nearest(x + r * ox, y + r * oy, z + r * oz, c, bearers)
                facing = min(max(0.5 - 0.6 * (ox * nx + oy * ny + oz * nz), 0.0), 1.0)
                rest = min(max(1.0 - distance / (_REACH * r), 0.0), 1.0)
                swollen = min(r * (1.0 + _SWELLING * facing * rest * rest), _WITHIN * bearing_radius[c])
                factor[i, j] = max(swollen / r, 1.0)


@compiled
def _blend(vertices, normals, vertex_start, chosen, base, bearers):  # type: ignore[no-untyped-def]
    """Turn the normals of the vertices near a bearer's surface towards the bearer's."""
    for c in range(len(chosen)):
        for i in range(vertex_start[chosen[c]], vertex_start[chosen[c] + 1]):
            distance, nx, ny, nz = _nearest(vertices[i, 0], vertices[i, 1], vertices[i, 2], c, bearers)
            rest = 1.0 - distance / (_BLEND * base[c])
            if rest <= 0.0:
                continue
            share = _MOST_BLEND * min(rest, 1.0) ** 2
            x = (1.0 - share) * normals[i, 0] + share * nx
            y = (1.0 - share) * normals[i, 1] + share * ny
            z = (1.0 - share) * normals[i, 2] + share * nz
            length = sqrt(x * x + y * y + z * z)
            if length > 0.2:
                normals[i, 0], normals[i, 1], normals[i, 2] = x / length, y / length, z / length


def _stops(lines: Polylines, chosen: Ints, surfaces: _Bearers) -> Floats:
    """(C, R) arc lengths of the new rings: from where the branch's outer side comes out to where the swelling ends."""
    foot = lines.offset[chosen]
    radius = lines.radius_m[foot]
    branch = unit(lines.points_m[foot + 1] - lines.points_m[foot])
    along = unit(surfaces.way_m[:, 1] - surfaces.way_m[:, 0])
    cosine = np.abs(np.sum(branch * along, axis=1))
    sine = np.maximum(np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)), _LEAST_SINE)
    cosine = np.minimum(cosine, np.sqrt(1.0 - sine * sine))
    out = np.maximum((surfaces.radius_m - radius * cosine) / sine - 0.4 * radius, 0.3 * surfaces.radius_m)
    end = (surfaces.radius_m + radius * cosine) / sine + 0.8 * _REACH * radius / sine
    stops: Floats = out[:, None] + (end - out)[:, None] * np.linspace(0.0, 1.0, _RINGS)
    stops[radius < _MANY_RINGS_M, 1::2] = np.inf  # left out
    return stops


def _with_rings(lines: Polylines, chosen: Ints, stops: Floats) -> Polylines:
    """Points added at arc lengths `stops` (C, R) of the chosen lines, unless a line ends or has a node near there."""
    step = np.linalg.norm(np.diff(lines.points_m, axis=0, prepend=lines.points_m[:1]), axis=1)
    step[lines.offset[:-1]] = 0.0
    total = np.cumsum(step)
    arc: Floats = total - np.repeat(total[lines.offset[:-1]], lines.lengths)  # from each line's foot
    length = arc[lines.offset[1:] - 1]
    line = np.repeat(np.arange(len(length)), lines.lengths)
    start = np.concatenate([[0.0], np.cumsum(length + 1.0)[:-1]])  # all lines on one axis, a metre apart
    place = start[line] + arc
    stops = np.minimum(stops, length[chosen, None])  # these are left out below
    wanted = (start[chosen, None] + stops).reshape(-1)
    owner = np.repeat(chosen, stops.shape[1])
    gap = _LEAST_GAP * lines.radius_m[lines.offset[owner]]
    at = np.searchsorted(place, wanted)
    near = np.minimum(wanted - place[at - 1], place[np.minimum(at, len(place) - 1)] - wanted)
    keep = (stops.reshape(-1) < 0.9 * length[owner]) & (near > gap)
    wanted, owner = wanted[keep], owner[keep]
    order = np.argsort(np.concatenate([place, wanted]), kind="stable")
    columns = [np.concatenate([c, np.interp(wanted, place, c)])[order] for c in (*lines.points_m.T, lines.radius_m)]
    counts = lines.lengths + np.bincount(owner, minlength=len(length))
    offset = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Polylines(np.stack(columns[:3], axis=1), columns[3], offset)
