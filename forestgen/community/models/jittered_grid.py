"""A lattice of cells with a plant in each, moved at random inside its cell.

Reference: F. Neyret, Synthesizing verdant landscapes using volumetric textures, Eurographics Workshop on Rendering,
1996, after B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, section 3.2.

The site is divided into cells, as near to squares as can be. A plant stands in a cell at

    centre + J (u - 1/2) times the cell's width, and so for its height,    u uniform in [0, 1):

J = 0 is a plantation in rows, J = 1 fills the cell. With a density, map times conditions, the cells are as many as
fill the densest ground; the asked number of them is chosen, each with a probability in proportion to the density in
it. A chosen cell goes to species s with the probability that species s has there, q_s = n_s f_s / Σ_t n_t f_t with f
of integral 1.

Parameters: see below; J is jitter. f and n are those of `plants`. Radii and heights follow from the
species' max_radius_m and height_m.

Recipe::

    community: {model: jittered_grid, jitter: 0.5, plants: {poplar: {plants_per_ha: 400}}}

Decisions
---------
- The number asked for is placed exactly, of each species. A lattice has rows times columns, which seldom is that
  number: the next larger one is taken, and cells left empty are drawn at random. So a plantation without a gap needs
  a number that fits, such as a square number on a square site.
- One lattice serves all species. Sizes are independent of places.
- There is at most one plant a cell. Cells are at most 16 times the plants: where the density is more than sixteen
  times its mean, cells are full, and the plants beyond that stand on the rest of the ground, by its density.
- A cell's density is that of the box that jitter reaches: at J = 0 that of its middle alone. So numbers follow the map
  exactly at J = 1, and but for the cells on its edges at less.
- A site of which keep_out bars a part has smaller cells, not fewer plants.
- `periodic` changes nothing: opposite edges of the lattice fit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.placement.densities import COUNTING_CELLS, PlacementParameters
from forestgen.community.placement.labelling import Lattice, assign, choose, label, lattice, lattice_shape
from forestgen.community.placement.model import PlacementModel, PlantingTargets
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.recipe.fields import Fraction

_CELLS_PER_PLANT = 16  # at most
_ROUNDS = 8  # of making cells smaller: barred ground and the edges of maps cut cells


class JitteredGridParameters(PlacementParameters):
    """What a recipe says about the model besides its species."""

    jitter: Fraction = Field(0.8, description="part of its cell in which a plant may stand; 0: in the middle")


def _fine_enough(
    parameters: JitteredGridParameters, site: Site, species: Ecologies, counts: NDArray[np.integer]
) -> tuple[Lattice, Floats]:
    """The lattice whose fullest cell expects one plant, and (S, cells) how many plants of a species a cell expects."""
    n = int(counts.sum())
    cells = n
    for _ in range(_ROUNDS):
        grid = lattice(parameters, site, species, lattice_shape(cells, site.size_m), parameters.jitter)
        total = grid.weight.sum(axis=1)
        scale = np.divide(counts, total, out=np.zeros(len(total)), where=total > 0)
        shares = grid.weight * scale[:, None]
        expected = shares.sum(axis=0)
        fullest, taken = float(expected.max()), int(np.count_nonzero(expected))
        if cells >= _CELLS_PER_PLANT * n or (fullest <= 1.0 + 1e-9 and taken >= min(n, round(expected.sum()))):
            break
        cells = min(_CELLS_PER_PLANT * n, math.ceil(cells * max(fullest, 1.01)))
    return grid, shares


class JitteredGrid(PlacementModel[JitteredGridParameters]):
    Parameters = JitteredGridParameters
    missing_reason = "no cell is left where the map and the conditions allow one"

    def positions(
        self,
        parameters: JitteredGridParameters,
        site: Site,
        species: Ecologies,
        wanted: PlantingTargets,
        rng: np.random.Generator,
    ) -> tuple[Floats, str]:
        """The plants of all species on one lattice."""
        if not len(wanted.sp):
            return np.zeros((0, 2)), self.missing_reason
        counts = np.bincount(wanted.sp, minlength=len(species))
        grid, shares = _fine_enough(parameters, site, species, counts)
        able = np.where(shares.any(axis=1), counts, 0)
        cell = choose(shares.sum(axis=0), int(able.sum()), rng)
        # Of fewer cells than plants, the largest plants have theirs.
        able = np.bincount(wanted.sp[able[wanted.sp] > 0][: len(cell)], minlength=len(species))
        labels = label(shares[:, cell], able, rng)
        places = np.full((len(cell), 2), np.nan)
        given = labels >= 0
        places[given] = grid.draw(cell[given], labels[given], rng.random((int(given.sum()), 3)))
        return assign(wanted, places, labels, rng), self.missing_reason

    def estimate_bytes(self, parameters: JitteredGridParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and the finest lattice at once."""
        cells = _CELLS_PER_PLANT * int(self.expected_plants(parameters, site, species))
        grids = 8 * (9 * COUNTING_CELLS**2 + 2 * cells)
        return super().estimate_bytes(parameters, site, species) + grids * (2 + len(species))


MODEL = JitteredGrid()
