"""Pieces of surface that organs are put together from: sheets, strips, tubes and bodies of revolution.

An organ's frame has its foot (where it joins the stem) in the origin, y along the organ and z towards its upper side.
Sheets are single: their winding shows the upper side. Bodies are wound outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats, Ints, Mesh, triangle_areas, unit, vertex_normals


class Patch(NamedTuple):
    """Triangles on the way to a mesh, in double precision."""

    points: Floats  # (V, 3) metres, an organ's or a piece's own frame
    faces: Ints  # (F, 3)
    uv: Floats  # (V, 2) u across, v along, within 0..1


def join(patches: Sequence[Patch]) -> Patch:
    """One patch of several; none of them gives an empty one."""
    if not patches:
        return Patch(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 2)))
    start = np.cumsum([0, *(len(patch.points) for patch in patches)])
    return Patch(
        np.concatenate([patch.points for patch in patches]),
        np.concatenate([patch.faces + first for patch, first in zip(patches, start, strict=False)]),
        np.concatenate([patch.uv for patch in patches]),
    )


def to_mesh(*patches: Patch) -> Mesh:
    """The patches as one mesh with smooth normals; each patch is smooth in itself."""
    whole = join(patches)
    normals = vertex_normals(whole.points, whole.faces)
    return Mesh(
        whole.points.astype(np.float32),
        whole.faces.astype(np.uint32),
        normals.astype(np.float32),
        np.clip(whole.uv, 0.0, 1.0).astype(np.float32),
    )


def creased(patch: Patch) -> Patch:
    """The patch with normals of their own on both sides of x = 0."""
    left = np.mean(patch.points[patch.faces, 0], axis=1) < 0.0
    faces = np.where(left[:, None], patch.faces + len(patch.points), patch.faces)
    used, which = np.unique(faces, return_inverse=True)
    one = used % len(patch.points)
    return Patch(patch.points[one], which.reshape(faces.shape), patch.uv[one])


def area_m2(patch: Patch) -> float:
    """Sum of the triangles' areas."""
    return float(triangle_areas(patch.points, patch.faces).sum())


def on_axis(y_m: Floats) -> Floats:
    """(N, 3) points of the y axis at (N,) heights."""
    nothing = np.zeros(len(y_m))
    return np.column_stack([nothing, y_m, nothing])


def outwards(turn_rad: NDArray[np.floating]) -> Floats:
    """(N, 3) directions at right angles to the y axis, by (N,) turns about it."""
    return np.column_stack([np.cos(turn_rad), np.zeros(len(turn_rad)), np.sin(turn_rad)])


def placed(patch: Patch, linear: Floats, shift: Floats) -> Patch:
    """The patch under a (3, 3) matrix, whose columns are the images of x, y, z, and a shift."""
    return patch._replace(points=patch.points @ linear.T + shift)


def lifted(patch: Patch, height_m: float) -> Patch:
    """The patch moved along y."""
    return patch._replace(points=patch.points + np.array([0.0, height_m, 0.0]))


def copies(patch: Patch, linear: Floats, shift: Floats) -> Patch:
    """M copies of a patch under (M, 3, 3) matrices and (M, 3) shifts."""
    count, size = len(linear), len(patch.points)
    points = patch.points @ linear.transpose(0, 2, 1) + shift[:, None, :]
    faces = patch.faces[None] + (size * np.arange(count))[:, None, None]
    return Patch(points.reshape(-1, 3), faces.reshape(-1, 3), np.tile(patch.uv, (count, 1)))


def attitude(along: Floats, upper: Floats) -> Floats:
    """(M, 3, 3) rotations: y becomes `along`, z becomes `upper` made perpendicular to it; both (M, 3)."""
    along = unit(along)
    across = unit(np.cross(along, upper))
    return np.stack([across, along, np.cross(across, along)], axis=-1)


