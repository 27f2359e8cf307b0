"""Compiled loops of `geometry/sweep.py` over points: which are meshed, their frames, where each tube's mesh starts."""

from __future__ import annotations

from math import sqrt
from typing import Any

from forestgen.core.compiled import fma_njit

HUB_SIDES = 8  # from this many sides on, a cap is a fan about its centre, so that a star-shaped ring is capped well
_RESOLUTION = 2.0**-20  # share of the greatest coordinate: eight times the spacing of float32
_LEAST_M = 1e-9
_MOST_MITRE = 2.0
_STEEP = 0.3  # sine of the angle from the vertical below which an elliptical section becomes round
_TURNS_BACK = -0.98  # cosine of the turn beyond which a line folds back on itself

Vector = tuple[float, float, float]


@fma_njit
def unit(x: float, y: float, z: float) -> Vector:
    length = sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    scale = 1.0 / length
    return x * scale, y * scale, z * scale


@fma_njit
def way(points: Any, i: int, j: int) -> tuple[float, float, float, float]:
    """Unit vector from point i to point j, and their distance."""
    x, y, z = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
    length = sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    scale = 1.0 / length
    return x * scale, y * scale, z * scale, length


@fma_njit
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@fma_njit
def perpendicular(a: Vector) -> Any:
    """A unit vector at right angles to `a`, taken against the world axis that is least aligned with it."""
    x, y, z = abs(a[0]), abs(a[1]), abs(a[2])
    if x <= y and x <= z:
        return unit(0.0, a[2], -a[1])
    if y <= z:
        return unit(-a[2], 0.0, a[0])
    return unit(a[1], -a[0], 0.0)


@fma_njit
def _bisector(b: Vector, f: Vector) -> Any:
    """Tangent where unit vectors `b` (to the point) and `f` (from it) meet; a zero vector is a missing segment."""
    t = unit(b[0] + f[0], b[1] + f[1], b[2] + f[2])
    if t[0] == 0.0 and t[1] == 0.0 and t[2] == 0.0 and dot(b, b) > 0.0:
        return perpendicular(b)  # straight back
    return t


@fma_njit
def _carried(way: Vector, t0: Vector, t1: Vector, r0: Vector) -> Any:
    """Reference vector at the way's end: reflected in the plane that halves the way, then in one that aligns t1."""
    along = 2.0 * dot(way, r0)
    r = (r0[0] - along * way[0], r0[1] - along * way[1], r0[2] - along * way[2])
    along = 2.0 * dot(way, t0)
    turn = (t1[0] - t0[0] + along * way[0], t1[1] - t0[1] + along * way[1], t1[2] - t0[2] + along * way[2])
    square = dot(turn, turn)
    if square > 1e-20:
        along = 2.0 * dot(turn, r) / square
        r = (r[0] - along * turn[0], r[1] - along * turn[1], r[2] - along * turn[2])
    along = dot(r, t1)
    n = unit(r[0] - along * t1[0], r[1] - along * t1[1], r[2] - along * t1[2])
    return n if dot(n, n) > 0.5 else perpendicular(t1)


@fma_njit
def frames(points: Any, offset: Any, tangent: Any, normal: Any) -> None:
    """Tangents and carried normals of all points; a point that repeats the one before has that one's frame."""
    for a in range(len(offset) - 1):
        back = (0.0, 0.0, 0.0)
        t, n = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for i in range(offset[a], offset[a + 1]):
            j = i + 1
            forward = (0.0, 0.0, 0.0)
            while j < offset[a + 1]:
                x, y, z, length = way(points, i, j)
                if length > 0.0:
                    forward = (x, y, z)
                    break
                j += 1
            if i > offset[a]:
                x, y, z, length = way(points, i - 1, i)
                if length > 0.0:
                    back = (x, y, z)
                    following = _bisector(back, forward)
                    n = _carried(back, t, following, n)
                    t = following
            else:
                t = forward if dot(forward, forward) > 0.0 else (0.0, 0.0, 1.0)
                n = perpendicular(t)
            for k in range(3):
                tangent[i, k] = t[k]
                normal[i, k] = n[k]


