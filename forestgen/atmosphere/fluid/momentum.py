"""Forces on the wind: pressure, its own advection and viscosity, the confinement of its eddies; and the box's sides.

Boundaries. Fields have two ghost cells on each side, which are filled here. Nothing passes ground and ceiling. The
ceiling slips: the wind is mirrored. The ground does not: viscosity sees the wind there with its sign turned (the fluxes
do not, since they would take the jump for a wind). The sides are periodic. Faces of terrain are shut.

Pressure. Its gradient makes a velocity free of divergence (Eq. 32); it is solved directly. The discrete Laplacian of
the staggered grid is diagonal in Fourier's basis along periodic axes and in that of the cosine transform between
walls, with eigenvalues -(2 sin(pi m / N) / h)^2 and -(2 sin(pi m / 2N) / h)^2. So the divergence falls to rounding in
one solve. With terrain the faces of solid cells pass nothing; the solve over the whole box is then the preconditioner
of conjugate gradients.

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
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import AXES, Field, Surface, UnstableError, Velocity
from forestgen.atmosphere.grid import AirGrid
from forestgen.core.compiled import unchecked, unowned_view
from forestgen.core.threads import at_once, cores, over_slabs

_INNER = (slice(2, -2),) * 3
_MOST_ITERATIONS = 200  # hills take 13, cliffs half as high as the box 35, walls with slots of three cells 130
_ENOUGH_PER_S = 1e-7  # root mean square of the divergence that is left, over terrain
_TOO_MUCH_PER_S = 1e-5  # of what is left after all iterations: a step of 1 s makes that share of the air from nothing
_TWO, _THREE, _SEVEN = np.float32(2), np.float32(3), np.float32(7)
_HALF, _QUARTER = np.float32(0.5), np.float32(0.25)
_TINY_PER_S = np.float32(1e-6)  # growth of vorticity across a cell that is taken for none


def fill_sides(field: Field) -> None:
    """Ghost cells at the four periodic sides of a field (Z, Y + 4, X + 4)."""
    field[:, :, :2], field[:, :, -2:] = field[:, :, -4:-2], field[:, :, 2:4]
    field[:, :2], field[:, -2:] = field[:, -4:-2], field[:, 2:4]


def _openness(solid: NDArray[np.bool_]) -> Velocity:
    layers, rows, columns = solid.shape
    around = np.ones((layers + 4, rows + 4, columns + 4), dtype=bool)
    around[-2:] = False
    around[2:-2] = np.pad(solid, ((0, 0), (2, 2), (2, 2)), mode="wrap")
    faces = []
    for axis in (2, 1, 0):
        shut = around | np.roll(around, 1, axis)
        shut[(slice(None),) * axis + (slice(0, 1),)] = np.take(around, [0], axis)
        faces.append((~shut).astype(np.float32))
    return faces[0], faces[1], faces[2]


def solid_cells(grid: AirGrid, surface: Surface | None) -> NDArray[np.bool_] | None:
    """(Z, Y, X) cells whose centre lies below the terrain; None where there is none. ValueError: it reaches the top."""
    if surface is None or surface.height_m is None:
        return None
    solid = grid.layer_heights_m[:, None, None] < np.asarray(surface.height_m)[None]
    if surface.height_m.max() >= grid.layer_heights_m[-1]:
        raise ValueError(
            f"the terrain rises to {surface.height_m.max():.0f} m, to the top layer of the air"
            f" ({grid.layer_heights_m[-1]:.0f} m); expected a higher box"
        )
    return solid if solid.any() else None


class Pressure:
    """Sides and solver of one grid, around `solid` cells (Z, Y, X) inside the terrain, if there are any.

    `openness` per axis x, y, z is a field (Z + 4, Y + 4, X + 4): 1 at faces between two cells of air, 0 at others; None
    without terrain. A potential is a pressure over density, times the step: (Z, Y, X) m2/s.
    """

    def __init__(self, grid: AirGrid, solid: NDArray[np.bool_] | None) -> None:
        self.grid, self.openness = grid, None if solid is None else _openness(solid)
        self.per_m = tuple(np.float32(1 / side) for side in grid.cell_m)
        self._inverse = _inverse_eigenvalues(grid)

    def set_sides(self, velocity: Velocity) -> None:
        """Sets the velocity at the sides and its ghosts."""
        u, v, w = velocity
        if self.openness is not None:
            for field, opened in zip(velocity, self.openness, strict=True):
                field *= opened
        w[2] = w[-2] = 0
        at_once([partial(fill_sides, field) for field in velocity])
        for field in (u, v):
            field[1], field[0] = field[2], field[3]
            field[-2], field[-1] = field[-3], field[-4]
        w[1], w[0], w[-1] = -w[3], -w[4], -w[-3]

    def project(self, velocity: Velocity) -> None:
        """Sets the sides of a velocity (Z + 4, Y + 4, X + 4), and takes the divergence out of it, in place."""
        self.set_sides(velocity)
        u, v, w = velocity
        x, y, z = self.per_m
        divergence = np.diff(v[2:-2, 2:-1, 2:-2], axis=1) * y + np.diff(w[2:-1, 2:-2, 2:-2], axis=0) * z
        divergence += np.diff(u[2:-2, 2:-2, 2:-1], axis=2) * x
        potential = self.solve(divergence) if self.openness is None else self._solve_around(divergence)
        for field, per_m, axis in ((u, x, 2), (v, y, 1)):
            field[_INNER] -= (potential - np.roll(potential, 1, axis)) * per_m
        w[3:-2, 2:-2, 2:-2] -= np.diff(potential, axis=0) * z
        if self.openness is not None:
            for field, opened in zip(velocity, self.openness, strict=True):
                field[_INNER] *= opened[_INNER]
        self.set_sides(velocity)

    def solve(self, divergence: Field) -> Field:
        """(Z, Y, X) potential whose Laplacian is the divergence, over the whole box."""
        from scipy import fft

        n = cores()
        spectrum: Any = fft.rfft2(fft.dct(divergence, axis=0, workers=n), axes=(1, 2), workers=n)
        spectrum *= self._inverse
        spectrum = fft.irfft2(spectrum, s=divergence.shape[1:], axes=(1, 2), overwrite_x=True, workers=n)
        potential: Field = fft.idct(spectrum, axis=0, overwrite_x=True, workers=n)
        return potential

    def _solve_around(self, divergence: Field) -> Field:
        """The same with terrain, by preconditioned conjugate gradients. `UnstableError`: they do not converge."""
        potential = np.zeros_like(divergence)
        rest = divergence.copy()
        along, was = np.zeros_like(rest), np.inf
        for _ in range(_MOST_ITERATIONS):
            if _size(rest) < _ENOUGH_PER_S:
                return potential
            better = self.solve(rest)
            now = _dot(rest, better)
            along = better + np.float32(now / was) * along
            was = now
            bent = self._laplacian(along)
            length = np.float32(now / _dot(along, bent))
            potential += length * along
            rest -= length * bent
        left = _size(rest)
        if left > _TOO_MUCH_PER_S:  # what is not finite is found, and named, where fields are checked
            raise UnstableError(
                f"the pressure over the terrain does not converge: after {_MOST_ITERATIONS} iterations a divergence of "
                f"{left:.2g} 1/s is left; expected {_TOO_MUCH_PER_S:g} or less. Flatter terrain or finer cells help"
            )
        return potential

    def _laplacian(self, p: Field) -> Field:
        """Divergence of the gradient through open faces."""
        assert self.openness is not None
        total = np.zeros_like(p)
        for opened, per_m, axis, (z, y, x) in zip(self.openness, self.per_m, (2, 1, 0), AXES, strict=True):
            layers, rows, columns = opened.shape
            beyond = opened[2 + z : layers - 2 + z, 2 + y : rows - 2 + y, 2 + x : columns - 2 + x]
            before, after = np.roll(p, 1, axis), np.roll(p, -1, axis)
            if axis == 0:  # nothing passes ground and ceiling
                before[0], after[-1] = p[0], p[-1]
            total += (before - p) * opened[_INNER] * (per_m * per_m)
            total += (after - p) * beyond * (per_m * per_m)
        return total


def _inverse_eigenvalues(grid: AirGrid) -> Field:
    x, y, z = grid.cells
    dx, dy, dz = grid.cell_m
    along_x = np.sin(np.pi * np.arange(x // 2 + 1) / x)
    along_y = np.sin(np.pi * np.arange(y) / y)
    along_z = np.sin(np.pi * np.arange(z) / (2 * z))
    total = (2 * along_z / dz)[:, None, None] ** 2 + (2 * along_y / dy)[:, None] ** 2 + (2 * along_x / dx) ** 2
    total[0, 0, 0] = np.inf  # a constant pressure moves nothing
    return (-1.0 / total).astype(np.float32)


def _dot(a: Field, b: Field) -> float:
    return float(np.einsum("zyx,zyx->z", a, b, dtype=np.float64).sum())


def _size(a: Field) -> float:
    """Root mean square."""
    return float(np.sqrt(_dot(a, a) / a.size))


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
        self.shape = grid.shape
        self.per_m = tuple(np.float32(1 / side) for side in grid.cell_m)
        self.push_m = np.float32(strength * np.prod(grid.cell_m) ** (1 / 3))
        # Vorticity at the cells' centres and one around, three components and the size.
        self._omega = np.zeros((4, *(n + 2 for n in grid.shape)), np.float32)
        self._up = np.zeros(grid.shape, np.float32)
        self._away = None if solid is None else _away_from(solid)

    def push(self, carrier: Velocity, velocity: Velocity, step_s: float) -> None:
        """Adds a step's confinement of the carrier's eddies to a velocity; both (Z + 4, Y + 4, X + 4)."""
        z, y, x = self.shape
        push = np.float32(self.push_m * step_s)
        over_slabs(z + 1, y * x, lambda a, b: self._find(*carrier, slice(a + 2, b + 2)))
        self._omega[:, 0] = self._omega[:, 1]  # below the lowest layer as in it
        over_slabs(z, y * x, lambda a, b: self._push(velocity, push, slice(a, b)))
        velocity[2][2:-2, 2:-2, 2:-2] += self._up
        velocity[2][3:-1, 2:-2, 2:-2] += self._up

    def _find(self, u: Field, v: Field, w: Field, layers: slice) -> None:
        """The vorticity in layers of the velocity, less each layer's mean: the shear of the mean wind is no eddy."""
        x, y, z = (_QUARTER * one for one in self.per_m)
        below, above = (slice(layers.start + k, layers.stop + k) for k in (-1, 1))
        # Sums of the two faces of a cell.
        up, along = w[layers] + w[above], v[layers, 1:-1] + v[layers, 2:]
        across_low, across_high = (u[one, 1:-1, 1:-1] + u[one, 1:-1, 2:] for one in (below, above))
        along_low, along_high = (v[one, 1:-1, 1:-1] + v[one, 2:, 1:-1] for one in (below, above))
        north, south = (u[layers, one, 1:-1] + u[layers, one, 2:] for one in (slice(2, None), slice(0, -2)))
        p, q, r, size = (part[layers.start - 1 : layers.stop - 1] for part in self._omega)
        p[:] = (up[:, 2:, 1:-1] - up[:, :-2, 1:-1]) * y - (along_high - along_low) * z
        q[:] = (across_high - across_low) * z - (up[:, 1:-1, 2:] - up[:, 1:-1, :-2]) * x
        r[:] = (along[..., 2:] - along[..., :-2]) * x - (north - south) * y
        for part in (p, q, r):
            inner = part[:, 1:-1, 1:-1].reshape(len(part), -1)
            # One number after another: so the sum does not depend on how it is cut.
            mean = np.cumsum(inner, axis=1, dtype=np.float64)[:, -1] / inner.shape[1]
            part -= mean.astype(np.float32)[:, None, None]
        np.sqrt(p * p + q * q + r * r, out=size)

    def _push(self, velocity: Velocity, push: np.float32, layers: slice) -> None:
        """Push times N x omega, N the unit vector along the gradient of the vorticity's size: half to either face."""
        x, y, z = self.per_m
        p, q, r, size = self._omega[:, layers.start + 1 : layers.stop + 1]
        below, above = (self._omega[3, layers.start + k : layers.stop + k, 1:-1, 1:-1] for k in (0, 2))
        gx = (size[:, 1:-1, 2:] - size[:, 1:-1, :-2]) * x
        gy = (size[:, 2:, 1:-1] - size[:, :-2, 1:-1]) * y
        gz = (above - below) * z
        scale = _HALF * push * size[:, 1:-1, 1:-1] / (np.sqrt(gx * gx + gy * gy + gz * gz) + _TINY_PER_S * x)
        p, q, r = (one[:, 1:-1, 1:-1] for one in (p, q, r))
        east, north, up = scale * (gy * r - gz * q), scale * (gz * p - gx * r), scale * (gx * q - gy * p)
        if self._away is not None:
            east, north, up = (one * self._away[layers] for one in (east, north, up))
        self._up[layers] = up
        u, v = (field[2:-2][layers, 2:-2, 2:-2] for field in velocity[:2])
        u[:] = (u + east) + np.roll(east, 1, 2)
        first, second = np.roll(north, 1, 1), north.copy()  # in one order of additions
        first[:, 0], second[:, 0] = north[:, 0], north[:, -1]
        v[:] = (v + first) + second


def _away_from(solid: NDArray[np.bool_]) -> Field:
    """1 in cells more than two cells away from terrain, 0 elsewhere."""
    near = solid
    for _ in range(2):
        for axis in range(3):
            near = near | np.roll(near, 1, axis) | np.roll(near, -1, axis)
    return (~near).astype(np.float32)
