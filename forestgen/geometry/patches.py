"""Pieces of surface that organs are put together from: sheets, strips, tubes and bodies of revolution.

An organ's frame has its foot (where it joins the stem) in the origin, y along the organ and z towards its upper side.
Sheets are single: their winding shows the upper side. Bodies are wound outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.vectors import unit, vertex_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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


def area_m2(patch: Patch) -> float:
    """Sum of the triangles' areas."""
    a, b, c = (patch.points[patch.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def placed(patch: Patch, linear: Floats, shift: Floats) -> Patch:
    """The patch under a (3, 3) matrix, whose columns are the images of x, y, z, and a shift."""
    return patch._replace(points=patch.points @ linear.T + shift)


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
    """A flat or V-shaped ribbon along y.

    Parameters
    ----------
    width_m : (N,) at even steps from foot to tip; a last width of 0 makes a pointed tip.
    keel_rad : rise of each half above the midrib.
    folded : with a midrib, and so twice the triangles.
    """
    pointed = width_m[-1] == 0.0
    rows = len(width_m) - 1 if pointed else len(width_m)
    y = np.linspace(0.0, length_m, len(width_m))
    across = np.array([1.0, 0.0, -1.0]) if folded else np.array([1.0, -1.0])
    half = 0.5 * width_m[:rows, None] * across
    points = np.stack(
        [
            half * np.cos(keel_rad),
            np.broadcast_to(y[:rows, None], half.shape),
            np.abs(half) * (np.sin(keel_rad) if folded else 0.0),
        ],
        axis=-1,
    ).reshape(-1, 3)
    uv = np.stack([np.broadcast_to(0.5 + 0.5 * across, half.shape), y[:rows, None] / length_m + 0.0 * half], axis=-1)
    faces = _grid(rows, len(across))
    if pointed:
        last, tip = (rows - 1) * len(across), rows * len(across)
        points = np.concatenate([points, [[0.0, length_m, 0.0]]])
        uv = np.concatenate([uv.reshape(-1, 2), [[0.5, 1.0]]])
        ends = [(last + k, tip, last + k + 1) for k in range(len(across) - 1)]
        faces = np.concatenate([faces, np.array(ends, np.int64)])
    return Patch(points, faces, uv.reshape(-1, 2))


def _grid(rows: int, columns: int) -> Ints:
    """Triangles of a grid whose columns run towards -x and whose rows run along y, seen from z."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    right, left = corner, corner + 1
    far_right, far_left = corner + columns, corner + columns + 1
    faces = np.stack([np.stack([right, far_right, left], 1), np.stack([left, far_right, far_left], 1)], axis=1)
    return faces.reshape(-1, 3).astype(np.int64)


def tube(path: Floats, radius_m: Floats, sides: int) -> Patch:
    """An open tube about a path that nowhere turns back; a last radius of 0 closes its end in a point.

    Parameters
    ----------
    path : (N, 3).
    radius_m : (N,).
    """
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
    faces = _grid(rows, sides + 1)
    if pointed:
        last, tip = (rows - 1) * (sides + 1), rows * (sides + 1)
        points, uv = np.concatenate([points, path[-1:]]), np.concatenate([uv, [[0.5, 1.0]]])
        faces = np.concatenate([faces, [(last + k, tip, last + k + 1) for k in range(sides)]])
    return Patch(points, faces, uv)


def stalk(length_m: float, width_m: float, detail: int) -> Patch:
    """A straight stalk along y: a slim triangle, a strip, or a strip folded upward; the same area each time."""
    if detail == 0:
        half = width_m
        points = np.array([[half, 0.0, 0.0], [0.0, length_m, 0.0], [-half, 0.0, 0.0]])
        return Patch(points, np.array([[0, 1, 2]]), np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.0]]))
    if detail == 1:
        return strip(length_m, np.full(2, width_m), folded=False)
    return strip(length_m, width_m * np.array([1.25, 0.85, 0.9]), keel_rad=np.radians(40.0))


def revolve(profile: Floats, sides: int) -> Patch:
    """A body of revolution about y, wound outward.

    Parameters
    ----------
    profile : (N, 2) radius and y, from the lower to the upper pole; a first or last radius of 0 is a pole.
    """
    low, high = profile[0, 0] == 0.0, profile[-1, 0] == 0.0
    rings = profile[int(low) : len(profile) - int(high)]
    turn = np.arange(sides) * (2.0 * np.pi / sides)
    circle = np.column_stack([np.cos(turn), np.zeros(sides), -np.sin(turn)])
    points = (rings[:, None, :1] * circle + rings[:, None, 1:] * [0.0, 1.0, 0.0]).reshape(-1, 3)
    here = np.arange(sides)
    after = (here + 1) % sides
    faces = [
        np.stack(
            [
                np.stack([k * sides + here, k * sides + after, (k + 1) * sides + here], 1),
                np.stack([k * sides + after, (k + 1) * sides + after, (k + 1) * sides + here], 1),
            ],
            axis=1,
        ).reshape(-1, 3)
        for k in range(len(rings) - 1)
    ]
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

    Parameters
    ----------
    foot_m : distance of the petals' feet from the axis.
    turn_rad : turn of the first about the axis.
    """
    turn = turn_rad + np.arange(count) * (2.0 * np.pi / count)
    outward = np.column_stack([np.cos(turn), np.zeros(count), np.sin(turn)])
    axis = np.array([0.0, 1.0, 0.0])
    along = np.sin(opening_rad) * outward + np.cos(opening_rad) * axis
    upper = np.sin(opening_rad) * axis - np.cos(opening_rad) * outward
    return copies(petal, attitude(along, upper), outward * np.asarray(foot_m).reshape(-1, 1))
