"""Compiled loops of `geometry/sweep.py` that make the triangles; `sweep_points.py` has the loops before them."""

from __future__ import annotations

from math import pi, sin, sqrt
from typing import Any

import numpy as np

from forestgen.core.compiled import borrowed, contracted
from forestgen.geometry.sweep_points import HUB_SIDES, Vector, cross, dot, perpendicular, unit, way

_MOST_MITRE = 2.0
_LEVEL = 0.24  # share of a segment's length: rings that lean less along it need no look at the quads' diagonals
_EVEN = 0.85  # ratio of the rings' radii for the same
_ROOMY = 64.0  # rings of this many times the least radius over the sides are far from touching
_STEEP = 0.3  # sine of the angle from the vertical below which an elliptical section becomes round
_MOST_SLOPE = 4.0
_LEAST_FACTOR = 0.05
_ALIKE = 0.25  # square of the ratio of a quad's two triangles from which the first diagonal is good enough
_BETTER = 1.05  # the other diagonal of a quad is taken if its smaller triangle is this much larger


@contracted
def circumradius(sides: int) -> float:
    """Of the regular polygon whose area is that of the unit circle."""
    return sqrt(2.0 * pi / (sides * sin(2.0 * pi / sides)))


@contracted
def _ring_matrices(b: Vector, f: Vector, n: Vector, o: Vector, ratio: float) -> Any:
    """Matrix of a ring in its frame (normal n, binormal o), row by row, and its inverse transposed.

    An ellipse of unit area ratio, stretched by the mitre in the direction of the bend. Also how far the ring leans
    along the tube, at most, as a share of its radius.
    """
    e00, e01, e11, w00, w01, w11 = 1.0, 0.0, 1.0, 1.0, 0.0, 1.0
    upright = sqrt(n[2] * n[2] + o[2] * o[2])
    if ratio != 1.0 and upright > 1e-6:
        weight = min(1.0, upright / _STEEP)
        half = sqrt(ratio ** (weight * weight * (3.0 - 2.0 * weight)))
        x, y = n[2] / upright, o[2] / upright
        s = half - 1.0 / half
        e00, e01, e11 = 1.0 / half + s * x * x, s * x * y, 1.0 / half + s * y * y
        w00, w01, w11 = half - s * x * x, -s * x * y, half - s * y * y
    m00, m01, m10, m11 = e00, e01, e01, e11
    v00, v01, v10, v11 = w00, w01, w01, w11
    lean = 0.0 if ratio == 1.0 else 1e9
    if dot(b, b) > 0.0 and dot(f, f) > 0.0:
        bend = (f[0] - b[0], f[1] - b[1], f[2] - b[2])
        x, y = dot(bend, n), dot(bend, o)
        across = x * x + y * y
        if across > 1e-14:
            half_cosine = sqrt(max(0.0, 0.5 * (1.0 + dot(b, f))))
            inverse = 1.0 / max(half_cosine, 1.0 / _MOST_MITRE)
            lean += 0.5 * sqrt(across) * inverse  # the tangent of the half bend
            p, q = (inverse - 1.0) / across, (1.0 / inverse - 1.0) / across
            r0, r1 = x * e00 + y * e01, x * e01 + y * e11
            m00, m01, m10, m11 = e00 + p * x * r0, e01 + p * x * r1, e01 + p * y * r0, e11 + p * y * r1
            r0, r1 = x * w00 + y * w01, x * w01 + y * w11
            v00, v01, v10, v11 = w00 + q * x * r0, w01 + q * x * r1, w01 + q * y * r0, w11 + q * y * r1
    return (m00, m01, m10, m11, v00, v01, v10, v11), lean


@contracted
def _twice_area_squared(vertices: Any, a: int, b: int, c: int) -> float:
    ux = float(vertices[b, 0]) - float(vertices[a, 0])
    uy = float(vertices[b, 1]) - float(vertices[a, 1])
    uz = float(vertices[b, 2]) - float(vertices[a, 2])
    vx = float(vertices[c, 0]) - float(vertices[a, 0])
    vy = float(vertices[c, 1]) - float(vertices[a, 1])
    vz = float(vertices[c, 2]) - float(vertices[a, 2])
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return x * x + y * y + z * z


