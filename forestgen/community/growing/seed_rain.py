"""Where the seeds of each species fall: the ground's own density, and the field that inviting plants make of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.growing.interactions import Interactions, Rivals, invitation
from forestgen.community.model import Site, SpeciesEcology
from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, relative_density
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.placement.field import DensityField
from forestgen.recipe.fields import Section

_CELLS_PER_REACH = 6
_FEWEST_CELLS, _MOST_CELLS = 64, 1024  # along the site's longer side, unless a recipe says otherwise


class GroundSection(Section):
    """What the ground is to one species."""

    map: DensityMap | None = Field(None, description="Relative density of seedlings over the site.")
    conditions: Conditions = Field(Conditions(), description="What the species asks of the ground.")


@dataclass(frozen=True)
class Ground:
    """The species' relative densities b_i, on one grid."""

    shape: tuple[int, int]  # rows, columns
    density: tuple[NDArray[np.float64] | None, ...]  # (rows, cols) of each species, row 0 at y = 0; None: 1 everywhere
    mean: NDArray[np.float64]  # (S,) of each density
    bare: tuple[DensityField | None, ...]  # the densities where nobody invites, ready to draw from


def ground_of(
    sections: Mapping[str, GroundSection],
    keep_out: DensityMap | None,
    site: Site,
    species: Sequence[SpeciesEcology],
    kernels: Interactions,
    cells: int | None,
) -> Ground:
    """The ground that a recipe describes; `cells` along the site's longer side, None: as many as it takes."""
    plain = GroundSection.model_validate({})
    given = [sections.get(one.name, plain) for one in species]
    varied = [keep_out is not None or one != plain for one in given]
    shape = grid_shape(site, cells or _cells(site, species, kernels, any(varied)))
    density: list[NDArray[np.float64] | None] = []
    for section, varies in zip(given, varied, strict=True):
        density.append(relative_density(section.conditions, section.map, keep_out, site, shape) if varies else None)
    mean = [1.0 if one is None else float(one.mean()) for one in density]
    bare = [None if one is None else DensityField(one, site.size_m, periodic=True) for one in density]
    return Ground(shape, tuple(density), np.array(mean, dtype=np.float64), tuple(bare))


def _cells(site: Site, species: Sequence[SpeciesEcology], kernels: Interactions, varied: bool) -> int:
    """Cells along the longer side that inviting kernels ask for, and maps."""
    cells = COUNTING_CELLS if varied else _FEWEST_CELLS
    for affected, acting in np.argwhere(kernels.invites):
        half_grown = np.array([species[acting].max_radius_m / 2])
        reach_m = float(kernels.reach_m(int(affected), int(acting), half_grown)[0])
        cells = max(cells, round(min(_CELLS_PER_REACH * max(site.size_m) / reach_m, _MOST_CELLS)))
    return cells


def seed_rain(
    ground: Ground,
    affected: int,
    n: int,
    rivals: Rivals,
    kernels: Interactions,
    most_inviting: float,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """(n, 2) places, metres, drawn from the density times min(Π max(κ, 1), most_inviting) of the plants that stand."""
    uniform = rng.random((n, 2))
    if n == 0:
        return uniform
    density, field = ground.density[affected], ground.bare[affected]
    if len(rivals.r_m) and kernels.invites[affected].any():
        logs = invitation(rivals, kernels, affected, ground.shape)
        inviting = np.exp(np.minimum(logs, np.log(most_inviting)))
        inviting = inviting if density is None else inviting * density
        field = DensityField(inviting, rivals.size_m, periodic=rivals.periodic)
    return uniform * rivals.size_m if field is None else field.draw(uniform)
