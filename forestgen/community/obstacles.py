"""What stands on a site and is no plant: buildings, as rows of a population."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.population import Population
from forestgen.recipe.buildings import Building


@dataclass(frozen=True)
class Obstacles:
    """The buildings of a site, where its community knows of them."""

    entries: tuple[Building, ...] = ()  # a population has them in its first rows by plant_id, in this order

    @property
    def counts(self) -> dict[str, int]:
        """How many there are of each kind."""
        kinds = [one.kind for one in self.entries]
        return {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}

    def ecologies(self) -> list[SpeciesEcology]:
        """What stands for each kind among the species of a community: it neither grows nor spreads."""
        return [SpeciesEcology(kind, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0) for kind in self.counts]

    def rows_of(self, population: Population) -> dict[int, Building]:
        """Row of the population -> the building that stands there."""
        rows = np.searchsorted(population.plant_id, np.arange(1, len(self.entries) + 1))
        return {int(row): one for row, one in zip(rows, self.entries, strict=True)}

    def left_out_of(self, population: Population) -> Population:
        """The plants of a snapshot: no row is a building, and no species' name; modules are left out, too."""
        return _without_species(population, self.counts) if self.entries else population

    def turned(self, population: Population) -> Population:
        """The population with buildings' azimuths in the column `azimuth_deg`, which the scene places plants by."""
        if not self.entries:
            return population
        azimuth_deg = population.columns.get("azimuth_deg", np.full(len(population), np.nan)).astype(np.float64)
        for row, one in self.rows_of(population).items():
            azimuth_deg[row] = one.azimuth_deg
        return replace(population, columns={**population.columns, "azimuth_deg": azimuth_deg})


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
