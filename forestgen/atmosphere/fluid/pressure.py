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

from forestgen.atmosphere.fluid.parameters import AXES, Field, Surface, UnstableError, Velocity
from forestgen.atmosphere.grid import AirGrid
from forestgen.core.threads import at_once, cores

_INNER = (slice(2, -2),) * 3
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
