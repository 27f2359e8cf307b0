"""The feedback loop of `model.py`, compiled: one walk along each axis, bearers before what they bear.

Rotations are unit quaternions (w, x, y, z). A node's place is kept as its shift from the base skeleton, so that an
axis that nothing turns comes out to the bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from forestgen.core.compiled import compiled
from forestgen.geometry.mesh import Floats, Ints

_SENSED_RAD = 1e-12  # an error below this is none


class NewNodes(NamedTuple):
    """What N nodes of a base skeleton became: M nodes, those inserted among them."""

    new_of: Ints  # (N,) new index of each node of the base
    piece_of: Ints  # (N,) new index of the first piece of its segment
    point_m: Floats  # (M, 3) the new node's place on the base
    shift_m: Floats  # (M, 3) its way from there
    quaternion: Floats  # (M, 4) rotation of the piece that ends in it, w x y z
    source: Ints  # (M,) node of the base on whose segment it lies
    share: Floats  # (M,) where on that segment, 1 at the node itself


@compiled
def _rotor(x, y, z):  # type: ignore[no-untyped-def]
    """Quaternion of a rotation vector in radians."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    s = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), s * x, s * y, s * z


@compiled
def _after(a, b):  # type: ignore[no-untyped-def]
    """Quaternion of rotation b followed by rotation a."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale


@compiled
def _moved(q, x, y, z):  # type: ignore[no-untyped-def]
    """How far the rotation q moves a vector: exactly zero where q turns nothing."""
    a, b, c = q[2] * z - q[3] * y, q[3] * x - q[1] * z, q[1] * y - q[2] * x
    return (
        2.0 * (q[0] * a + q[2] * c - q[3] * b),
        2.0 * (q[0] * b + q[3] * a - q[1] * c),
        2.0 * (q[0] * c + q[1] * b - q[2] * a),
    )


@compiled
def _turned(q, x, y, z):  # type: ignore[no-untyped-def]
    """A vector after the rotation q."""
    a, b, c = _moved(q, x, y, z)
    return x + a, y + b, z + c


@compiled
def _across(x, y, z, angle, azimuth):  # type: ignore[no-untyped-def]
    """Vector of length `angle` perpendicular to the unit vector (x, y, z), turned about it by `azimuth`."""
    if abs(z) < 0.9:
        scale = 1.0 / math.sqrt(x * x + y * y)
        a, b, c = -y * scale, x * scale, 0.0
    else:
        scale = 1.0 / math.sqrt(y * y + z * z)
        a, b, c = 0.0, -z * scale, y * scale
    u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
    cosine, sine = angle * math.cos(azimuth), angle * math.sin(azimuth)
    return cosine * a + sine * u, cosine * b + sine * v, cosine * c + sine * w


@compiled
def _error(h, t):  # type: ignore[no-untyped-def]
    """Rotation vector from the unit direction h to the unit direction t, the shorter way."""
    x, y, z = h[1] * t[2] - h[2] * t[1], h[2] * t[0] - h[0] * t[2], h[0] * t[1] - h[1] * t[0]
    sine, cosine = math.sqrt(x * x + y * y + z * z), h[0] * t[0] + h[1] * t[1] + h[2] * t[2]
    if sine > _SENSED_RAD:
        scale = math.atan2(sine, cosine) / sine
        return scale * x, scale * y, scale * z
    if cosine > 0.0:
        return 0.0, 0.0, 0.0
    return _across(h[0], h[1], h[2], math.pi, 0.0)  # straight back: any way round is as short


@compiled
def _target(b, bearing, turn, weight, toward):  # type: ignore[no-untyped-def]
    """H_tar: the base's direction b in the frame `bearing`, turned as a function asks, then drawn to `toward`."""
    x, y, z = _turned(bearing, b[0], b[1], b[2])
    if turn[0] != 0.0 or turn[1] != 0.0 or turn[2] != 0.0:
        a, b_, c = _turned(bearing, turn[0], turn[1], turn[2])
        x, y, z = _turned(_rotor(a, b_, c), x, y, z)
    if weight != 0.0:
        u = (1.0 - weight) * x + weight * toward[0]
        v = (1.0 - weight) * y + weight * toward[1]
        w = (1.0 - weight) * z + weight * toward[2]
        length = math.sqrt(u * u + v * v + w * w)
        if length > 1e-9:
            x, y, z = u / length, v / length, w / length
    return x, y, z


