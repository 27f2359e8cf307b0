"""A lattice of cells over the site, and places in the middle part of its cells.

The part of a cell in which a plant may stand is a box around the cell's middle, `jitter` times as wide and high.
Densities are integrated over that box, and places are drawn from them in it: so nothing stands on barred ground, and
the density of all places together is that of the species wherever the cells are not full.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.placement.densities import COUNTING_CELLS, species_density
from forestgen.community.placement.stands import PlacementParameters


def lattice_shape(n: int, size_m: tuple[float, float]) -> tuple[int, int]:
    """Rows and columns of at least n cells, as near to squares as can be."""
    width, height = size_m
    free = math.sqrt(n * width / height)
    shapes = [(math.ceil(n / cols), cols) for cols in {max(1, math.floor(free)), max(1, math.ceil(free))}]
    return min(shapes, key=lambda shape: (abs(math.log(width * shape[0] / (height * shape[1]))), shape[0] * shape[1]))


@dataclass(frozen=True)
class Lattice:
    """The cells of a site and what each species has in their boxes. Cell k is row k // cols, column k % cols."""

    shape: tuple[int, int]  # rows, cols
    size_m: tuple[float, float]  # of the site
    part: NDArray[np.float64]  # (P,) share of each of a cell's P parts, along an axis, that lies in the box
    first: NDArray[np.float64]  # (P,) where in the cell, 0 to 1, that share begins
    last: NDArray[np.float64]  # (P,) and where it ends
    density: NDArray[np.float64]  # (S, rows P, cols P) of each species in the parts of all cells

    @property
    def weight(self) -> NDArray[np.float64]:
        """(S, cells) the density summed over the boxes."""
        (rows, cols), parts = self.shape, len(self.part)
        blocks = self.density.reshape(-1, rows, parts, cols, parts)
        sums = np.einsum("srpcq,p,q->src", blocks, self.part, self.part, optimize=True)
        return np.asarray(sums.reshape(len(blocks), rows * cols))

    def draw(
        self, cell: NDArray[np.integer], species: NDArray[np.integer], uniform: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(N, 2) places in the boxes of (N,) cells, metres, by the density of (N,) species; `uniform` is (N, 3)."""
        (rows, cols), parts = self.shape, len(self.part)
        row, col = np.asarray(cell) // cols, np.asarray(cell) % cols
        inside = np.arange(parts)
        own = self.density[
            np.asarray(species)[:, None, None],
            (row[:, None] * parts + inside)[:, :, None],
            (col[:, None] * parts + inside)[:, None, :],
        ]
        below = np.cumsum((own * self.part[:, None] * self.part).reshape(len(row), parts * parts), axis=1)
        chosen = np.argmax(below > uniform[:, :1] * below[:, -1:], axis=1)
        up, along = chosen // parts, chosen % parts
        x = col + self.first[along] + (self.last - self.first)[along] * uniform[:, 1]
        y = row + self.first[up] + (self.last - self.first)[up] * uniform[:, 2]
        return np.stack([x * (self.size_m[0] / cols), y * (self.size_m[1] / rows)], axis=1)


def lattice(
    parameters: PlacementParameters,
    site: Site,
    species: Sequence[SpeciesEcology],
    shape: tuple[int, int],
    jitter: float,
) -> Lattice:
    """The lattice of rows and columns whose boxes are `jitter` (0 to 1) of a cell wide.

    A cell has an odd number of parts along an axis, so that its middle is in the middle of a part, and so many that
    densities are read on about as fine a grid as plants are counted on.
    """
    parts = math.ceil(COUNTING_CELLS / max(shape))
    parts += 1 - parts % 2
    at = np.arange(parts, dtype=np.float64)
    middle, half = parts / 2, jitter * parts / 2
    first, last = np.clip(middle - half, at, at + 1), np.clip(middle + half, at, at + 1)
    part = last - first if jitter > 0 else (at == parts // 2).astype(np.float64)
    fine = (shape[0] * parts, shape[1] * parts)
    density = np.array([species_density(parameters, site, one.name, fine) for one in species])
    return Lattice(shape, site.size_m, part, first / parts, last / parts, density.reshape(len(species), *fine))