@fma_njit
def keep(points: Any, radius: Any, offset: Any, kept: Any, count: Any, least: Any) -> None:
    """Points of each tube that are meshed: ``kept[offset[a] : offset[a] + count[a]]``; count 0: no tube.

    Left out are points that repeat the one before and points at which the line folds back on itself. `least` becomes
    the smallest radius of a tube.
    """
    for a in range(len(offset) - 1):
        begin, end = offset[a], offset[a + 1]
        greatest, thickest = 0.0, 0.0
        for i in range(begin, end):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            thickest = max(thickest, radius[i])
            greatest = max(greatest, max(abs(x), max(abs(y), abs(z))))
        floor = max(_LEAST_M, _RESOLUTION * (greatest + thickest))
        least[a] = floor
        top = begin
        for i in range(begin, end):
            while top > begin:
                x, y, z, length = way(points, kept[top - 1], i)
                if length < 2.0 * floor:
                    break
                if top - begin < 2:
                    break
                b = way(points, kept[top - 2], kept[top - 1])
                if b[0] * x + b[1] * y + b[2] * z > _TURNS_BACK:
                    break
                top -= 1
            if top > begin and way(points, kept[top - 1], i)[3] < 2.0 * floor:
                continue
            kept[top] = i
            top += 1
        count[a] = top - begin if top - begin >= 2 and thickest >= floor else 0


@fma_njit
def starts(sides_of: Any, pointed: Any, count: Any, vertex_start: Any, face_start: Any) -> None:
    """First vertex and first face of each tube, and the totals; (A + 1,) each. `fill` fills in this order."""
    vertex, face = 0, 0
    for a in range(len(count)):
        vertex_start[a], face_start[a] = vertex, face
        if count[a] > 0:
            sides, hub = sides_of[a], 1 if sides_of[a] >= HUB_SIDES else 0
            cap_vertices, cap_faces = sides + hub, sides if hub else sides - 2
            rings = count[a] - (1 if pointed[a] else 0)
            vertex += rings * (sides + 1) + cap_vertices + (sides if pointed[a] else cap_vertices)
            face += 2 * sides * (rings - 1) + cap_faces + (sides if pointed[a] else cap_faces)
    vertex_start[len(count)], face_start[len(count)] = vertex, face


@fma_njit
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@fma_njit
def _ring_matrices(b: Vector, f: Vector, n: Vector, o: Vector, ratio: float) -> Any:
    """Matrix of a ring in its frame (normal n, binormal o), row by row, and its inverse transposed.

    An ellipse of unit area ratio, stretched by the mitre in the direction of the bend.
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
    if dot(b, b) > 0.0 and dot(f, f) > 0.0:
        bend = (f[0] - b[0], f[1] - b[1], f[2] - b[2])
        x, y = dot(bend, n), dot(bend, o)
        across = x * x + y * y
        if across > 1e-14:
            half_cosine = sqrt(max(0.0, 0.5 * (1.0 + dot(b, f))))
            inverse = 1.0 / max(half_cosine, 1.0 / _MOST_MITRE)
            p, q = (inverse - 1.0) / across, (1.0 / inverse - 1.0) / across
            r0, r1 = x * e00 + y * e01, x * e01 + y * e11
            m00, m01, m10, m11 = e00 + p * x * r0, e01 + p * x * r1, e01 + p * y * r0, e11 + p * y * r1
            r0, r1 = x * w00 + y * w01, x * w01 + y * w11
            v00, v01, v10, v11 = w00 + q * x * r0, w01 + q * x * r1, w01 + q * y * r0, w11 + q * y * r1
    return m00, m01, m10, m11, v00, v01, v10, v11


@fma_njit
def fill_path(points: Any, kept: Any, begin: int, rings: int, count: int, path: Any) -> None:
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


@fma_njit
def fill_matrices(path: Any, kept: Any, begin: int, rings: int, count: int, ratio: Any, matrix: Any) -> None:
    """`_ring_matrices` of a tube's rings: columns 0 ... 7."""
    for j in range(rings):
        forward = (path[j, 0], path[j, 1], path[j, 2])
        if j == 0 or j == count - 1:
            back, forward = forward, forward
        else:
            back = (path[j - 1, 0], path[j - 1, 1], path[j - 1, 2])
        n = (path[j, 7], path[j, 8], path[j, 9])
        o = cross((path[j, 4], path[j, 5], path[j, 6]), n)
        m = _ring_matrices(back, forward, n, o, ratio[kept[begin + j]])
        for k in range(8):
            matrix[j, k] = m[k]
