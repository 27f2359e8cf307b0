"""Compiled loops of `geometry/sweep.py` that make the triangles; `sweep_points.py` has the loops before them."""

from __future__ import annotations

from math import pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from forestgen.core.compiled import fma_njit, unowned_view
from forestgen.geometry.sweep_points import HUB_SIDES, Vector, cross, dot, fill_matrices, fill_path, unit

_MOST_SLOPE = 4.0
_LEAST_FACTOR = 0.05
_ALIKE = 0.25  # square of the ratio of a quad's two triangles from which the first diagonal is good enough
_BETTER = 1.05  # the other diagonal of a quad is taken if its smaller triangle is this much larger


class Tubes(NamedTuple):
    """A tubes as `sweep_tubes` describes them, with the points that `keep` has kept and where `starts` begins them."""

    points: Any  # (P, 3)
    radius: Any  # (P,)
    ratio: Any  # (P,) of a section's height to its width
    factor: Any  # (P, S) on the radii of a ring's vertices, or (0, 0)
    offset: Any  # (A + 1,)
    kept: Any  # (P,)
    count: Any  # (A,)
    least: Any  # (A,) radius
    sides: Any  # (A,)
    pointed: Any  # (A,)
    vertex_start: Any  # (A + 1,)
    face_start: Any  # (A + 1,)


class Turns(NamedTuple):
    """Directions round rings."""

    first: Any  # (most sides + 1,) row of each number of sides
    cosines: Any
    sines: Any


class Surface(NamedTuple):
    """What is written: the arrays of a `Mesh`."""

    vertices: Any
    normals: Any
    uv: Any
    faces: Any


class Ring(NamedTuple):
    """A ring's centre and frame: tangent, normal, binormal."""

    centre: Vector
    t: Vector
    n: Vector
    o: Vector


@fma_njit
def circumradius(sides: int) -> float:
    """Of the regular polygon whose area is that of the unit circle."""
    return sqrt(2.0 * pi / (sides * sin(2.0 * pi / sides)))


@fma_njit
def _twice_area_squared(vertices: Any, a: int, b: int, c: int) -> float:
    ux = float(vertices[b, 0]) - float(vertices[a, 0])
    uy = float(vertices[b, 1]) - float(vertices[a, 1])
    uz = float(vertices[b, 2]) - float(vertices[a, 2])
    vx = float(vertices[c, 0]) - float(vertices[a, 0])
    vy = float(vertices[c, 1]) - float(vertices[a, 1])
    vz = float(vertices[c, 2]) - float(vertices[a, 2])
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return x * x + y * y + z * z


@fma_njit
def _face(vertices: Any, faces: Any, f: int, a: int, b: int, c: int) -> int:
    """Write a face; one without area is marked by equal corners. Returns the number of such."""
    empty = _twice_area_squared(vertices, a, b, c) == 0.0
    faces[f, 0], faces[f, 1], faces[f, 2] = a, a if empty else b, c
    return 1 if empty else 0


@fma_njit
def _wall(vertices: Any, faces: Any, face: int, lower: int, upper: int, sides: int) -> int:
    """Two triangles per side between two rings, by the better diagonal where they differ. Returns the empty ones."""
    empty = 0
    for j in range(sides):
        a, b, c, d = lower + j, lower + j + 1, upper + j + 1, upper + j
        p, q = _twice_area_squared(vertices, a, b, c), _twice_area_squared(vertices, a, c, d)
        if min(p, q) < _ALIKE * max(p, q) or max(p, q) == 0.0:  # seldom: look at the other diagonal
            r, s = _twice_area_squared(vertices, a, b, d), _twice_area_squared(vertices, b, c, d)
            if min(r, s) > _BETTER * min(p, q):
                empty += _face(vertices, faces, face, a, b, d) + _face(vertices, faces, face + 1, b, c, d)
            else:
                empty += _face(vertices, faces, face, a, b, c) + _face(vertices, faces, face + 1, a, c, d)
        else:
            faces[face, 0], faces[face, 1], faces[face, 2] = a, b, c
            faces[face + 1, 0], faces[face + 1, 1], faces[face + 1, 2] = a, c, d
        face += 2
    return empty


