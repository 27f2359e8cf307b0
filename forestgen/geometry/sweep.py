"""Tubes swept along polylines: trunks, branches and twigs.

Rings are carried along each polyline by rotation-minimising frames (the double reflection method), so a tube bends
without twisting. All polylines of one number of sides are swept at once.

References
----------
Wang, W., Jüttler, B., Zheng, D., Liu, Y. (2008). Computation of rotation minimizing frames. ACM Transactions on
Graphics 27(1), article 2, table I.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.vectors import any_perpendicular, unit, vertex_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Polylines:
    """A polylines laid end to end: polyline a is points ``offset[a]:offset[a + 1]``, at least two."""

    points_m: Floats  # (P, 3) metres, the owner's frame
    radius_m: Floats  # (P,) tube radius at each point
    offset: Ints  # (A + 1,) offset[0] = 0, offset[A] = P

    def __post_init__(self) -> None:
        if self.points_m.shape != (len(self.radius_m), 3):
            raise ValueError(f"points_m must be ({len(self.radius_m)}, 3), got {self.points_m.shape}")
        if self.offset[0] != 0 or self.offset[-1] != len(self.radius_m) or np.any(np.diff(self.offset) < 2):
            raise ValueError("offset must run from 0 to P in steps of at least two points")

    @property
    def lengths(self) -> Ints:
        """(A,) points of each polyline."""
        return np.diff(self.offset)


def sides_for_radius(radius_m: Floats) -> Ints:
    """Sides of a tube by its base radius: 3 for twigs below 1 cm, 12 from 9 cm on, 16 from 20 cm on; (A,) to (A,)."""
    steps = np.array([0.010, 0.022, 0.045, 0.09, 0.20])
    return np.array([3, 5, 6, 8, 12, 16], dtype=np.int64)[np.searchsorted(steps, radius_m, side="right")]


def tangents(lines: Polylines) -> Floats:
    """(P, 3) unit tangents: the bisector of the two segments that meet at a point, one-sided at the ends."""
    forward = np.zeros_like(lines.points_m)
    forward[:-1] = unit(np.diff(lines.points_m, axis=0))
    forward[lines.offset[1:] - 1] = 0.0  # no segment joins one polyline to the next
    backward = np.roll(forward, 1, axis=0)
    return unit(forward + backward)


def rotation_minimising_frames(lines: Polylines) -> tuple[Floats, Floats, Floats]:
    """Frames (tangent, normal, binormal), each (P, 3), right-handed, carried along each polyline without twist."""
    points, tangent = lines.points_m, tangents(lines)
    normal = np.zeros_like(tangent)
    first = lines.offset[:-1]
    normal[first] = any_perpendicular(tangent[first])
    lengths = lines.lengths
    for step in range(int(lengths.max(initial=1)) - 1):
        i = first[lengths > step + 1] + step
        normal[i + 1] = _double_reflection(points[i], points[i + 1], tangent[i], tangent[i + 1], normal[i])
    return tangent, normal, np.cross(tangent, normal)


def _double_reflection(x0: Floats, x1: Floats, t0: Floats, t1: Floats, r0: Floats) -> Floats:
    """Reference vectors at x1 from those at x0: a reflection in the chord's bisector plane, then one that aligns t1."""
    chord = x1 - x0
    scale = 2.0 / np.maximum(np.sum(chord * chord, axis=1), 1e-30)
    r_left = r0 - (scale * np.sum(chord * r0, axis=1))[:, None] * chord
    t_left = t0 - (scale * np.sum(chord * t0, axis=1))[:, None] * chord
    turn = t1 - t_left
    scale = 2.0 / np.maximum(np.sum(turn * turn, axis=1), 1e-30)
    r1 = r_left - (scale * np.sum(turn * r_left, axis=1))[:, None] * turn
    return unit(r1 - np.sum(r1 * t1, axis=1, keepdims=True) * t1)


