"""Ecoclimates: forests of branch modules that depend on local soil water and temperature, and change both.

Reference: M. Makowski, 2023, chapter 4. Equations are numbered as there. The forest is that of `branch_modules`; soil
and climate are described in forestgen/community/soil_water.py and forestgen/community/ecoclimate, decisions in
docs/adr/0012-ecoclimates.md.

A step has whole months (`step_yr`; 1/12 by default). Each month, rain and warmth follow the `climate` and its
`climate_changes`; rain gathers on the ground, runs downhill, sinks in, the faster the more leaves stand there, and is
drunk by them. Then the plants grow, shed, seed and die for a step, each by its adaptation

    o = exp(-(T - T_A)^2 / (2 s_T^2)) exp(-(P - P_A)^2 / (2 s_P^2))        (38)

to the temperature at its foot, which shade cools, and to the water in the soil there, expressed as the rain that would
keep the soil equally wet. It scales the light that leaves use and caps the vigour of the root; what a module needs for
itself stays. So drought takes the darkest branches first, then crowns, then trees. ``microclimate: false`` hands over
means over the site instead: the paper's ablation.

Recipe::

    community: {model: ecoclimate, steps: 600, initial_plants: 300, climate: {place: Juneau}}

With ``weather: {}`` some days of each month are simulated as air over the forest: its clouds decide how much of the
region's rain falls here, and its currents how warm it is (forestgen/community/ecoclimate/air.py).

Columns are those of `branch_modules`. Maps of a snapshot: soil_water_mm, surface_water_mm, soil_mean_mm and
warmth_mean_k (over the plants' memory), vapour_mm_per_day (given to the air), wetness (rain over the region's). Its
state has ``water``: what fell, was drunk, was lost and is stored since the beginning, means over the site, mm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.community.branch_modules.capabilities import ModuleCapabilities
from forestgen.community.branch_modules.state import refuse_more_seeds
from forestgen.community.capabilities import SoilWaterMaps
from forestgen.community.disturbance import Planting
from forestgen.community.ecoclimate import months
from forestgen.community.ecoclimate.air import grid_of
from forestgen.community.ecoclimate.parameters import EcoclimateParameters, GlobalSeeding, seedings_in_time
from forestgen.community.models.branch_modules import MODEL as FOREST
from forestgen.community.models.branch_modules import most_seedlings, with_dead
from forestgen.community.population import Ecologies, Population, Site
from forestgen.community.simulation import CommunityPlan
from forestgen.community.snapshot_checks import ImpossibleValueError, check_number
from forestgen.community.soil_water import Ground, Water, WaterBudget
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.recipe.load import DrawnRecipe

_BYTES_PER_CELL = 400  # some fifty arrays of the water's sub-steps
_BYTES_PER_SEED = 200  # from elsewhere, of one step: places, climate and light there
_MOST_CELSIUS = 1000.0
_SOIL_DEPTH_M = {"forest": 1.0, "dryland": 0.05}  # by the kind of soil: ours
_MOST_WATER_MM = 1e12
_MAPS = ("soil_water_mm", "surface_water_mm", "soil_mean_mm", "warmth_mean_k", "vapour_mm_per_day", "wetness")


class EcoclimateModel(ModuleCapabilities):
    Parameters = EcoclimateParameters

    def init(self, parameters: EcoclimateParameters, site: Site, species: Ecologies, seed: int) -> months.Ecoclimate:
        """The forest of the start, on soil that is as wet as its climate leaves it."""
        return months.initial_ecoclimate(FOREST.init(parameters, site, species, seed))

    def step(self, state: months.Ecoclimate) -> months.Ecoclimate:
        """Whole months of climate and soil, then a step of the forest."""
        return months.step_ecoclimate(state)

    def population(self, state: months.Ecoclimate) -> Population:
        forest, soil, surface = FOREST.population(state.forest), state.water.soil_mm, state.water.surface_mm
        maps = soil, surface, state.soil_mean_mm, state.warmth_mean_k, state.vapour_mm_per_day, state.wetness
        water = {**vars(state.books), "stored_mm": state.stored_mm}
        about = {**forest.state, "water": water, "temperature_mean_c": state.temperature_mean_c}
        return replace(forest, state=about, maps=dict(zip(_MAPS, maps, strict=True)))

    def resume(
        self, parameters: EcoclimateParameters, site: Site, species: Ecologies, seed: int, population: Population
    ) -> months.Ecoclimate:
        """The state of a snapshot; it needs the snapshot's modules and maps."""
        forest = FOREST.resume(parameters, site, species, seed, population)
        if any(name not in population.maps for name in _MAPS):
            problem, expected = "a snapshot without its maps of water cannot go on", f"the maps {', '.join(_MAPS)}"
            got, hint = ", ".join(population.maps) or "none", "simulate again from the start"
            raise RecipeError(problem, where="community.model", expected=expected, got=got, hint=hint)
        soil, surface, mean, warmth, vapour, wetness = (population.maps[name] for name in _MAPS)
        temperature_c, water = population.state["temperature_mean_c"], population.state["water"]
        books = WaterBudget(**{name: float(water[name]) for name in WaterBudget.__dataclass_fields__})
        return months.Ecoclimate(forest, Water(soil, surface), mean, temperature_c, warmth, vapour, wetness, books)

    def check_snapshot(
        self, parameters: EcoclimateParameters, site: Site, species: Ecologies, population: Population
    ) -> None:
        """Refuse what no snapshot of a forest has, and books of water that no ground has; maps have a checksum."""
        FOREST.check_snapshot(parameters, site, species, population)
        state = population.state
        check_number(state, "temperature_mean_c", -_MOST_CELSIUS, _MOST_CELSIUS)
        water = state.get("water")
        if not isinstance(water, Mapping):
            raise ImpossibleValueError("water", "a table", f"{water!s:.80}")
        for name in WaterBudget.__dataclass_fields__:
            check_number(water, name, -_MOST_WATER_MM, _MOST_WATER_MM, within="water")

    def remove(self, state: months.Ecoclimate, plant_id: NDArray[np.uint32]) -> months.Ecoclimate:
        """The forest without these plants."""
        return replace(state, forest=FOREST.remove(state.forest, plant_id))

    def plant(self, state: months.Ecoclimate, planting: Planting) -> months.Ecoclimate:
        """The forest with new plants, seeds all."""
        return replace(state, forest=FOREST.plant(state.forest, planting))

    def expected_plants(self, parameters: EcoclimateParameters, site: Site, species: Ecologies) -> float:
        """Upper bound: as without water, and as many seedlings of seeds from elsewhere as find room."""
        total = FOREST.expected_plants(parameters, site, species)
        arrive = _seeds_arrive(parameters) and parameters.steps > 0
        return total + most_seedlings(parameters, site) * with_dead(parameters) if arrive else total

    def empty_reason(self, parameters: EcoclimateParameters, site: Site, species: Ecologies) -> str | None:
        return None if _seeds_arrive(parameters) else FOREST.empty_reason(parameters, site, species)

    def estimate_bytes(self, parameters: EcoclimateParameters, site: Site, species: Ecologies) -> int:
        """Of the forest, of the maps of water, and of the seeds from elsewhere that fall in a step."""
        cells = math.ceil(site.area_m2 / parameters.soil_water.cell_m**2)
        seeds = 0.0
        for place, one in seedings_in_time(parameters):
            seeds = max(seeds, _seeds_of_step(parameters, one, len(species)))
            refuse_more_seeds(seeds * site.area_ha, f"community.{place}")
        water_and_seeds = _BYTES_PER_CELL * cells + _BYTES_PER_SEED * math.ceil(seeds * site.area_ha)
        return FOREST.estimate_bytes(parameters, site, species) + water_and_seeds

    def air_grid(self, drawn: DrawnRecipe, parameters: EcoclimateParameters) -> AirGrid:
        """`OwnAir`: the cells of the air that a picture shows."""
        return grid_of(months.shown_section(drawn, parameters), Ground(drawn.recipe.site.size_m, (1, 1)))

    def air(self, plan: CommunityPlan, population: Population, progress: Progress) -> Weather:
        """`OwnAir`: a day of the month after the snapshot, which needs its modules and maps."""
        drawn, parameters = plan.drawn, plan.parameters
        assert isinstance(parameters, EcoclimateParameters)
        state = self.resume(parameters, plan.site, plan.ecologies, drawn.image_seed, population)
        return months.shown_weather(drawn, months.shown_section(drawn, parameters), state, progress)

    def soil_water(self, parameters: EcoclimateParameters, population: Population) -> SoilWaterMaps:
        """`SoilWater`: the maps of a snapshot."""
        maps, depth_m = population.maps, _SOIL_DEPTH_M[parameters.soil_water.kind]
        return SoilWaterMaps(maps["soil_water_mm"], maps["surface_water_mm"], depth_m)


def _seeds_arrive(parameters: EcoclimateParameters) -> bool:
    """Whether seeds come from elsewhere at any time."""
    return any(one for _, one in seedings_in_time(parameters))


def _seeds_of_step(parameters: EcoclimateParameters, seedings: Sequence[GlobalSeeding], kinds: int) -> float:
    """The most seeds from elsewhere on a hectare in a step, in the mean; of so many species where all seed."""
    return sum(
        math.ceil(parameters.step_yr / one.every_yr) * one.seeds_per_ha * (len(one.species) or kinds)
        for one in seedings
    )


MODEL = EcoclimateModel()
