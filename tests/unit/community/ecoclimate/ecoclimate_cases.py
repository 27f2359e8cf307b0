"""Small ecoclimates for tests: a few plants on a few cells."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

from forestgen.community.branch_modules.growth import stature_of
from forestgen.community.branch_modules.state import Surroundings, step_parameters, surroundings_of
from forestgen.community.ecoclimate.months import Ecoclimate
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.models.ecoclimate import MODEL
from forestgen.community.population import Site, SpeciesEcology
from forestgen.recipe.species import PlantType

SITE = Site((15.0, 12.0))
STEADY = {"temperature_c": [10.0] * 12, "precipitation_mm": [60.0] * 12}
SEASONS = {
    "temperature_c": [-3.0, -2.0, 1.0, 5.0, 10.0, 14.0, 16.0, 15.0, 11.0, 6.0, 1.0, -2.0],
    "precipitation_mm": [90.0, 70.0, 40.0, 30.0, 10.0, 0.0, 5.0, 20.0, 60.0, 120.0, 150.0, 110.0],
}


def hills(x: Any, y: Any) -> Any:
    """Ridges along y that fall to the north, metres."""
    return 1.5 * np.sin(0.8 * x) - 0.2 * y


HILLY = Site(SITE.size_m, hills)


def plant_type(**more: Any) -> PlantType:
    """A small fast tree, at ease in the climates of these tests."""
    numbers = {
        "life_span_yr": 60, "root_vigour_max": 60, "growth_rate_per_yr": 0.8, "apical_control": 0.7, "determinacy": 0.8,
        "flowering_age_yr": 2, "seeds_per_yr": 2.0, "seeding_radius_m": 3.0, "shade_tolerance": 0.6,
        "temperature_c": 8.0, "temperature_width_c": 8.0,
        "precipitation_mm_per_yr": 700.0, "precipitation_width_mm_per_yr": 500.0,
    }  # fmt: skip
    return PlantType.model_validate({**numbers, **more})


def ecology(name: str = "tree", **more: Any) -> SpeciesEcology:
    return SpeciesEcology(name, 0.1, 5.0, 0.5, 0.9, 0.0, 0.1, 4.0, 0.75, modules=plant_type(**more))


def parameters(**keys: Any) -> EcoclimateParameters:
    """Parameters of a small case; `soil_water` adds to cells of 3 m and sub-steps of 3 days."""
    soil = {"cell_m": 3.0, "substep_days": 3.0, **keys.pop("soil_water", {})}
    given = {"climate": SEASONS, "initial_plants": 12, "steps": 10_000, "soil_water": soil, **keys}
    return EcoclimateParameters.model_validate(given)


def states(site: Site = SITE, species: list[SpeciesEcology] | None = None, seed: int = 1, **keys: Any) -> Iterator[Any]:
    """The states of a small case, without end."""
    state = MODEL.init(parameters(**keys), site, species or [ecology()], seed)
    while True:
        yield state
        state = MODEL.step(state)


def after(steps: int, site: Site = SITE, species: list[SpeciesEcology] | None = None, **keys: Any) -> Ecoclimate:
    """The state after so many steps."""
    found: Ecoclimate = next(islice(states(site, species, **keys), steps, None))
    return found


def around(state: Ecoclimate) -> Surroundings:
    """What the plants of a state see of one another."""
    kinds = step_parameters(state.forest)
    stature = stature_of(state.forest.modules, state.forest.plants.species, kinds)
    return surroundings_of(state.forest, kinds, stature.leaves)