@compiled
def _heading(position, j, last, c, tolerance, before):  # type: ignore[no-untyped-def]
    """Unit direction of the base ahead of the point c on the segment of node j; `before` where nothing is ahead."""
    x, y, z = c
    for i in range(j, last):
        dx, dy, dz = position[i, 0] - x, position[i, 1] - y, position[i, 2] - z
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length > tolerance:
            return dx / length, dy / length, dz / length
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
    return before


@compiled
def _respond(q, bearing, b, r, row, disturbance, turn):  # type: ignore[no-untyped-def]
    """G(s): the tip's rotation after the expired signals r and this step's disturbances; q itself if there are none."""
    if r[0] != 0.0 or r[1] != 0.0 or r[2] != 0.0:
        q = _after(q, _rotor(r[0], r[1], r[2]))
    if len(disturbance) and disturbance[row, 0] != 0.0:
        x, y, z = _across(b[0], b[1], b[2], disturbance[row, 0], disturbance[row, 1])
        q = _after(q, _rotor(x, y, z))
    if len(turn) and (turn[row, 0] != 0.0 or turn[row, 1] != 0.0 or turn[row, 2] != 0.0):
        x, y, z = _turned(bearing, turn[row, 0], turn[row, 1], turn[row, 2])
        q = _after(_rotor(x, y, z), q)
    return q


@compiled
def _sense(q, b, t, row, sensor):  # type: ignore[no-untyped-def]
    """Rotation vector from the sensed direction of growth to the target t."""
    h = _turned(q, b[0], b[1], b[2])
    if len(sensor) and sensor[row, 0] != 0.0:
        x, y, z = _across(h[0], h[1], h[2], sensor[row, 0], sensor[row, 1])
        h = _turned(_rotor(x, y, z), h[0], h[1], h[2])
    return _error(h, t)


@compiled
def walk(position, axes, tables, gains, local, toward, new, signal):  # type: ignore[no-untyped-def]
    """Walk along every axis; returns the number of nodes of the varied skeleton.

    `position`: (N, 3) base skeleton, metres. `axes`, `tables`: see `model.py`. `gains`: derivative, integral. `local`:
    T_M is the bearer's rotation, not the identity. `toward`: unit vector to which targets are drawn. `new`: out, with
    room for all nodes. `signal`: (longest axis, 3) scratch.
    """
    first, last, bearer, hidden, arc = axes.first, axes.last, axes.bearer, axes.hidden_m, axes.arc_m
    steps, begin, life, kappa, age, sensor, disturbance, turn, target, weight, whole, until = tables
    new_of, piece_of, shift, quaternion = new.new_of, new.piece_of, new.shift_m, new.quaternion
    still = (1.0, 0.0, 0.0, 0.0)
    made = 0
    for a in range(len(first)):
        j, beyond, n = first[a], last[a], steps[a]
        if bearer[a] >= 0:
            i = new_of[bearer[a]]
            q = (quaternion[i, 0], quaternion[i, 1], quaternion[i, 2], quaternion[i, 3])
            s = (shift[i, 0], shift[i, 1], shift[i, 2])
            c = (position[bearer[a], 0], position[bearer[a], 1], position[bearer[a], 2])
        else:
            q, s, c = still, (0.0, 0.0, 0.0), (position[j, 0], position[j, 1], position[j, 2])
            new_of[j] = piece_of[j] = made
            made = _write(made, s, q, c, j, 1.0, new)
            j += 1
        bearing = q if local else still
        past = _rotor(whole[a, 0], whole[a, 1], whole[a, 2])
        if until[a] > 0:
            q = _after(past, q)
        total = arc[beyond - 1]
        tolerance = 1e-9 * total
        at = part = 0.0
        divided = waiting = False  # pieces of segment j are made; the last step ended between two nodes of the base
        b = (0.0, 0.0, 1.0)
        error = total_error = (0.0, 0.0, 0.0)
        oldest = 0
        for k in range(max(n, 1)):
            if j >= beyond:
                break
            if n > 0:
                row = begin[a] + k
                r = (0.0, 0.0, 0.0)
                while oldest < k and age[row - 1] - age[begin[a] + oldest] >= life[a] - 1e-9:
                    r = (r[0] + signal[oldest, 0], r[1] + signal[oldest, 1], r[2] + signal[oldest, 2])
                    oldest += 1
                b = _heading(position, j, beyond, c, tolerance, b)
                old, q = q, _respond(q, bearing, b, r, row, disturbance, turn)
                if waiting and (q[0] != old[0] or q[1] != old[1] or q[2] != old[2] or q[3] != old[3]):
                    if not divided:
                        piece_of[j] = made
                        divided = True
                    made = _write(made, s, old, c, j, part, new)
                waiting = False
                bend = (target[row, 0], target[row, 1], target[row, 2]) if len(target) else (0.0, 0.0, 0.0)
                t = _target(b, bearing, bend, weight[row] if len(weight) else 0.0, toward)
                if k < until[a]:
                    t = _turned(past, t[0], t[1], t[2])
                before, error = error, _sense(q, b, t, row, sensor)
                if k == 0:
                    before = error
                total_error = (total_error[0] + error[0], total_error[1] + error[1], total_error[2] + error[2])
                signal[k, 0], signal[k, 1], signal[k, 2] = _turned(
                    (q[0], -q[1], -q[2], -q[3]),
                    kappa[a] * error[0] + gains[0] * (error[0] - before[0]) + gains[1] * total_error[0],
                    kappa[a] * error[1] + gains[0] * (error[1] - before[1]) + gains[1] * total_error[1],
                    kappa[a] * error[2] + gains[0] * (error[2] - before[2]) + gains[1] * total_error[2],
                )
            ends = k >= n - 1
            end = total if ends else hidden[a] + (k + 1) * ((total - hidden[a]) / n)
            while j < beyond and (ends or arc[j] <= end + tolerance):
                p = (position[j, 0], position[j, 1], position[j, 2])
                s, c, at = _advanced(s, q, c, p), p, arc[j]
                if not divided:
                    piece_of[j] = made
                new_of[j] = made
                made = _write(made, s, q, c, j, 1.0, new)
                divided = False
                j += 1
            if not ends and end - at > tolerance:
                f = (end - at) / (arc[j] - at)
                p = (
                    c[0] + f * (position[j, 0] - c[0]),
                    c[1] + f * (position[j, 1] - c[1]),
                    c[2] + f * (position[j, 2] - c[2]),
                )
                s, c, at = _advanced(s, q, c, p), p, end
                part = 1.0 - (arc[j] - end) / (arc[j] - (arc[j - 1] if j > first[a] else 0.0))
                waiting = True
    return made


