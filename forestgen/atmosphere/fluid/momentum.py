"""Forces on the wind: its own advection and viscosity, and the confinement of its eddies.

All arrays have two ghost cells on each side (see `pressure`).

Advection. Fluxes of third order, biased upwind, unlimited (Wicker & Skamarock 2002). Each component stands on its own
faces; the fluxes through the faces between these carry it, with the mean of the two velocities at either side. What
leaves one cell enters the next, so momentum is conserved, and an even wind stays even.

Confinement. The upwind part of the fluxes damps eddies of a few cells. Vorticity confinement (Steinhoff & Underhill
1994; Fedkiw, Stam & Jensen 2001) pushes along N x omega, N being the direction in which the vorticity's size grows:
eddies that are there stay, and still air stays still. The acceleration here is strength x cell x |omega| N x omega. The
published form lacks |omega|, so its strength is per second; with it one strength serves all cells and winds. omega is
what is left when the mean of each layer is taken away, and ends two cells from terrain: the shear of the mean wind and
the wind that slows down at walls are no eddies. It adds energy; 0: none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import AXES, Velocity
from forestgen.atmosphere.grid import AirGrid
from forestgen.core.compiled import unchecked, unowned_view
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_TWO, _THREE, _SEVEN = np.float32(2), np.float32(3), np.float32(7)
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
_TINY_PER_S = np.float32(1e-6)  # growth of vorticity across a cell that is taken for none


def advance_velocity(
    base: Sequence[Field],
    carrier: Sequence[Field],
    out: Sequence[Field],
    step_s: float,
    cell_m: tuple[float, float, float],
    viscosity_m2_per_s: float,
) -> None:
    """out = base + step x (advection and viscosity of the divergence-free carrier), m/s; `out` may be `base`."""
    layers, rows, columns = carrier[0].shape
    step = np.float32(step_s)
    per_m = tuple(np.float32(1.0 / (24.0 * side)) for side in cell_m)
    smooth = tuple(np.float32(viscosity_m2_per_s / side**2) for side in cell_m)
    for axis, back in enumerate(AXES):

        def work(first: int, end: int, axis: int = axis, back: tuple[int, int, int] = back) -> None:
            _advance(carrier[axis], base[axis], out[axis], *carrier, back, step, per_m, smooth, first + 2, end + 2)

        over_slabs(layers - 4, (rows - 4) * (columns - 4), work)


@unchecked
def _advance(q, base, out, u, v, w, back, step, per_m, smooth, first, end):  # type: ignore[no-untyped-def]
    """One component in layers [first, end). `back` points from a face to the one before it along the component."""
    q, base, out, u, v, w = unowned_view((q, base, out, u, v, w))
    rows, columns = q.shape[1], q.shape[2]
    n = columns - 4
    below, above = np.empty((rows, n), np.float32), np.empty((rows, n), np.float32)
    south, north, east = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n + 1, np.float32)
    viscous = smooth[0] > 0.0
    for j in range(2, rows - 2):
        _flux(below[j], q, w, back, AXES[2], per_m[2], first, j)
    for k in range(first, end):
        _flux(south, q, v, back, AXES[1], per_m[1], k, 2)
        for j in range(2, rows - 2):
            _flux(east, q, u, back, AXES[0], per_m[0], k, j)
            _flux(north, q, v, back, AXES[1], per_m[1], k, j + 1)
            _flux(above[j], q, w, back, AXES[2], per_m[2], k + 1, j)
            to = out[k, j, 2 : n + 2]
            _gather(to, base[k, j, 2 : n + 2], step, east, south, north, below[j], above[j])
            if viscous:
                _smooth_along(to, q[k, j, 1 : n + 1], q[k, j, 2 : n + 2], q[k, j, 3 : n + 3], step * smooth[0])
                here = q[k, j, 2 : n + 2]
                _smooth_along(to, q[k, j - 1, 2 : n + 2], here, q[k, j + 1, 2 : n + 2], step * smooth[1])
                if k == 2 and back[0] == 0:
                    _brake(to, here, q[k + 1, j, 2 : n + 2], step * smooth[2])
                else:
                    _smooth_along(to, q[k - 1, j, 2 : n + 2], here, q[k + 1, j, 2 : n + 2], step * smooth[2])
            south, north = north, south
        below, above = above, below


@unchecked
def _flux(out, q, velocity, back, along, per_m, k, j):  # type: ignore[no-untyped-def]
    """Flux of q along an axis into the row k, j; values a, b | c, d, velocity of two faces."""
    n, (z, y, x) = out.size, along
    one, two = velocity[k, j, 2 : n + 2], velocity[k - back[0], j - back[1], 2 - back[2] : 2 - back[2] + n]
    a, b = q[k - 2 * z, j - 2 * y, 2 - 2 * x : 2 - 2 * x + n], q[k - z, j - y, 2 - x : 2 - x + n]
    c, d = q[k, j, 2 : n + 2], q[k + z, j + y, 2 + x : 2 + x + n]
    for i in range(n):
        speed = (one[i] + two[i]) * per_m
        even, odd = _SEVEN * (b[i] + c[i]) - (a[i] + d[i]), (d[i] - a[i]) - _THREE * (c[i] - b[i])
        out[i] = speed * even + abs(speed) * odd


@unchecked
def _gather(out, base, step, east, south, north, below, above):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] = base[i] + step * ((east[i] - east[i + 1]) + (south[i] - north[i]) + (below[i] - above[i]))


@unchecked
def _smooth_along(out, before, here, after, weight):  # type: ignore[no-untyped-def]
    for i in range(out.size):
        out[i] += weight * ((before[i] + after[i]) - _TWO * here[i])


@unchecked
def _brake(out, here, above, weight):  # type: ignore[no-untyped-def]
    """The same in the lowest layer: below it is its own wind with the sign turned, so that the ground's is 0."""
    for i in range(out.size):
        out[i] += weight * (above[i] - _THREE * here[i])


