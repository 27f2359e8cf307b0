"""Tubes swept along polylines: trunks, branches and twigs.

Rings are carried along each polyline by rotation-minimising frames (the double reflection method), so a tube bends
without twisting. Each ring lies in the plane that halves the bend at its point, and is stretched there as a mitre joint
is, so that the tube keeps its section through the bend. Every tube is closed.

A ring is a regular polygon of n sides with the area of the section, pi r^2: its circumradius is r sqrt(2 pi / (n sin(2
pi / n))), and volumes are those of round tubes. The mean width of such a polygon, seen from all sides, is sqrt(n tan(pi
/ n) / pi) times the circle's (Cauchy's formula: perimeter over pi): 1.286 for 3 sides, 1.128 for 4, 1.075 for 5, 1.050
for 6, 1.027 for 8, 1.012 for 12, 1.006 for 16.

References
----------
Wang, W., Jüttler, B., Zheng, D., Liu, Y. (2008). Computation of rotation minimizing frames. ACM Transactions on
Graphics 27(1), article 2, table I.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.threads import map_ranges
from forestgen.geometry.mesh import Floats, Ints, Mesh
from forestgen.geometry.sweep_kernel import Surface, Tubes, Turns, fill
from forestgen.geometry.sweep_points import frames, keep, starts


@dataclass(frozen=True)
class Polylines:
    """A polylines laid end to end: polyline a is points ``offset[a]:offset[a + 1]``, at least two."""

    points_m: Floats  # (P, 3) metres, the owner's frame
    radius_m: Floats  # (P,) tube radius at each point
    offset: Ints  # (A + 1,) offset[0] = 0, offset[A] = P

    @property
    def lengths(self) -> Ints:
        """(A,) points of each polyline."""
        return np.diff(self.offset)


def sides_for_radius(radius_m: Floats) -> Ints:
    """Sides of a tube by its base radius; (A,) to (A,).

    Three below 1.5 mm, whose 29% of extra width are at most 0.9 mm; four, five, six and eight from 1.5, 5, 10, 20 mm on
    (at most 1.3, 1.5, 2 and 2.7 mm too wide); 12 from 5 cm, 16 from 12 cm, 24 from 30 cm on.
    """
    steps = np.array([0.0015, 0.005, 0.010, 0.020, 0.05, 0.12, 0.30])
    return np.array([3, 4, 5, 6, 8, 12, 16, 24], dtype=np.int64)[np.searchsorted(steps, radius_m, side="right")]


def rotation_minimising_frames(lines: Polylines) -> tuple[Floats, Floats, Floats]:
    """Frames (tangent, normal, binormal), each (P, 3), right-handed, carried along each polyline without twist.

    A tangent is the bisector of the two segments that meet at a point, one-sided at the ends. A point that repeats the
    one before has that one's frame.
    """
    tangent, normal = np.zeros_like(lines.points_m), np.zeros_like(lines.points_m)
    frames(np.ascontiguousarray(lines.points_m, dtype=np.float64), lines.offset, tangent, normal)
    return tangent, normal, np.cross(tangent, normal)


def sweep_tubes(
    lines: Polylines,
    sides: Ints,
    *,
    pointed: bool | NDArray[np.bool_] = True,
    radial_factor: Floats | None = None,
    height_ratio: float | Floats = 1.0,
    tile_m: tuple[float, float] = (1.0, 1.0),
) -> tuple[Mesh, Ints]:
    """One mesh of all tubes, closed, wound outward, with smooth normals and texture coordinates.

    The vertices along the seam (where u starts again) and round the caps are doubled: a tube is watertight once
    vertices of equal position are merged. Left out are points that repeat the one before, and at which the line turns
    back on itself (by more than 168 degrees). A radius below what float32 can hold at a tube's place (a millionth of
    its greatest coordinate) is raised to that; a tube that is thinner all along gives no triangles. A mitre stretches a
    ring at most twofold, which holds for bends up to 120 degrees.

    Parameters
    ----------
    lines : the A polylines.
    sides : (A,) sides of each tube, at least 3.
    pointed : (A,) or for all: a tube ends in a point at its last point, whose radius does not count; otherwise in a
        flat cap. It begins with a flat cap.
    radial_factor : (P, S) factor on the radius of each ring's vertices (bark, root flare), S at least the most sides.
        Column j is the direction normal * cos(a) + binormal * sin(a), a = 2 pi j / sides.
    height_ratio : (P,) or for all: extent of the section upwards (at right angles to the tangent) over that across.
        The area stays. It fades to 1 where the tube is within 17 degrees of the vertical.
    tile_m : extent of one repeat of the texture, round and along the tube. u runs over a whole number of repeats
        round the tube, as many as fit its base best; v is the arc length over tile_m[1].

    Returns
    -------
    mesh : normals follow the smooth surface and not the facets; they count the taper and the radial factor's slope.
    vertex_start : (A + 1,) tube a has vertices ``vertex_start[a]:vertex_start[a + 1]``.
    """
    count, points = len(lines.offset) - 1, np.ascontiguousarray(lines.points_m, dtype=np.float64)
    sides, pointed = _each(sides, count, np.int64), _each(pointed, count, np.bool_)
    ratio = _each(height_ratio, len(points), np.float64)
    factor = np.zeros((0, 0)) if radial_factor is None else np.ascontiguousarray(radial_factor, dtype=np.float64)
    kept, length, least = np.empty(len(points), dtype=np.int64), np.empty(count, dtype=np.int64), np.empty(count)
    keep(points, lines.radius_m, lines.offset, kept, length, least)
    vertex_start, face_start = np.empty(count + 1, dtype=np.int64), np.empty(count + 1, dtype=np.int64)
    starts(sides, pointed, length, vertex_start, face_start)
    shape = (points, lines.radius_m, ratio, factor)
    tubes = Tubes(*shape, lines.offset, kept, length, least, sides, pointed, vertex_start, face_start)
    vertices, faces = int(vertex_start[-1]), int(face_start[-1])
    position, normals, uv = (np.empty((vertices, k), np.float32) for k in (3, 3, 2))
    face = np.empty((faces, 3), np.uint32)
    surface = Surface(position, normals, uv, face)
    turns, tile = _ring_tables(sides), np.array(tile_m, dtype=np.float64)

    def part(first: int, end: int) -> int:
        return int(fill(first, end, tubes, tile, turns, surface))

    if sum(map_ranges(count, part)):  # neighbouring rings touched: a triangle without area is not one
        face = face[face[:, 0] != face[:, 1]]
    return Mesh(position, face, normals, uv), vertex_start


def _each(given: object, count: int, kind: type) -> NDArray[Any]:
    """One value each, from one for all or as many as there are."""
    return np.ascontiguousarray(np.broadcast_to(np.asarray(given, dtype=kind), count))


def _ring_tables(sides: Ints) -> Turns:
    """First row of each number of sides, and the cosines and sines round its ring."""
    most = int(sides.max(initial=3))
    used = np.flatnonzero(np.bincount(sides))
    first = np.zeros(most + 1, dtype=np.int64)
    first[used] = np.cumsum(used) - used
    angle = np.concatenate([np.arange(n) * (2.0 * np.pi / n) for n in used] or [np.zeros(0)])
    return Turns(first, np.cos(angle), np.sin(angle))