@fma_njit
def _cap(
    out: Surface, vertex: int, face: int, first_of_ring: int, sides: int, ring: Ring, facing: Vector, tile: Any
) -> int:
    """A flat cap on a ring, with vertices of its own, seen from where `facing` points. Returns the empty ones' number.

    Texture coordinates are metres in the ring's plane over the tile's.
    """
    vertices, normals, uv, faces = out
    centre, _, n, o = ring
    hub, scale, other_scale = sides >= HUB_SIDES, 1.0 / tile[0], 1.0 / tile[1]
    for j in range(sides + (1 if hub else 0)):
        at = vertex + j
        for k in range(3):
            vertices[at, k] = vertices[first_of_ring + j, k] if j < sides else centre[k]
            normals[at, k] = facing[k]
        x, y, z = vertices[at, 0] - centre[0], vertices[at, 1] - centre[1], vertices[at, 2] - centre[2]
        uv[at, 0] = (x * n[0] + y * n[1] + z * n[2]) * scale
        uv[at, 1] = (x * o[0] + y * o[1] + z * o[2]) * other_scale
    upward = dot(cross(n, o), facing) > 0.0
    first, count, empty = (vertex + sides, sides, 0) if hub else (vertex, sides - 2, 0)
    for j in range(count):
        b, c = (vertex + j, vertex + (j + 1 if j + 1 < sides else 0)) if hub else (vertex + j + 1, vertex + j + 2)
        if upward:
            empty += _face(vertices, faces, face + j, first, b, c)
        else:
            empty += _face(vertices, faces, face + j, first, c, b)
    return empty


@fma_njit
def _factor(factor: Any, i: int, j: int) -> Any:
    return max(factor[i, j], _LEAST_FACTOR)


@fma_njit
def _ring(  # type: ignore[no-untyped-def]
    out, vertex, sides, ring, m, size, factor, near, turns, texture
):
    """Vertices of one ring, the first once more at the end for the texture's seam.

    `size`: radius here, before and after; distance from the ring before to the ring after; circumradius; least radius.
    `near`: point index here, of the ring before and of the ring after, for `factor`. `turns`: first row of the ring's
    cosines and sines, and these. `texture`: repeats round the tube, and v.
    """
    vertices, normals, uv, _ = out
    centre, t, n, o = ring
    here, before, after, span, grown, least = size
    at, behind, ahead = near
    row, cosines, sines = turns
    for j in range(sides):
        c, s = cosines[row + j], sines[row + j]
        f = _factor(factor, at, j)
        following, preceding = j + 1 if j + 1 < sides else 0, j - 1 if j > 0 else sides - 1
        turning = (_factor(factor, at, following) - _factor(factor, at, preceding)) / (4.0 * pi / sides)
        slope = (after * _factor(factor, ahead, j) - before * _factor(factor, behind, j)) / span
        inclined = -f * max(-_MOST_SLOPE, min(_MOST_SLOPE, slope))
        length = max(here * f, least) * grown
        x, y = (m[0] * c + m[1] * s) * length, (m[2] * c + m[3] * s) * length
        u, v = f * c + turning * s, f * s - turning * c
        p, q = m[4] * u + m[5] * v, m[6] * u + m[7] * v
        unit = 1.0 / sqrt(p * p + q * q + inclined * inclined)
        for k in range(3):
            vertices[vertex + j, k] = centre[k] + x * n[k] + y * o[k]
            normals[vertex + j, k] = (p * n[k] + q * o[k] + inclined * t[k]) * unit
        uv[vertex + j, 0] = texture[0] / sides * j
        uv[vertex + j, 1] = texture[1]
    for k in range(3):
        vertices[vertex + sides, k] = vertices[vertex, k]
        normals[vertex + sides, k] = normals[vertex, k]
    uv[vertex + sides, 0] = texture[0]
    uv[vertex + sides, 1] = texture[1]