@contracted
def _face(vertices: Any, faces: Any, f: int, a: int, b: int, c: int) -> int:
    """Write a face; one without area is marked by equal corners. Returns the number of such."""
    empty = _twice_area_squared(vertices, a, b, c) == 0.0
    faces[f, 0], faces[f, 1], faces[f, 2] = a, a if empty else b, c
    return 1 if empty else 0


@contracted
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


@contracted
def _cap(
    vertices: Any, normals: Any, uv: Any, faces: Any, vertex: int, face: int, ring: int, sides: int,
    centre: Vector, n: Vector, o: Vector, facing: Vector, tile: Any,
) -> int:  # fmt: skip
    """A flat cap on a ring, with vertices of its own, seen from where `facing` points. Returns the empty ones' number.

    Texture coordinates are metres in the ring's plane over the tile's.
    """
    hub, scale, other_scale = sides >= HUB_SIDES, 1.0 / tile[0], 1.0 / tile[1]
    for j in range(sides + (1 if hub else 0)):
        at = vertex + j
        for k in range(3):
            vertices[at, k] = vertices[ring + j, k] if j < sides else centre[k]
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


@contracted
def _factor(factor: Any, i: int, j: int) -> Any:
    return max(factor[i, j], _LEAST_FACTOR)


@contracted
def _ring(
    vertices: Any, normals: Any, uv: Any, vertex: int, sides: int, centre: Vector, t: Vector, n: Vector, o: Vector,
    m: Any, size: Any, factor: Any, near: Any, turns: Any, texture: Any,
) -> None:  # fmt: skip
    """Vertices of one ring, the first once more at the end for the texture's seam.

    Parameters
    ----------
    size : radius here, before and after; distance from the ring before to the ring after; circumradius; least radius.
    near : point index here, of the ring before and of the ring after, for `factor`.
    turns : first row of the ring's cosines and sines, and these.
    texture : repeats round the tube, and v.
    """
    here, before, after, span, grown, least = size
    at, behind, ahead = near
    row, cosines, sines = turns
    shaped = factor.shape[0] > 0
    f, turning, slope = 1.0, 0.0, (after - before) / span
    for j in range(sides):
        c, s = cosines[row + j], sines[row + j]
        if shaped:
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


@contracted
def _single(x: float, y: float, z: float) -> Any:
    return np.float32(x), np.float32(y), np.float32(z)


@contracted
def _round_ring(
    vertices: Any, normals: Any, uv: Any, vertex: int, sides: int, centre: Vector, t: Vector, n: Vector, o: Vector,
    m: Any, length: float, slope: float, turns: Any, texture: Any,
) -> None:  # fmt: skip
    """As `_ring` for one radius all round: sums of the ring's own vectors, in one pass over flat arrays."""
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


@contracted
def _even_wall(faces: Any, face: int, lower: int, upper: int, sides: int) -> None:
    """As `_wall` where the first diagonal is known to be good: flat `faces`."""
    one, at = np.uint64(1), np.uint64(3 * face)
    a, d = np.uint32(lower), np.uint32(upper)
    for _ in range(sides):
        b, c = np.uint32(a + np.uint32(1)), np.uint32(d + np.uint32(1))
        faces[at] = a
        faces[at + one] = b
        faces[at + np.uint64(2)] = c
        faces[at + np.uint64(3)] = a
        faces[at + np.uint64(4)] = c
        faces[at + np.uint64(5)] = d
        a, d, at = b, c, at + np.uint64(6)


@contracted
def _tip(
    vertices: Any, normals: Any, uv: Any, faces: Any, vertex: int, face: int, ring: int, sides: int,
    point: Vector, texture: Any,
) -> int:  # fmt: skip
    """A fan from a ring to a point, which has a vertex, a normal and a u for each side. Returns the empty ones."""
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


