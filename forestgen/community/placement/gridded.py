"""Densities on one grid of a recipe's choice: what the models that place plants without a deformed field share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.placement.densities import grid_shape, species_density
from forestgen.community.placement.model import PlacementModel
from forestgen.community.placement.stands import PlacementParameters
from forestgen.recipe.fields import Whole

_Kind = TypeVar("_Kind", np.float64, np.bool_)
_GRIDS_AT_ONCE = 6  # beside one a species: masks, sums, a field's own


class GriddedParameters(PlacementParameters):
    """The parameters of a model that reads densities on a grid."""

    memory_hint: ClassVar[str] = f"{PlacementParameters.memory_hint}, or fewer community.cells"

    cells: Whole = Field(
        512,
        ge=16,
        le=8192,
        description="cells along the site's longer side in which map and conditions are read; a cell has one density",
    )


P = TypeVar("P", bound=GriddedParameters)


class GriddedModel(PlacementModel[P]):
    """A `PlacementModel` whose densities are constant in the cells of one grid."""

    def grid(self, parameters: P, site: Site, name: str, n: int) -> tuple[int, int]:
        """By the recipe's `cells`."""
        return grid_shape(site, parameters.cells)

    def estimate_bytes(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for all plants and all grids at once."""
        rows, cols = grid_shape(site, parameters.cells)
        grids = 8 * rows * cols * (_GRIDS_AT_ONCE + len(parameters.plants))
        return super().estimate_bytes(parameters, site, species) + grids


def read_densities(
    parameters: GriddedParameters, site: Site, species: Sequence[SpeciesEcology]
) -> list[NDArray[np.float64]]:
    """(rows, cols) relative density of each species, row 0 at y = 0."""
    shape = grid_shape(site, parameters.cells)
    return [species_density(parameters, site, one.name, shape) for one in species]


def density_at(grid: NDArray[_Kind], position_m: NDArray[np.float64], size_m: tuple[float, float]) -> NDArray[_Kind]:
    """(N,) density of the cells in which (N, 2) places of the site lie."""
    rows, cols = grid.shape
    col = np.minimum((position_m[:, 0] * (cols / size_m[0])).astype(np.intp), cols - 1)
    row = np.minimum((position_m[:, 1] * (rows / size_m[1])).astype(np.intp), rows - 1)
    return np.asarray(grid[row, col])


def stays_apart(
    points_m: NDArray[np.float64], distance_m: float, size_m: tuple[float, float], *, periodic: bool
) -> NDArray[np.bool_]:
    """(N,) whether a point stays: it does unless it is nearer than the distance to one before it that stays.

    Parameters
    ----------
    points_m : (N, 2) metres, in [0, W) x [0, H) if `periodic`.
    """
    from scipy.spatial import cKDTree  # slow to import

    keep = np.ones(len(points_m), dtype=np.bool_)
    if len(points_m) < 2:
        return keep
    tree = cKDTree(points_m, boxsize=np.array(size_m) if periodic else None)
    near = tree.query_pairs(np.nextafter(distance_m, 0.0), output_type="ndarray")
    for a, b in near[np.lexsort((near[:, 1], near[:, 0]))].tolist():
        keep[b] = keep[b] and not keep[a]
    return keep
