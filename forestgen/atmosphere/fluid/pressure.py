"""Pressure, and what stands at the box's six sides and on the terrain.

Boundaries. Fields have two ghost cells on each side, which are filled here. Nothing passes ground and ceiling. The
ceiling slips: the wind is mirrored. The ground does not: viscosity sees the wind there with its sign turned (see
`momentum`; the fluxes do not, since they would take the jump for a wind). The sides are periodic. Faces of terrain are
shut.

Pressure. Its gradient makes a velocity free of divergence (Eq. 32); it is solved directly. The discrete Laplacian of
the staggered grid is diagonal in Fourier's basis along periodic axes and in that of the cosine transform between
walls, with eigenvalues -(2 sin(pi m / N) / h)^2 and -(2 sin(pi m / 2N) / h)^2. So the divergence falls to rounding in
one solve. With terrain the faces of solid cells pass nothing; the solve over the whole box is then the preconditioner
of conjugate gradients.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.parameters import Field, Surface, UnstableError, Velocity
from forestgen.atmosphere.grid import AirGrid
from forestgen.core.compiled import unchecked, unowned_view
from forestgen.core.threads import at_once, cores, over_slabs

_MOST_ITERATIONS = 200  # hills take 13, cliffs half as high as the box 35, walls with slots of three cells 130
_ENOUGH_PER_S = 1e-7  # root mean square of the divergence that is left, over terrain
_TOO_MUCH_PER_S = 1e-5  # of what is left after all iterations: a step of 1 s makes that share of the air from nothing


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
        self._divergence = np.zeros(grid.shape, np.float32)

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
        z, y, x = self.grid.shape
        out = self._divergence
        over_slabs(z, y * x, lambda a, b: _divergence(out, *velocity, *self.per_m, a, b))
        potential = self.solve(out) if self.openness is None else self._solve_around(out)
        over_slabs(z, y * x, lambda a, b: _subtract(potential, *velocity, *self.per_m, self.openness, a, b))
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
        z, y, x = self.grid.shape
        potential = np.zeros_like(divergence)
        rest = divergence.copy()
        along, bent, was = np.zeros_like(rest), np.empty_like(rest), np.inf
        for _ in range(_MOST_ITERATIONS):
            if _size(rest) < _ENOUGH_PER_S:
                return potential
            better = self.solve(rest)
            now = _dot(rest, better)
            along = better + np.float32(now / was) * along
            was = now
            over_slabs(z, y * x, partial(_laplacian, bent, along, *self.per_m, self.openness))
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


@unchecked
def _divergence(out, u, v, w, x_per_m, y_per_m, z_per_m, first, end):  # type: ignore[no-untyped-def]
    out, u, v, w = unowned_view((out, u, v, w))
    rows, columns = out.shape[1], out.shape[2]
    for k in range(first, end):
        for j in range(rows):
            to, east, low, high = out[k, j], u[k + 2, j + 2], w[k + 2, j + 2], w[k + 3, j + 2]
            south = v[k + 2, j + 2]
            north = v[k + 2, 2] if j == rows - 1 else v[k + 2, j + 3]
            for i in range(columns):
                to[i] = (north[i + 2] - south[i + 2]) * y_per_m + (high[i + 2] - low[i + 2]) * z_per_m
            for i in range(columns - 1):
                to[i] += (east[i + 3] - east[i + 2]) * x_per_m
            to[columns - 1] += (east[2] - east[columns + 1]) * x_per_m


@unchecked
def _subtract(p, u, v, w, x_per_m, y_per_m, z_per_m, opened, first, end):  # type: ignore[no-untyped-def]
    p, u, v, w = unowned_view((p, u, v, w))
    rows, columns = p.shape[1], p.shape[2]
    for k in range(first, end):
        for j in range(rows):
            here = p[k, j]
            east = u[k + 2, j + 2]
            _slope(east[3 : columns + 2], here[: columns - 1], here[1:], x_per_m)
            east[2] -= (here[0] - here[columns - 1]) * x_per_m
            _slope(v[k + 2, j + 2, 2 : columns + 2], p[k, j - 1 if j > 0 else rows - 1], here, y_per_m)
            if k > 0:
                _slope(w[k + 2, j + 2, 2 : columns + 2], p[k - 1, j], here, z_per_m)
            if opened is not None:
                for i in range(2, columns + 2):
                    u[k + 2, j + 2, i] *= opened[0][k + 2, j + 2, i]
                    v[k + 2, j + 2, i] *= opened[1][k + 2, j + 2, i]
                    w[k + 2, j + 2, i] *= opened[2][k + 2, j + 2, i]


@unchecked
def _slope(velocity, before, after, per_m):  # type: ignore[no-untyped-def]
    for i in range(velocity.size):
        velocity[i] -= (after[i] - before[i]) * per_m


@unchecked
def _laplacian(out, p, x_per_m, y_per_m, z_per_m, opened, first, end):  # type: ignore[no-untyped-def]
    """Divergence of the gradient through open faces."""
    out, p = unowned_view((out, p))
    opened_x, opened_y, opened_z = unowned_view(opened[0]), unowned_view(opened[1]), unowned_view(opened[2])
    layers, rows, columns = p.shape
    xx, yy, zz = x_per_m * x_per_m, y_per_m * y_per_m, z_per_m * z_per_m
    for k in range(first, end):
        for j in range(rows):
            for i in range(columns):
                here, total = p[k, j, i], np.float32(0)
                total += (p[k, j, i - 1 if i > 0 else columns - 1] - here) * opened_x[k + 2, j + 2, i + 2] * xx
                total += (p[k, j, i + 1 if i < columns - 1 else 0] - here) * opened_x[k + 2, j + 2, i + 3] * xx
                total += (p[k, j - 1 if j > 0 else rows - 1, i] - here) * opened_y[k + 2, j + 2, i + 2] * yy
                total += (p[k, j + 1 if j < rows - 1 else 0, i] - here) * opened_y[k + 2, j + 3, i + 2] * yy
                if k > 0:
                    total += (p[k - 1, j, i] - here) * opened_z[k + 2, j + 2, i + 2] * zz
                if k < layers - 1:
                    total += (p[k + 1, j, i] - here) * opened_z[k + 3, j + 2, i + 2] * zz
                out[k, j, i] = total