@fma_njit
def _single(x: float, y: float, z: float) -> Any:
    return np.float32(x), np.float32(y), np.float32(z)


@fma_njit
def _round_ring(
    out: Surface, vertex: int, sides: int, ring: Ring, m: Any, length: float, slope: float, turns: Any, texture: Any
) -> None:
    """As `_ring` for one radius all round: sums of the ring's own vectors, in one pass over flat arrays."""
    vertices, normals, uv, _ = out
    centre, t, n, o = ring
    row, cosines, sines = turns
    inclined = -max(-_MOST_SLOPE, min(_MOST_SLOPE, slope))
    p, q = m[0] * length, m[2] * length
    ax, ay, az = _single(p * n[0] + q * o[0], p * n[1] + q * o[1], p * n[2] + q * o[2])
    p, q = m[1] * length, m[3] * length
    bx, by, bz = _single(p * n[0] + q * o[0], p * n[1] + q * o[1], p * n[2] + q * o[2])
    p, q = m[4], m[6]
    ex, ey, ez = _single(p * n[0] + q * o[0], p * n[1] + q * o[1], p * n[2] + q * o[2])
    p, q = m[5], m[7]
    fx, fy, fz = _single(p * n[0] + q * o[0], p * n[1] + q * o[1], p * n[2] + q * o[2])
    gx, gy, gz = _single(inclined * t[0], inclined * t[1], inclined * t[2])
    cx, cy, cz = _single(centre[0], centre[1], centre[2])
    u, step, v = np.float32(0.0), np.float32(texture[0] / sides), np.float32(texture[1])
    at, flat, first = np.uint64(3 * vertex), np.uint64(2 * vertex), np.uint64(row)
    one, two, three, whole = np.uint64(1), np.uint64(2), np.uint64(3), np.float32(1.0)
    for _ in range(sides):
        c, s = cosines[first], sines[first]
        x, y, z = ex * c + fx * s + gx, ey * c + fy * s + gy, ez * c + fz * s + gz
        unit = whole / sqrt(x * x + y * y + z * z)
        vertices[at] = cx + (c * ax + s * bx)
        vertices[at + one] = cy + (c * ay + s * by)
        vertices[at + two] = cz + (c * az + s * bz)
        normals[at], normals[at + one], normals[at + two] = x * unit, y * unit, z * unit
        uv[flat], uv[flat + one] = u, v
        at, flat, first, u = at + three, flat + two, first + one, u + step
    uv[flat], uv[flat + one] = texture[0], v
    seam = np.uint64(3 * vertex)
    for _ in range(3):
        vertices[at], normals[at] = vertices[seam], normals[seam]
        at, seam = at + one, seam + one


@fma_njit
def _tip(out: Surface, vertex: int, face: int, ring: int, sides: int, point: Vector, texture: Any) -> int:
    """A fan from a ring to a point, which has a vertex, a normal and a u for each side. Returns the empty ones."""
    vertices, normals, uv, faces = out
    empty, step = 0, texture[0] / sides
    for j in range(sides):
        at, a = vertex + j, ring + j
        mean = unit(
            normals[a, 0] + normals[a + 1, 0], normals[a, 1] + normals[a + 1, 1], normals[a, 2] + normals[a + 1, 2]
        )
        for k in range(3):
            vertices[at, k] = point[k]
            normals[at, k] = mean[k] if dot(mean, mean) > 0.5 else normals[a, k]
        uv[at, 0] = step * (j + 0.5)
        uv[at, 1] = texture[1]
        empty += _face(vertices, faces, face + j, a, a + 1, at)
    return empty


