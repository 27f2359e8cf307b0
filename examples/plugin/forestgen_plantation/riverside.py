"""Trees along a river: seedlings come up near the water, widen from year to year, and die at a constant rate."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.population import Ecologies, Population, Site
from forestgen.community.static_model import Change, GrowingModel, Placement, StaticParameters


class Keys(StaticParameters):
    """Keys of `community: {model: riverside}`."""

    reach_m: float = Field(12.0, gt=0, description="distance over which seedlings become fewer, to 1/e = 37%, metres")
    river_m: float = Field(4.0, ge=0, description="width of the river, which runs along y through the middle, metres")
    lifetime_yr: float = Field(60.0, gt=0, description="mean life of a plant, years")


class Riverside(GrowingModel[Keys]):
    """Trees along a river."""

    Parameters = Keys

    def most_plants(self, parameters: Keys, site: Site, species: Ecologies) -> float:
        return (parameters.steps + 1) * sum(_arrivals(parameters, site, species))

    def place(self, parameters: Keys, site: Site, species: Ecologies, rng: Generator) -> Placement:
        """Seedlings of one step: d metres from the bank, of exp(-d / reach_m) of those of open ground."""
        kinds = np.repeat(np.arange(len(species)), rng.poisson(_arrivals(parameters, site, species)))
        position_m = rng.random((len(kinds), 2)) * site.size_m
        bank_m = abs(position_m[:, 0] - site.size_m[0] / 2) - parameters.river_m / 2
        up = (bank_m >= 0) & (rng.random(len(kinds)) < np.exp(-bank_m / parameters.reach_m))
        return Placement(kinds[up], position_m[up], _of(species, "seedling_radius_m")[kinds[up]])

    def change(
        self, parameters: Keys, site: Site, species: Ecologies, population: Population, rng: Generator
    ) -> Change:
        grown_m = population.radius_m + _of(species, "growth_m_per_yr")[population.species] * parameters.step_yr
        radius_m = np.minimum(grown_m, _of(species, "max_radius_m")[population.species])
        dead = rng.random(len(population)) < -np.expm1(-parameters.step_yr / parameters.lifetime_yr)
        return Change(dead, radius_m, arrivals=self.place(parameters, site, species, rng))


def _arrivals(parameters: Keys, site: Site, species: Ecologies) -> NDArray[np.float64]:
    return _of(species, "seedlings_per_ha_per_yr") * site.area_ha * parameters.step_yr


def _of(species: Ecologies, name: str) -> NDArray[np.float64]:
    return np.array([getattr(one, name) for one in species])


MODEL = Riverside()
