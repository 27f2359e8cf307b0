"""What stands on a site and is no plant: its outline, and a population without it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population


@dataclass(frozen=True)
class Outline:
    """The ground plan of an obstacle."""

    name: str  # of its species
    corners_m: NDArray[np.float64]  # (4, 2) world x and y, in their order round it


@dataclass(frozen=True)
class Obstacles:
    """The obstacles of a site, and the species that are none but such."""

    outlines: tuple[Outline, ...] = ()
    species: frozenset[str] = frozenset()

    @cached_property
    def counts(self) -> dict[str, int]:
        """How many there are of each species that has some."""
        names = [one.name for one in self.outlines]
        return {name: names.count(name) for name in dict.fromkeys(names)}

    def left_out_of(self, population: Population) -> Population:
        """The plants of a snapshot: no row is an obstacle, and no species' name; modules are left out, too."""
        return _without_species(population, self.species) if self.species else population


NO_OBSTACLES = Obstacles()


def _without_species(population: Population, left_out: Collection[str]) -> Population:
    names = population.species_names
    stays = np.array([name not in left_out for name in names], dtype=np.bool_)
    number = np.cumsum(stays) - 1  # of each species among those that stay
    rows = stays[population.species]
    return replace(
        population,
        species_names=tuple(name for name in names if name not in left_out),
        plant_id=population.plant_id[rows],
        species=number[population.species[rows]].astype(np.uint16),
        position_m=population.position_m[rows],
        radius_m=population.radius_m[rows],
        height_m=population.height_m[rows],
        age_yr=population.age_yr[rows],
        status=population.status[rows],
        columns={name: values[rows] for name, values in population.columns.items()},
        modules=None,
    )
