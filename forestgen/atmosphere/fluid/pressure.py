"""Pressure: the gradient that makes a velocity free of divergence (Eq. 32), solved directly.

The discrete Laplacian of the staggered grid is diagonal in Fourier's basis along periodic axes and in that of the
cosine transform between walls, with eigenvalues -(2 sin(pi m / N) / h)^2 and -(2 sin(pi m / 2N) / h)^2. So the
divergence falls to rounding in one solve. With terrain the faces of solid cells pass nothing; the solve over the
whole box is then the preconditioner of conjugate gradients.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.boundaries import Velocity
from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.weather import AirGrid
from forestgen.core.compiled import borrowed, unchecked
from forestgen.core.threads import cores, over_slabs

Field = NDArray[np.float32]
_MOST_ITERATIONS = 200  # hills take 13, cliffs half as high as the box 35, walls with slots of three cells 130
_ENOUGH_PER_S = 1e-7  # root mean square of the divergence that is left, over terrain
_TOO_MUCH_PER_S = 1e-5  # of what is left after all iterations: a step of 1 s makes that share of the air from nothing


class Pressure:
    """Solver of one grid. `potential` is a pressure over density, times the step: (Z, Y, X) m2/s."""

    def __init__(self, grid: AirGrid, openness: Velocity | None) -> None:
        self.grid, self.openness = grid, openness
        self.per_m = tuple(np.float32(1 / side) for side in grid.cell_m)
        self._inverse = _inverse_eigenvalues(grid)
        self._divergence = np.zeros(grid.shape, np.float32)

    def project(self, velocity: Velocity) -> None:
        """Takes the divergence out of a velocity (Z + 4, Y + 4, X + 4) in place; its faces at walls are set before.

        The ghosts of the result are not filled, and of periodic sides neither the last face.
        """
        z, y, x = self.grid.shape
        out, ends = self._divergence, self.grid.periodic
        over_slabs(z, y * x, lambda a, b: _divergence(out, *velocity, *self.per_m, ends, a, b))
        potential = self.solve(out) if self.openness is None else self._solve_around(out)
        over_slabs(z, y * x, lambda a, b: _subtract(potential, *velocity, *self.per_m, ends, self.openness, a, b))

    def solve(self, divergence: Field) -> Field:
        """(Z, Y, X) potential whose Laplacian is the divergence, over the whole box."""
        from scipy import fft

        n = cores()
        spectrum: Any = fft.dct(divergence, axis=0, workers=n)
        if self.grid.periodic:
            spectrum = fft.rfft2(spectrum, axes=(1, 2), workers=n)
            spectrum *= self._inverse
            spectrum = fft.irfft2(spectrum, s=divergence.shape[1:], axes=(1, 2), overwrite_x=True, workers=n)
        else:
            spectrum = fft.dctn(spectrum, axes=(1, 2), overwrite_x=True, workers=n)
            spectrum *= self._inverse
            spectrum = fft.idctn(spectrum, axes=(1, 2), overwrite_x=True, workers=n)
        potential: Field = fft.idct(spectrum, axis=0, overwrite_x=True, workers=n)
        return potential

    def _solve_around(self, divergence: Field) -> Field:
        """The same with the terrain's faces shut: conjugate gradients, preconditioned by the open box.

        Raises
        ------
        UnstableError : they do not converge.
        """
        z, y, x = self.grid.shape
        opened, ends, per_m = self.openness, self.grid.periodic, self.per_m

        def laplacian(p: Field) -> Field:
            out = np.empty_like(p)
            over_slabs(z, y * x, lambda a, b: _laplacian(out, p, *per_m, ends, opened, a, b))
            return out

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
            bent = laplacian(along)
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
    joined = grid.periodic
    along_x = np.sin(np.pi * np.arange(x // 2 + 1) / x) if joined else np.sin(np.pi * np.arange(x) / (2 * x))
    along_y = np.sin(np.pi * np.arange(y) / (y if joined else 2 * y))
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
def _divergence(out, u, v, w, x_per_m, y_per_m, z_per_m, joined, first, end):  # type: ignore[no-untyped-def]
    out, u, v, w = borrowed(out), borrowed(u), borrowed(v), borrowed(w)
    rows, columns = out.shape[1], out.shape[2]
    for k in range(first, end):
        for j in range(rows):
            to, east, low, high = out[k, j], u[k + 2, j + 2], w[k + 2, j + 2], w[k + 3, j + 2]
            south = v[k + 2, j + 2]
            north = v[k + 2, 2] if joined and j == rows - 1 else v[k + 2, j + 3]
            for i in range(columns):
                to[i] = (north[i + 2] - south[i + 2]) * y_per_m + (high[i + 2] - low[i + 2]) * z_per_m
            last = columns - 1 if joined else columns
            for i in range(last):
                to[i] += (east[i + 3] - east[i + 2]) * x_per_m
            if joined:
                to[last] += (east[2] - east[last + 2]) * x_per_m


@unchecked
def _subtract(p, u, v, w, x_per_m, y_per_m, z_per_m, joined, opened, first, end):  # type: ignore[no-untyped-def]
    p, u, v, w = borrowed(p), borrowed(u), borrowed(v), borrowed(w)
    rows, columns = p.shape[1], p.shape[2]
    for k in range(first, end):
        for j in range(rows):
            here = p[k, j]
            east = u[k + 2, j + 2]
            _slope(east[3 : columns + 2], here[: columns - 1], here[1:], x_per_m)
            if joined:
                east[2] -= (here[0] - here[columns - 1]) * x_per_m
            if j > 0 or joined:
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
def _laplacian(out, p, x_per_m, y_per_m, z_per_m, joined, opened, first, end):  # type: ignore[no-untyped-def]
    """Divergence of the gradient through open faces."""
    out, p = borrowed(out), borrowed(p)
    opened_x, opened_y, opened_z = borrowed(opened[0]), borrowed(opened[1]), borrowed(opened[2])
    layers, rows, columns = p.shape
    xx, yy, zz = x_per_m * x_per_m, y_per_m * y_per_m, z_per_m * z_per_m
    for k in range(first, end):
        for j in range(rows):
            for i in range(columns):
                here, total = p[k, j, i], np.float32(0)
                if i > 0 or joined:
                    total += (p[k, j, i - 1 if i > 0 else columns - 1] - here) * opened_x[k + 2, j + 2, i + 2] * xx
                if i < columns - 1 or joined:
                    total += (p[k, j, i + 1 if i < columns - 1 else 0] - here) * opened_x[k + 2, j + 2, i + 3] * xx
                if j > 0 or joined:
                    total += (p[k, j - 1 if j > 0 else rows - 1, i] - here) * opened_y[k + 2, j + 2, i + 2] * yy
                if j < rows - 1 or joined:
                    total += (p[k, j + 1 if j < rows - 1 else 0, i] - here) * opened_y[k + 2, j + 3, i + 2] * yy
                if k > 0:
                    total += (p[k - 1, j, i] - here) * opened_z[k + 2, j + 2, i + 2] * zz
                if k < layers - 1:
                    total += (p[k + 1, j, i] - here) * opened_z[k + 3, j + 2, i + 2] * zz
                out[k, j, i] = total
