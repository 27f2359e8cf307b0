"""Where the seeds of each species fall: the ground's own density, and the field that inviting plants make of it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.growing.interactions import Interactions, Rivals, invitation
from forestgen.community.model import Site
from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, relative_density
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.placement.field import DensityField
from forestgen.core.cache import BoundedCache
from forestgen.recipe.fields import Section

_CELLS_PER_REACH = 6
_means: BoundedCache[float] = BoundedCache(256, lambda _: 1)  # a plan asks for the same many times; densities are large
_FEWEST_CELLS, _MOST_CELLS = 64, 1024  # along the site's longer side, unless a recipe says otherwise


class GroundSection(Section):
    """What the ground is to one species."""

    map: DensityMap | None = Field(None, description="Relative density of seedlings over the site.")
    conditions: Conditions = Field(Conditions(), description="What the species asks of the ground.")


@dataclass(frozen=True)
class Ground:
    """The species' relative densities b_i, on one grid; each is made when it is first asked for, and kept."""

    shape: tuple[int, int]  # rows, columns
    mean: NDArray[np.float64]  # (S,) of each density
    _size_m: tuple[float, float]
    _makers: tuple[Callable[[], NDArray[np.float64]] | None, ...]  # of each species' density; None: it is 1 everywhere

    @cached_property
    def density(self) -> tuple[NDArray[np.float64] | None, ...]:
        """(rows, cols) of each species, row 0 at y = 0; None: 1 everywhere."""
        return tuple(None if make is None else make() for make in self._makers)

    @cached_property
    def bare(self) -> tuple[DensityField | None, ...]:
        """The densities where nobody invites, ready to draw from."""
        return tuple(None if one is None else DensityField(one, self._size_m, periodic=True) for one in self.density)


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
    makers = tuple(
        partial(relative_density, section.conditions, section.map, keep_out, site, shape) if varies else None
        for section, varies in zip(given, varied, strict=True)
    )
    mean = [
        1.0 if make is None else _mean(make, section, keep_out, site, shape)
        for section, make in zip(given, makers, strict=True)
    ]
    return Ground(shape, np.array(mean, dtype=np.float64), site.size_m, makers)


def _mean(
    make: Callable[[], NDArray[np.float64]],
    section: GroundSection,
    keep_out: DensityMap | None,
    site: Site,
    shape: tuple[int, int],
) -> float:
    """Mean of the density that `make` makes of the others; maps of files are told apart by their SHA-256."""
    maps = [one for one in (section.map, keep_out) if one is not None]
    if any(one.rows is None and one.sha256 is None for one in maps):
        return float(make().mean())
    said = section.model_dump_json() + (keep_out.model_dump_json() if keep_out is not None else "")
    return _means.get((hashlib.sha256(said.encode()).digest(), site, shape), lambda: float(make().mean()))


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