def sweep(
    lines: Polylines,
    sides: Ints,
    *,
    pointed: bool = True,
    closed_base: bool = False,
    radial_factor: Floats | None = None,
) -> Mesh:
    """One mesh of all tubes, with smooth vertex normals.

    Parameters
    ----------
    lines : the A polylines.
    sides : (A,) sides of each tube, at least 3.
    pointed : a tube ends in a point at its last point, whose radius does not count; otherwise in a flat cap.
    closed_base : cap the first ring too. Branches start inside their parent and need none.
    radial_factor : (P, S) factor on the radius of each ring's vertices (bark, root flare); all sides must be S.
    """
    _, normal, binormal = rotation_minimising_frames(lines)
    pieces_v: list[Floats] = []
    pieces_f: list[Ints] = []
    start = 0
    for count in np.unique(sides):
        chosen = np.flatnonzero(sides == count)
        factor = None if radial_factor is None else radial_factor[:, :count]
        vertices = _ring_vertices(lines, chosen, int(count), normal, binormal, factor)
        faces, used = _tube_faces(lines, chosen, int(count), pointed, closed_base)
        pieces_v.append(vertices)
        pieces_f.append(faces + start)
        start += used
    if not pieces_v:
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32), np.zeros((0, 3), np.float32))
    vertices, faces = _compact(np.concatenate(pieces_v), np.concatenate(pieces_f))
    normals = vertex_normals(vertices, faces)
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32), normals.astype(np.float32))


def _points_of(lines: Polylines, chosen: Ints) -> tuple[Ints, Ints]:
    """Indices of the chosen polylines' points, end to end, and their own offsets (len(chosen) + 1,)."""
    lengths = lines.lengths[chosen]
    offset = np.concatenate([[0], np.cumsum(lengths)])
    index = np.arange(offset[-1]) + np.repeat(lines.offset[chosen] - offset[:-1], lengths)
    return index, offset


def _ring_vertices(
    lines: Polylines, chosen: Ints, sides: int, normal: Floats, binormal: Floats, factor: Floats | None
) -> Floats:
    """Per point a centre (used by caps and tips) and a ring: (points * (1 + sides), 3)."""
    index, _ = _points_of(lines, chosen)
    angle = np.arange(sides) * (2.0 * np.pi / sides)
    across = normal[index, None] * np.cos(angle)[:, None] + binormal[index, None] * np.sin(angle)[:, None]
    radius = lines.radius_m[index, None] * (1.0 if factor is None else factor[index])
    out = np.empty((len(index), sides + 1, 3))
    out[:, 0] = lines.points_m[index]
    out[:, 1:] = lines.points_m[index, None] + across * np.broadcast_to(radius, (len(index), sides))[..., None]
    return out.reshape(-1, 3)


def _tube_faces(lines: Polylines, chosen: Ints, sides: int, pointed: bool, closed_base: bool) -> tuple[Ints, int]:
    """Faces over `_ring_vertices`' numbering, and how many vertices that numbering has."""
    _, offset = _points_of(lines, chosen)
    stride = sides + 1
    around = np.arange(sides) + 1
    beyond = np.roll(around, -1)
    last = offset[1:] - 1
    lower = np.ones(offset[-1], dtype=bool)
    lower[last] = False
    if pointed:
        lower[last - 1] = False
    ring = np.flatnonzero(lower)[:, None] * stride
    walls = [
        np.stack([ring + around, ring + beyond, ring + stride + beyond], axis=-1),
        np.stack([ring + around, ring + stride + beyond, ring + stride + around], axis=-1),
    ]
    rim = ((last - 1) if pointed else last)[:, None] * stride
    tip = np.broadcast_to(last[:, None] * stride, (len(last), sides))
    caps = [np.stack([rim + around, rim + beyond, tip], axis=-1)]
    if closed_base:
        base = offset[:-1, None] * stride
        centre = np.broadcast_to(base, (len(base), sides))
        caps.append(np.stack([base + beyond, base + around, centre], axis=-1))
    faces = np.concatenate([part.reshape(-1, 3) for part in walls + caps])
    return faces.astype(np.int64), int(offset[-1]) * stride


def _compact(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Drop vertices that no face uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]
