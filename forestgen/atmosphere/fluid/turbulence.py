"""Eddies at the grid's scale: vorticity confinement, and diffusion of heat and water by eddies smaller than a cell.

The upwind part of the fluxes damps eddies of a few cells. Confinement (Steinhoff & Underhill 1994; Fedkiw, Stam &
Jensen 2001) pushes along N x omega, N being the direction in which the vorticity's size grows: eddies that are there
stay, and still air stays still. The acceleration here is strength x cell x |omega| N x omega. The published form lacks
|omega|, so its strength is per second; with it one strength serves all cells and winds. omega is what is left when
the mean of each layer is taken away, and ends two cells from terrain: the shear of the mean wind and the wind that
slows down at walls are no eddies. It adds energy; 0: none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.boundaries import Velocity
from forestgen.atmosphere.weather import AirGrid
from forestgen.core.compiled import borrowed, unchecked
from forestgen.core.threads import over_slabs

Field = NDArray[np.float32]
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
_TINY_PER_S = np.float32(1e-6)  # growth of vorticity across a cell that is taken for none


class Confinement:
    """Work space of one grid. `strength` is dimensionless."""

    def __init__(self, grid: AirGrid, strength: float, solid: NDArray[np.bool_] | None) -> None:
        shape, cell_m = grid.shape, grid.cell_m
        self.shape, self.periodic = shape, grid.periodic
        self.per_m = tuple(np.float32(1 / side) for side in cell_m)
        self.push_m = np.float32(strength * np.prod(cell_m) ** (1 / 3))
        self._vorticity = np.zeros((4, *(n + 2 for n in shape)), np.float32)  # three components and the size
        self._up = np.zeros(shape, np.float32)
        self._away = None if solid is None else _away_from(solid)

    def push(self, carrier: Velocity, velocity: Velocity, step_s: float) -> None:
        """Adds a step's confinement of the carrier's eddies to a velocity; both (Z + 4, Y + 4, X + 4)."""
        z, y, x = self.shape
        vorticity, up, push = self._vorticity, self._up, np.float32(self.push_m * step_s)
        over_slabs(z + 2, y * x, lambda a, b: _vorticity(vorticity, *carrier, *self.per_m, a, b))
        over_slabs(
            z,
            y * x,
            lambda a, b: _push(vorticity, *velocity[:2], up, push, *self.per_m, self.periodic, self._away, a, b),
        )
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
    out, u, v, w = borrowed(out), borrowed(u), borrowed(v), borrowed(w)
    rows, columns = out.shape[2], out.shape[3]
    x, y, z = _QUARTER * x_per_m, _QUARTER * y_per_m, _QUARTER * z_per_m
    for a in range(first, end):
        k = max(a + 1, 2)
        for b in range(rows):
            j = b + 1
            above, below = v[k + 1, j : j + 2], v[k - 1, j : j + 2]
            _turn(out[0, a, b], w[k : k + 2, j + 1], w[k : k + 2, j - 1], y, above, below, z)
            _turn_up(out[1, a, b], u[k + 1, j], u[k - 1, j], z, w[k : k + 2, j], x)
            _turn_flat(out[2, a, b], v[k, j : j + 2], x, u[k, j + 1], u[k, j - 1], y)
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
def _turn(out, w_north, w_south, y, v_above, v_below, z):  # type: ignore[no-untyped-def]
    """dw/dy - dv/dz."""
    a, b, c, d = w_north[0], w_north[1], w_south[0], w_south[1]
    e, f, g, h = v_above[0], v_above[1], v_below[0], v_below[1]
    for i in range(out.size):
        rise = (a[i + 1] + b[i + 1]) - (c[i + 1] + d[i + 1])
        out[i] = rise * y - ((e[i + 1] + f[i + 1]) - (g[i + 1] + h[i + 1])) * z


@unchecked
def _turn_up(out, u_above, u_below, z, w, x):  # type: ignore[no-untyped-def]
    """du/dz - dw/dx."""
    a, b = w[0], w[1]
    for i in range(out.size):
        shear = (u_above[i + 1] + u_above[i + 2]) - (u_below[i + 1] + u_below[i + 2])
        out[i] = shear * z - ((a[i + 2] + b[i + 2]) - (a[i] + b[i])) * x


@unchecked
def _turn_flat(out, v, x, u_north, u_south, y):  # type: ignore[no-untyped-def]
    """dv/dx - du/dy."""
    a, b = v[0], v[1]
    for i in range(out.size):
        shear = (u_north[i + 1] + u_north[i + 2]) - (u_south[i + 1] + u_south[i + 2])
        out[i] = ((a[i + 2] + b[i + 2]) - (a[i] + b[i])) * x - shear * y


@unchecked
def _push(vorticity, u, v, up, push, x_per_m, y_per_m, z_per_m, joined, away, first, end):  # type: ignore[no-untyped-def]
    vorticity, u, v, up = borrowed(vorticity), borrowed(u), borrowed(v), borrowed(up)
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
            _add(v[k + 2, 2 if joined and j == rows - 1 else j + 3, 2:], north)
            if joined:
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


def diffuse(
    field: Field, work: Field, diffusivity_m2_per_s: float, cell_m: tuple[float, float, float], step_s: float,
    openness: Velocity | None,
) -> None:  # fmt: skip
    """Diffusion of a ratio through open faces, in place; the walls, the ground and the terrain let nothing through.

    Parameters
    ----------
    field : (Z + 4, Y + 4, X + 4), its ghosts at the sides filled.
    work : of the same shape.
    """
    weight = tuple(np.float32(diffusivity_m2_per_s * step_s / side**2) for side in cell_m)
    layers, rows, columns = field.shape
    work[...] = field
    size = (rows - 4) * (columns - 4)
    over_slabs(layers - 4, size, lambda a, b: _diffuse(field, work, weight, openness, a + 2, b + 2))


@unchecked
def _diffuse(out, q, weight, opened, first, end):  # type: ignore[no-untyped-def]
    out, q = borrowed(out), borrowed(q)
    layers, rows, columns = q.shape
    for k in range(first, end):
        low, high = max(k - 1, 2), min(k + 1, layers - 3)
        for j in range(2, rows - 2):
            for i in range(2, columns - 2):
                here = q[k, j, i]
                west, east, south, north = q[k, j, i - 1], q[k, j, i + 1], q[k, j - 1, i], q[k, j + 1, i]
                below, above = q[low, j, i] - here, q[high, j, i] - here
                west, east, south, north = west - here, east - here, south - here, north - here
                if opened is not None:
                    west, east = west * opened[0][k, j, i], east * opened[0][k, j, i + 1]
                    south, north = south * opened[1][k, j, i], north * opened[1][k, j + 1, i]
                    below, above = below * opened[2][k, j, i], above * opened[2][k + 1, j, i]
                out[k, j, i] = here + (
                    weight[0] * (west + east) + weight[1] * (south + north) + weight[2] * (below + above)
                )