@contracted
def _path(points: Any, kept: Any, begin: int, rings: int, count: int, path: Any) -> None:
    """Directions, lengths and frames of a cleaned tube, in loops short enough to overlap in the processor.

    Columns of `path`: 0 ... 2 way to the next point, 3 its length, 4 ... 6 tangent, 7 ... 9 normal, 10 ... 12 the
    second reflection, times the square root of its factor, 13 its share of the first reflection's vector.
    """
    for j in range(count - 1):
        path[j, 0], path[j, 1], path[j, 2], path[j, 3] = way(points, kept[begin + j], kept[begin + j + 1])
    x, y, z = path[0, 0], path[0, 1], path[0, 2]
    path[0, 4], path[0, 5], path[0, 6] = x, y, z
    n = perpendicular((x, y, z))
    path[0, 7], path[0, 8], path[0, 9] = n
    for j in range(1, rings):
        b = (path[j - 1, 0], path[j - 1, 1], path[j - 1, 2])
        f = (path[j, 0], path[j, 1], path[j, 2]) if j < count - 1 else b
        t = unit(b[0] + f[0], b[1] + f[1], b[2] + f[2])
        path[j, 4], path[j, 5], path[j, 6] = t
    for j in range(1, rings):
        b = (path[j - 1, 0], path[j - 1, 1], path[j - 1, 2])
        t = (path[j - 1, 4], path[j - 1, 5], path[j - 1, 6])
        along = 2.0 * dot(b, t)
        x = path[j, 4] - t[0] + along * b[0]
        y = path[j, 5] - t[1] + along * b[1]
        z = path[j, 6] - t[2] + along * b[2]
        square = x * x + y * y + z * z
        scale = sqrt(2.0 / square) if square > 1e-20 else 0.0
        x, y, z = x * scale, y * scale, z * scale
        path[j, 10], path[j, 11], path[j, 12] = x, y, z
        path[j, 13] = x * b[0] + y * b[1] + z * b[2]
    x, y, z = n
    for j in range(1, rings):  # the one loop in which a point waits for the one before
        ways = path[j - 1, 0] * x + path[j - 1, 1] * y + path[j - 1, 2] * z
        turns = path[j, 10] * x + path[j, 11] * y + path[j, 12] * z
        ways += ways
        turns -= ways * path[j, 13]
        x -= ways * path[j - 1, 0] + turns * path[j, 10]
        y -= ways * path[j - 1, 1] + turns * path[j, 11]
        z -= ways * path[j - 1, 2] + turns * path[j, 12]
        path[j, 7], path[j, 8], path[j, 9] = x, y, z
    for j in range(1, rings):
        x, y, z = path[j, 4], path[j, 5], path[j, 6]
        along = path[j, 7] * x + path[j, 8] * y + path[j, 9] * z
        n = unit(path[j, 7] - along * x, path[j, 8] - along * y, path[j, 9] - along * z)
        path[j, 7], path[j, 8], path[j, 9] = n


@contracted
def _matrices(path: Any, kept: Any, begin: int, rings: int, count: int, ratio: Any, matrix: Any) -> None:
    """`_ring_matrices` of a tube's rings: columns 0 ... 7, and 8 the lean."""
    for j in range(rings):
        forward = (path[j, 0], path[j, 1], path[j, 2])
        if j == 0 or j == count - 1:
            back, forward = forward, forward
        else:
            back = (path[j - 1, 0], path[j - 1, 1], path[j - 1, 2])
        n = (path[j, 7], path[j, 8], path[j, 9])
        o = cross((path[j, 4], path[j, 5], path[j, 6]), n)
        m, lean = _ring_matrices(back, forward, n, o, ratio[kept[begin + j]])
        for k in range(8):
            matrix[j, k] = m[k]
        matrix[j, 8] = lean