class Confinement:
    """Work space of one grid. `strength` is dimensionless."""

    def __init__(self, grid: AirGrid, strength: float, solid: NDArray[np.bool_] | None) -> None:
        shape, cell_m = grid.shape, grid.cell_m
        self.shape = shape
        self.per_m = tuple(np.float32(1 / side) for side in cell_m)
        self.push_m = np.float32(strength * np.prod(cell_m) ** (1 / 3))
        self._vorticity = np.zeros((4, *(n + 2 for n in shape)), np.float32)  # three components and the size
        self._up = np.zeros(shape, np.float32)
        self._away = None if solid is None else _away_from(solid)

    def push(self, carrier: Velocity, velocity: Velocity, step_s: float) -> None:
        """Adds a step's confinement of the carrier's eddies to a velocity; both (Z + 4, Y + 4, X + 4)."""
        z, y, x = self.shape
        vorticity, up, push = self._vorticity, self._up, np.float32(self.push_m * step_s)
        given = (*velocity[:2], up, push, *self.per_m, self._away)
        over_slabs(z + 2, y * x, lambda a, b: _vorticity(vorticity, *carrier, *self.per_m, a, b))
        over_slabs(z, y * x, lambda a, b: _push(vorticity, *given, a, b))
        velocity[2][2:-2, 2:-2, 2:-2] += up
        velocity[2][3:-1, 2:-2, 2:-2] += up


def _away_from(solid: NDArray[np.bool_]) -> Field:
    """1 in cells more than two cells away from terrain, 0 elsewhere."""
    near = solid
    for _ in range(2):
        for axis in range(3):
            near = near | np.roll(near, 1, axis) | np.roll(near, -1, axis)
    return (~near).astype(np.float32)


