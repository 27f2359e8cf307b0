"""What a recipe's community is simulated from, once its keys are checked; and its obstacles, which are no plants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from forestgen.community.model import CommunityParameters
from forestgen.community.population import Population, Site, SpeciesEcology, ecology_of
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Building


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
        if not self.entries:
            return population
        names = population.species_names
        stays = np.array([name not in self.counts for name in names], dtype=np.bool_)
        number = np.cumsum(stays) - 1  # of each species among those that stay
        rows = stays[population.species]
        arrays = ("plant_id", "position_m", "radius_m", "height_m", "age_yr", "status")
        return replace(
            population,
            species_names=tuple(name for name in names if name not in self.counts),
            species=number[population.species[rows]].astype(np.uint16),
            columns={name: values[rows] for name, values in population.columns.items()},
            modules=None,
            **{name: getattr(population, name)[rows] for name in arrays},
        )

    def turned(self, population: Population) -> Population:
        """The population with buildings' azimuths in the column `azimuth_deg`, which the scene places plants by."""
        if not self.entries:
            return population
        azimuth_deg = population.columns.get("azimuth_deg", np.full(len(population), np.nan)).astype(np.float64)
        for row, one in self.rows_of(population).items():
            azimuth_deg[row] = one.azimuth_deg
        return replace(population, columns={**population.columns, "azimuth_deg": azimuth_deg})


NO_OBSTACLES = Obstacles()


@dataclass(frozen=True)
class CommunityPlan:
    """A community model with its parameters, its site and its species."""

    drawn: DrawnRecipe
    model: Any  # a CommunityModel
    parameters: CommunityParameters
    site: Site
    ecologies: list[SpeciesEcology]  # of the species, then of kinds of buildings, which do not grow
    obstacles: Obstacles

    @classmethod
    def of(cls, drawn: DrawnRecipe, model: Any, parameters: CommunityParameters, site: Site) -> CommunityPlan:
        """The plan of a drawn recipe."""
        obstacles = Obstacles(site.buildings)
        ecologies = [ecology_of(name, species) for name, species in drawn.species.items()]
        return cls(drawn, model, parameters, site, ecologies + obstacles.ecologies(), obstacles)

    @property
    def steps(self) -> int:
        return self.parameters.steps

    @property
    def empty_reason(self) -> str | None:
        """Why no plant can ever grow; None if some may. An empty site is no error."""
        reason: str | None = self.model.empty_reason(self.parameters, self.site, self.ecologies)
        return reason