@contracted
def fill(
    first: int, end: int, points: Any, radius: Any, ratio: Any, factor: Any, tile: Any, offset: Any, kept: Any,
    count: Any, least: Any, sides_of: Any, pointed: Any, vertex_start: Any, face_start: Any, table: Any, cosines: Any,
    sines: Any, vertices: Any, normals: Any, uv: Any, faces: Any,
) -> int:  # fmt: skip
    """Rings, walls and ends of tubes first ... end. Returns how many triangles came out without area."""
    empty = 0
    none = (0.0, 0.0, 0.0)
    points, radius, ratio, factor = borrowed(points), borrowed(radius), borrowed(ratio), borrowed(factor)
    kept, cosines, sines, tile = borrowed(kept), borrowed(cosines), borrowed(sines), borrowed(tile)
    flat_vertices, flat_normals = borrowed(vertices.reshape(-1)), borrowed(normals.reshape(-1))
    flat_uv, flat_faces = borrowed(uv.reshape(-1)), borrowed(faces.reshape(-1))
    vertices, normals, uv, faces = borrowed(vertices), borrowed(normals), borrowed(uv), borrowed(faces)
    shaped = factor.shape[0] > 0
    single = np.stack((cosines, sines)).astype(np.float32)
    longest = 0
    for a in range(first, end):
        longest = max(longest, count[a])
    path, matrix = np.empty((longest, 14)), np.empty((longest, 9))
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
        t, n, o, centre = none, none, none, none
        _path(points, kept, begin, rings, count[a], path)
        _matrices(path, kept, begin, rings, count[a], ratio, matrix)
        before_m, v, lean_before, size_before = 0.0, 0.0, 0.0, 0.0
        roomy = _ROOMY * sides * least[a]
        for j in range(rings):
            i = kept[begin + j]
            behind, ahead = kept[begin + max(j - 1, 0)], kept[begin + min(j + 1, count[a] - 1)]
            ahead_m = path[j, 3] if j < count[a] - 1 else 0.0
            t, n = (path[j, 4], path[j, 5], path[j, 6]), (path[j, 7], path[j, 8], path[j, 9])
            o = cross(t, n)
            m = (
                matrix[j, 0], matrix[j, 1], matrix[j, 2], matrix[j, 3],
                matrix[j, 4], matrix[j, 5], matrix[j, 6], matrix[j, 7],
            )  # fmt: skip
            narrows = 0.0 if pointed[a] and j == rings - 1 else radius[ahead]
            centre = (points[i, 0], points[i, 1], points[i, 2])
            texture = (repeats, v / tile[1])
            size = max(radius[i], least[a])
            lean = size * grown * matrix[j, 8]
            if shaped:
                sizes = (radius[i], radius[behind], narrows, before_m + ahead_m, grown, least[a])
                _ring(
                    vertices, normals, uv, vertex, sides, centre, t, n, o, m, sizes, factor, (i, behind, ahead), turns,
                    texture,
                )  # fmt: skip
            else:
                slope = (narrows - radius[behind]) / (before_m + ahead_m)
                _round_ring(
                    flat_vertices, flat_normals, flat_uv, vertex, sides, centre, t, n, o, m, size * grown, slope,
                    round_turns, texture,
                )  # fmt: skip
            vertex += sides + 1
            if j == 0:
                facing = (-t[0], -t[1], -t[2])
                empty += _cap(
                    vertices, normals, uv, faces, vertex, face, vertex - sides - 1, sides, centre, n, o, facing, tile
                )  # fmt: skip
                ring = vertex - sides - 1
                vertex += sides + hub
                face += cap_faces
            else:
                even = (
                    not shaped
                    and lean + lean_before + abs(size - size_before) < _LEVEL * before_m
                    and min(size, size_before) > max(_EVEN * max(size, size_before), roomy)
                )
                if even:
                    _even_wall(flat_faces, face, ring, vertex - sides - 1, sides)
                else:
                    empty += _wall(vertices, faces, face, ring, vertex - sides - 1, sides)
                ring = vertex - sides - 1
                face += 2 * sides
            before_m, lean_before, size_before = ahead_m, lean, size
            v += ahead_m
        if pointed[a]:
            i = kept[begin + rings]
            point = (points[i, 0], points[i, 1], points[i, 2])
            texture = (repeats, v / tile[1])
            empty += _tip(vertices, normals, uv, faces, vertex, face, ring, sides, point, texture)
        else:
            empty += _cap(vertices, normals, uv, faces, vertex, face, ring, sides, centre, n, o, t, tile)
    return empty