@unchecked
def _vorticity(out, u, v, w, x_per_m, y_per_m, z_per_m, first, end):  # type: ignore[no-untyped-def]
    """At the cells' centres, from a cell before the first to one after the last, along each axis."""
    out, u, v, w = unowned_view((out, u, v, w))
    rows, columns = out.shape[2], out.shape[3]
    x, y, z = _QUARTER * x_per_m, _QUARTER * y_per_m, _QUARTER * z_per_m
    n = columns + 1
    for a in range(first, end):
        k = max(a + 1, 2)
        for b in range(rows):
            j = b + 1
            _turn(
                out[0, a, b], w[k, j + 1, 1:n], w[k + 1, j + 1, 1:n], w[k, j - 1, 1:n], w[k + 1, j - 1, 1:n], y,
                v[k + 1, j, 1:n], v[k + 1, j + 1, 1:n], v[k - 1, j, 1:n], v[k - 1, j + 1, 1:n], z,
            )  # fmt: skip
            _turn(
                out[1, a, b], u[k + 1, j, 1:n], u[k + 1, j, 2 : n + 1], u[k - 1, j, 1:n], u[k - 1, j, 2 : n + 1], z,
                w[k, j, 2 : n + 1], w[k + 1, j, 2 : n + 1], w[k, j, : n - 1], w[k + 1, j, : n - 1], x,
            )  # fmt: skip
            _turn(
                out[2, a, b], v[k, j, 2 : n + 1], v[k, j + 1, 2 : n + 1], v[k, j, : n - 1], v[k, j + 1, : n - 1], x,
                u[k, j + 1, 1:n], u[k, j + 1, 2 : n + 1], u[k, j - 1, 1:n], u[k, j - 1, 2 : n + 1], y,
            )  # fmt: skip
        for part in range(3):
            _less_mean(out[part, a])
        for b in range(rows):
            p, q, r, size = out[0, a, b], out[1, a, b], out[2, a, b], out[3, a, b]
            for i in range(columns):
                size[i] = np.sqrt(p[i] * p[i] + q[i] * q[i] + r[i] * r[i])


@unchecked
def _less_mean(layer):  # type: ignore[no-untyped-def]
    """Takes the layer's mean away: that of the mean wind's shear, which is no eddy."""
    rows, columns = layer.shape
    total = 0.0
    for j in range(1, rows - 1):
        for i in range(1, columns - 1):
            total += layer[j, i]
    mean = np.float32(total / ((rows - 2) * (columns - 2)))
    for j in range(rows):
        for i in range(columns):
            layer[j, i] -= mean


@unchecked
def _turn(out, a, b, c, d, one_per_m, e, f, g, h, other_per_m):  # type: ignore[no-untyped-def]
    """Difference of two derivatives, each of the mean of two faces, such as dw/dy - dv/dz."""
    for i in range(out.size):
        out[i] = ((a[i] + b[i]) - (c[i] + d[i])) * one_per_m - ((e[i] + f[i]) - (g[i] + h[i])) * other_per_m


@unchecked
def _push(vorticity, u, v, up, push, x_per_m, y_per_m, z_per_m, away, first, end):  # type: ignore[no-untyped-def]
    vorticity, u, v, up = unowned_view((vorticity, u, v, up))
    rows, columns = up.shape[1], up.shape[2]
    east, north = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for k in range(first, end):
        for j in range(rows):
            _force(
                vorticity[:, k + 1, j + 1], vorticity[3, k + 1, j], vorticity[3, k + 1, j + 2], vorticity[3, k, j + 1],
                vorticity[3, k + 2, j + 1], east, north, up[k, j], _HALF * push, x_per_m, y_per_m, z_per_m,
            )  # fmt: skip
            if away is not None:
                for i in range(columns):
                    east[i] *= away[k, j, i]
                    north[i] *= away[k, j, i]
                    up[k, j, i] *= away[k, j, i]
            _add(u[k + 2, j + 2, 2:], east)
            _add(u[k + 2, j + 2, 3:], east)
            _add(v[k + 2, j + 2, 2:], north)
            _add(v[k + 2, 2 if j == rows - 1 else j + 3, 2:], north)
            u[k + 2, j + 2, 2] += east[columns - 1]


@unchecked
def _force(vorticity, south, north, below, above, x, y, z, push, x_per_m, y_per_m, z_per_m):  # type: ignore[no-untyped-def]
    """Push times N x omega into the rows x, y, z. N is the gradient of the vorticity's size, made a unit vector."""
    p, q, r, size = vorticity[0], vorticity[1], vorticity[2], vorticity[3]
    for i in range(x.size):
        gx = (size[i + 2] - size[i]) * x_per_m
        gy = (north[i + 1] - south[i + 1]) * y_per_m
        gz = (above[i + 1] - below[i + 1]) * z_per_m
        scale = push * size[i + 1] / (np.sqrt(gx * gx + gy * gy + gz * gz) + _TINY_PER_S * x_per_m)
        x[i] = scale * (gy * r[i + 1] - gz * q[i + 1])
        y[i] = scale * (gz * p[i + 1] - gx * r[i + 1])
        z[i] = scale * (gx * q[i + 1] - gy * p[i + 1])


@unchecked
def _add(to, what):  # type: ignore[no-untyped-def]
    for i in range(what.size):
        to[i] += what[i]