@compiled
def _advanced(s, q, c, p):  # type: ignore[no-untyped-def]
    """Shift at the point p of the base, from that at c: the piece between is turned by q."""
    x, y, z = _moved(q, p[0] - c[0], p[1] - c[1], p[2] - c[2])
    return s[0] + x, s[1] + y, s[2] + z


@compiled
def _write(made, s, q, c, j, part, new):  # type: ignore[no-untyped-def]
    """Set row `made` of the new nodes; returns the next one."""
    for i in range(3):
        new.shift_m[made, i], new.point_m[made, i] = s[i], c[i]
    for i in range(4):
        new.quaternion[made, i] = q[i]
    new.source[made] = j
    new.share[made] = part
    return made + 1


@compiled
def carry(frame, node, base_start, base_end, new, out, new_node):  # type: ignore[no-untyped-def]
    """Organs moved stiffly with the piece of their segment at which their foot is; frame, out : (M, 3, 4)."""
    quaternion, point, shift = new.quaternion, new.point_m, new.shift_m
    for i in range(len(frame)):
        j = node[i]
        along = length = 0.0
        for c in range(3):
            way = base_end[j, c] - base_start[j, c]
            along += way * (frame[i, c, 3] - base_start[j, c])
            length += way * way
        part = along / length if length > 0.0 else 1.0
        p = new.piece_of[j]
        while p < new.new_of[j] and new.share[p] < part - 1e-6:
            p += 1
        q = (quaternion[p, 0], quaternion[p, 1], quaternion[p, 2], quaternion[p, 3])
        for column in range(4):
            x, y, z = frame[i, 0, column], frame[i, 1, column], frame[i, 2, column]
            if column == 3:
                dx, dy, dz = _moved(q, x - point[p, 0], y - point[p, 1], z - point[p, 2])
                dx, dy, dz = dx + shift[p, 0], dy + shift[p, 1], dz + shift[p, 2]
            else:
                dx, dy, dz = _moved(q, x, y, z)
            out[i, 0, column], out[i, 1, column], out[i, 2, column] = x + dx, y + dy, z + dz
        new_node[i] = p