@fma_njit
def fill(first: int, end: int, tubes: Tubes, tile: Any, turns_of: Turns, out: Surface) -> int:
    """Rings, walls and ends of tubes first ... end. Returns how many triangles came out without area."""
    empty = 0
    none = (0.0, 0.0, 0.0)
    points, radius, ratio, factor, offset, kept, count, least, sides_of, pointed, vertex_start, face_start = (
        unowned_view(tubes)
    )
    table, cosines, sines = unowned_view(turns_of)
    tile, out = unowned_view(tile), unowned_view(out)
    vertices, faces = out.vertices, out.faces
    flat = Surface(vertices.reshape(-1), out.normals.reshape(-1), out.uv.reshape(-1), faces.reshape(-1))
    shaped = factor.shape[0] > 0
    single = np.stack((cosines, sines)).astype(np.float32)
    longest = 0
    for a in range(first, end):
        longest = max(longest, count[a])
    path, matrix = np.empty((longest, 14)), np.empty((longest, 8))
    for a in range(first, end):
        if count[a] == 0:
            continue
        sides, begin = sides_of[a], offset[a]
        rings = count[a] - (1 if pointed[a] else 0)
        hub = 1 if sides >= HUB_SIDES else 0
        cap_faces = sides if hub else sides - 2
        grown = circumradius(sides)
        repeats = max(1.0, float(round(2.0 * pi * radius[kept[begin]] / tile[0])))
        turns = (table[sides], cosines, sines)
        round_turns = (table[sides], single[0], single[1])
        vertex, face, ring = vertex_start[a], face_start[a], vertex_start[a]
        frame = Ring(none, none, none, none)
        fill_path(points, kept, begin, rings, count[a], path)
        fill_matrices(path, kept, begin, rings, count[a], ratio, matrix)
        before_m, v = 0.0, 0.0
        for j in range(rings):
            i = kept[begin + j]
            behind, ahead = kept[begin + max(j - 1, 0)], kept[begin + min(j + 1, count[a] - 1)]
            ahead_m = path[j, 3] if j < count[a] - 1 else 0.0
            t, n = (path[j, 4], path[j, 5], path[j, 6]), (path[j, 7], path[j, 8], path[j, 9])
            m = (
                matrix[j, 0], matrix[j, 1], matrix[j, 2], matrix[j, 3],
                matrix[j, 4], matrix[j, 5], matrix[j, 6], matrix[j, 7],
            )  # fmt: skip
            narrows = 0.0 if pointed[a] and j == rings - 1 else radius[ahead]
            frame = Ring((points[i, 0], points[i, 1], points[i, 2]), t, n, cross(t, n))
            texture = (repeats, v / tile[1])
            if shaped:
                sizes = (radius[i], radius[behind], narrows, before_m + ahead_m, grown, least[a])
                _ring(out, vertex, sides, frame, m, sizes, factor, (i, behind, ahead), turns, texture)
            else:
                slope = (narrows - radius[behind]) / (before_m + ahead_m)
                length = max(radius[i], least[a]) * grown
                _round_ring(flat, vertex, sides, frame, m, length, slope, round_turns, texture)
            vertex += sides + 1
            if j == 0:
                facing = (-t[0], -t[1], -t[2])
                empty += _cap(out, vertex, face, vertex - sides - 1, sides, frame, facing, tile)
                ring = vertex - sides - 1
                vertex += sides + hub
                face += cap_faces
            else:
                empty += _wall(vertices, faces, face, ring, vertex - sides - 1, sides)
                ring = vertex - sides - 1
                face += 2 * sides
            before_m = ahead_m
            v += ahead_m
        if pointed[a]:
            i = kept[begin + rings]
            point = (points[i, 0], points[i, 1], points[i, 2])
            texture = (repeats, v / tile[1])
            empty += _tip(out, vertex, face, ring, sides, point, texture)
        else:
            empty += _cap(out, vertex, face, ring, sides, frame, frame.t, tile)
    return empty
