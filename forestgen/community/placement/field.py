"""The probability field that kernels deform, and draws from it.

The field is a grid of cells, each of one density. A place is drawn by the inverse transformation method: first its row
by the rows' sums and its y inside the row by linear interpolation, then its column by that row's partial sums and its
x in the same way. That is exact: the density is constant in a cell.

References
----------
Lane 2002, sections 5.1 and 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.kernels import KernelTable


class DensityField:
    """A field over the site [0, W] x [0, H]; deforming changes it in place.

    Parameters
    ----------
    density : (rows, cols) float64, >= 0, finite; row 0 lies at y = 0, column 0 at x = 0. Copied.
    size_m : W, H, metres; a cell is W / cols wide and H / rows high.
    periodic : opposite edges meet: kernels reach across them.
    """

    def __init__(self, density: NDArray[np.float64], size_m: tuple[float, float], *, periodic: bool) -> None:
        self.cells: NDArray[np.float64] = np.array(density, dtype=np.float64)  # (rows, cols), as deformed so far
        self.size_m, self.periodic = size_m, periodic

    @property
    def total(self) -> float:
        """Sum of all cells; 0: no place is left."""
        return float(self.cells.sum())

    def deform(self, position_m: NDArray[np.float64], radius_m: NDArray[np.float64], kernel: KernelTable) -> None:
        """Multiply by the kernels of plants at (N, 2) places with (N,) radii, metres."""
        rows, cols = self.cells.shape
        width, height = self.size_m
        x = (np.arange(cols) + 0.5) * (width / cols)
        y = (np.arange(rows) + 0.5) * (height / rows)
        for (px, py), radius in zip(position_m, radius_m, strict=True):
            dx, dy = np.abs(x - px), np.abs(y - py)
            if self.periodic:
                dx, dy = np.minimum(dx, width - dx), np.minimum(dy, height - dy)
            factor = kernel(np.hypot(dx[None, :], dy[:, None]), float(radius))
            if kernel.balanced:
                near = np.hypot(dx[None, :], dy[:, None]) <= float(kernel.reach_m(radius))
                before, after = self.cells[near].sum(), (self.cells * factor)[near].sum()
                factor = np.where(near, factor * (before / after if after > 0 else 1.0), 1.0)
            self.cells *= factor

    def draw(self, uniform: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 2) places, metres, of (N, 2) numbers in [0, 1): the first chooses y, then x; `total` must be > 0."""
        rows, cols = self.cells.shape
        below = np.concatenate([[0.0], np.cumsum(self.cells.sum(axis=1))])
        places = np.empty((len(uniform), 2))
        for k, (u, v) in enumerate(uniform):
            row = int(np.clip(np.searchsorted(below, u * below[-1], side="right") - 1, 0, rows - 1))
            y = row + (u * below[-1] - below[row]) / (below[row + 1] - below[row])
            left = np.concatenate([[0.0], np.cumsum(self.cells[row])])
            col = int(np.clip(np.searchsorted(left, v * left[-1], side="right") - 1, 0, cols - 1))
            x = col + (v * left[-1] - left[col]) / (left[col + 1] - left[col])
            places[k] = x * self.size_m[0] / cols, y * self.size_m[1] / rows
        return places


@dataclass(frozen=True)
class Placement:
    """Where plants came to stand."""

    position_m: NDArray[np.float64]  # (N, 2) metres; nan for one that found no place
    placed: NDArray[np.bool_]  # (N,)


def place(
    fields: Sequence[DensityField],
    species: NDArray[np.integer],
    radius_m: NDArray[np.float64],
    kernels: Sequence[Sequence[KernelTable]],
    uniform: NDArray[np.float64],
) -> Placement:
    """Place plants one by one, each of which deforms the fields of all species.

    Parameters
    ----------
    fields : of each species, all of one shape; deformed in place.
    species, radius_m : (N,) of the plants, in the order of placement.
    kernels : kernels[i][j] is the effect of a plant of species j on the field of species i (Lane's M_ij, Figure 5.7).
    uniform : (N, 2) in [0, 1), row k for plant k, used or not.
    """
    position_m = np.full((len(species), 2), np.nan)
    for k, sp in enumerate(species):
        if fields[sp].total <= 0.0:
            continue
        position_m[k] = fields[sp].draw(uniform[k : k + 1])[0]
        for field, row in zip(fields, kernels, strict=True):
            if not row[sp].is_neutral:
                field.deform(position_m[k : k + 1], radius_m[k : k + 1], row[sp])
    return Placement(position_m, ~np.isnan(position_m[:, 0]))