def bend(points: Floats, length_m: float, angle_rad: float, growth: float = 1.0) -> Floats:
    """(V, 3) points bent down so that the direction turns by `angle_rad` from y = 0 to `length_m`.

    The direction at the share t of the length has turned by angle * t^growth: 1 is a circular arc, more bends the tip.
    """
    if abs(angle_rad) < 1e-6:
        return points
    fine = np.linspace(0.0, 1.0, 257)
    turned = angle_rad * fine**growth
    step = np.diff(fine, prepend=0.0) * length_m
    middle = np.concatenate([[0.0], 0.5 * (turned[1:] + turned[:-1])])
    path = np.column_stack([np.cumsum(step * np.cos(middle)), -np.cumsum(step * np.sin(middle))])
    share = points[:, 1] / length_m
    inside = np.clip(share, 0.0, 1.0)
    angle = angle_rad * inside**growth
    beyond = (share - inside) * length_m
    y = np.interp(inside, fine, path[:, 0]) + beyond * np.cos(angle) + points[:, 2] * np.sin(angle)
    z = np.interp(inside, fine, path[:, 1]) - beyond * np.sin(angle) + points[:, 2] * np.cos(angle)
    return np.column_stack([points[:, 0], y, z])


def bent(patch: Patch, length_m: float, angle_rad: float, growth: float = 1.0) -> Patch:
    """`bend` of a patch."""
    return patch._replace(points=bend(patch.points, length_m, angle_rad, growth))


def strip(length_m: float, width_m: Floats, *, keel_rad: float = 0.0, folded: bool = True) -> Patch:
    """A ribbon along y, of (N,) widths at even steps from foot to tip; a last width of 0 makes a pointed tip.

    A folded one has a midrib, and so twice the triangles; each half rises above it by `keel_rad`.
    """
    pointed = width_m[-1] == 0.0
    rows = len(width_m) - 1 if pointed else len(width_m)
    y = np.linspace(0.0, length_m, len(width_m))
    across = np.array([1.0, 0.0, -1.0]) if folded else np.array([1.0, -1.0])
    half = 0.5 * width_m[:rows, None] * across
    rise = np.abs(half) * (np.sin(keel_rad) if folded else 0.0)
    place = np.broadcast_to(y[:rows, None], half.shape)
    points = np.stack([half * np.cos(keel_rad), place, rise], axis=-1).reshape(-1, 3)
    uv = np.stack([np.broadcast_to(0.5 + 0.5 * across, half.shape), y[:rows, None] / length_m + 0.0 * half], axis=-1)
    patch = Patch(points, _grid(rows, len(across)), uv.reshape(-1, 2))
    return _pointed(patch, np.array([0.0, length_m, 0.0]), len(across)) if pointed else patch


def _pointed(grid: Patch, tip: Floats, columns: int) -> Patch:
    """A grid of so many columns with a tip (3,) beyond its last row."""
    end, last = len(grid.points), len(grid.points) - columns
    faces = [(last + k, end, last + k + 1) for k in range(columns - 1)]
    points, uv = np.concatenate([grid.points, [tip]]), np.concatenate([grid.uv, [[0.5, 1.0]]])
    return Patch(points, np.concatenate([grid.faces, np.array(faces, np.int64)]), uv)


