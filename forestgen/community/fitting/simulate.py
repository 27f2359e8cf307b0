"""New stands of the model deformation_kernel, placed and then measured as the stand was."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import KernelTable
from forestgen.core.randomness import child_rng

_CELLS_PER_SPACING = 12
_FEWEST_CELLS, _MOST_CELLS = 64, 320
_FINE_STANDS = 200  # plants: of larger stands, half as many cells


class NewStand(NamedTuple):
    """Plants in the order in which they were placed."""

    placed_m: NDArray[np.float64]  # (N, 2) metres
    measured_m: NDArray[np.float64]  # (N, 2) metres: rounded as the stand's were
    species: NDArray[np.int64]  # (N,)
    kind: NDArray[np.int64]  # (N,) by which kernels act: the species; or 0 founder, 1 follower


@dataclass(frozen=True)
class Nursery:
    """Where new stands are placed."""

    stand: MeasuredStand
    cells: int  # along the longer side
    density: NDArray[np.float64] | None = None  # (S, rows, cols) relative; None: even
    founders: int = 0  # plants of the one species that come first and have kernels of their own; 0: all are alike

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return field_shape(self.stand.size_m, self.cells)

    def grow(self, kernels: list[list[KernelTable]], seed: int, number: int) -> NewStand:
        """The stand of one number, among those of a seed.

        Plants come in the stand's own order of species where sizes give one, else at random; founders first.
        """
        stand = self.stand
        rng = child_rng(seed, "fit", number)
        uniform = rng.random((stand.n, 2))
        species = stand.species if stand.ordered else rng.permutation(stand.species)
        kind = species if self.founders == 0 else (np.arange(stand.n) >= self.founders).astype(np.int64)
        even = np.ones(self.shape)
        densities = [even] * len(kernels) if self.density is None else list(self.density)
        fields = [DensityField(one, stand.size_m, periodic=False) for one in densities]
        placement = place(fields, kind, np.ones(stand.n), kernels, uniform)
        placed = placement.placed
        found = placement.position_m[placed]
        return NewStand(found, stand.as_measured(found), species[placed], kind[placed])


def fitting_cells(stand: MeasuredStand) -> int:
    """Cells along the longer side, sixteen in a mean spacing."""
    per_spacing = _CELLS_PER_SPACING if stand.n <= _FINE_STANDS else _CELLS_PER_SPACING // 2
    wanted = math.ceil(max(stand.size_m) / stand.spacing_m * per_spacing)
    return min(max(wanted, _FEWEST_CELLS), _MOST_CELLS)


def field_shape(size_m: tuple[float, float], cells: int) -> tuple[int, int]:
    """Rows and columns of nearly square cells."""
    cell_m = max(size_m) / cells
    return max(1, round(size_m[1] / cell_m)), max(1, round(size_m[0] / cell_m))