def _grid(rows: int, columns: int) -> Ints:
    """Triangles of a grid whose columns run towards -x and whose rows run along y, seen from z."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    right, left = corner, corner + 1
    far_right, far_left = corner + columns, corner + columns + 1
    faces = np.stack([np.stack([right, far_right, left], 1), np.stack([left, far_right, far_left], 1)], axis=1)
    return faces.reshape(-1, 3).astype(np.int64)


def tube(path: Floats, radius_m: Floats, sides: int) -> Patch:
    """An open tube about a path (N, 3) that nowhere turns back, of (N,) radii; a last radius of 0 makes a point."""
    pointed = radius_m[-1] == 0.0
    rows = len(path) - 1 if pointed else len(path)
    tangent = unit(np.gradient(path, axis=0))
    helper = np.eye(3)[np.argmin(np.abs(unit(path[-1] - path[0])))]
    first = unit(np.cross(tangent, helper))
    second = np.cross(tangent, first)
    turn = np.linspace(0.0, -2.0 * np.pi, sides + 1)  # falling: _grid's columns run the other way about
    ring = first[:, None] * np.cos(turn)[:, None] + second[:, None] * np.sin(turn)[:, None]
    points = (path[:, None] + radius_m[:, None, None] * ring)[:rows].reshape(-1, 3)
    v = np.linspace(0.0, 1.0, len(path))[:rows, None] + np.zeros(sides + 1)
    uv = np.stack([np.broadcast_to(np.linspace(0.0, 1.0, sides + 1), v.shape), v], axis=-1).reshape(-1, 2)
    patch = Patch(points, _grid(rows, sides + 1), uv)
    return _pointed(patch, path[-1], sides + 1) if pointed else patch


def stalk(length_m: float, width_m: float, detail: int) -> Patch:
    """A straight stalk along y: a slim triangle, a strip, or a strip folded upward; the same area each time."""
    if detail == 0:
        points = np.array([[width_m, 0.0, 0.0], [0.0, length_m, 0.0], [-width_m, 0.0, 0.0]])
        return Patch(points, np.array([[0, 1, 2]]), np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.0]]))
    if detail == 1:
        return strip(length_m, np.full(2, width_m), folded=False)
    return strip(length_m, width_m * np.array([1.25, 0.85, 0.9]), keel_rad=np.radians(40.0))


def stem(length_m: float, diameter_m: float, detail: int) -> Patch:
    """A round stalk along y, open at both ends."""
    return tube(on_axis(np.array([0.0, length_m])), np.full(2, 0.5 * diameter_m), (3, 3, 6)[detail])


def revolve(profile: Floats, sides: int) -> Patch:
    """A body of revolution about y, wound outward.

    The profile (N, 2) has radius and y, from the lower to the upper end; a first or last radius of 0 is a pole.
    """
    low, high = profile[0, 0] == 0.0, profile[-1, 0] == 0.0
    rings = profile[int(low) : len(profile) - int(high)]
    turn = np.arange(sides) * (2.0 * np.pi / sides)
    circle = np.column_stack([np.cos(turn), np.zeros(sides), -np.sin(turn)])
    points = (rings[:, None, :1] * circle + rings[:, None, 1:] * [0.0, 1.0, 0.0]).reshape(-1, 3)
    here = np.arange(sides)
    after = (here + 1) % sides
    faces = []
    for low_row in range(0, (len(rings) - 1) * sides, sides):
        row = low_row + sides
        one = np.stack([low_row + here, low_row + after, row + here], 1)
        other = np.stack([low_row + after, row + after, row + here], 1)
        faces.append(np.stack([one, other], axis=1).reshape(-1, 3))
    height = np.maximum(np.ptp(profile[:, 1]), 1e-9)
    u = 1.0 - np.abs(turn / np.pi - 1.0)  # up and back again: no seam
    v = (rings[:, 1] - profile[:, 1].min()) / height
    uv = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1).reshape(-1, 2)
    for is_pole, end, ring in ((low, profile[0, 1], 0), (high, profile[-1, 1], len(rings) - 1)):
        if not is_pole:
            continue
        pole = len(points)
        points = np.concatenate([points, [[0.0, end, 0.0]]])
        uv = np.concatenate([uv, [[0.5, np.clip((end - profile[:, 1].min()) / height, 0.0, 1.0)]]])
        row = ring * sides
        order = (after, here) if ring == 0 and end == profile[0, 1] else (here, after)
        faces.append(np.column_stack([np.full(sides, pole), row + order[0], row + order[1]]))
    return Patch(points, np.concatenate(faces).astype(np.int64), uv)


def whorl(petal: Patch, count: int, opening_rad: float, foot_m: Floats | float = 0.0, turn_rad: float = 0.0) -> Patch:
    """`count` copies of a petal about y, opened by `opening_rad` from it, the upper side inward.

    Their feet are `foot_m` from the axis, and the first one is turned by `turn_rad` about it.
    """
    outward = outwards(turn_rad + np.arange(count) * (2.0 * np.pi / count))
    axis = np.array([0.0, 1.0, 0.0])
    along = np.sin(opening_rad) * outward + np.cos(opening_rad) * axis
    upper = np.sin(opening_rad) * axis - np.cos(opening_rad) * outward
    return copies(petal, attitude(along, upper), outward * np.asarray(foot_m).reshape(-1, 1))
