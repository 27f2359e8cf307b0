"""A community's maps of water -> how wet the ground of the scene is."""

from __future__ import annotations

import numpy as np

from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.model import CommunityParameters
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.wet_soil import WetSoil
from forestgen.scene.soil_colour import Wetness
from forestgen.scene.terrain import smooth_step

_DEPTH_M = {"forest": 1.0, "dryland": 0.05}  # by the kind of soil: ours
_LEAST_MM = 1e-6  # of water: less would divide to infinity, or by 0


def check_wet_soil(drawn: DrawnRecipe, parameters: CommunityParameters) -> None:
    """Refuse a recipe that says how wet soil shows where no community knows of any."""
    section = drawn.recipe.site.wet_soil
    if section is None or not section.shown or isinstance(parameters, EcoclimateParameters):
        return
    raise RecipeError(
        "this community knows no water in its soil",
        where=drawn.where("site", "wet_soil"),
        expected="community.model: ecoclimate",
        got=drawn.recipe.community.model,
        hint="leave out site.wet_soil; site.ground: soil_wet is wet everywhere",
    )


def wetness_of(drawn: DrawnRecipe, parameters: CommunityParameters, population: Population) -> Wetness | None:
    """Saturation of the site's soil by the maps of a snapshot; None: unknown, or not to be shown."""
    section = drawn.recipe.site.wet_soil or WetSoil()
    if not section.shown or not isinstance(parameters, EcoclimateParameters):
        return None
    depth_m = section.depth_m or _DEPTH_M[parameters.soil_water.kind]
    full_mm = max(1000.0 * depth_m * section.porosity, _LEAST_MM)
    drowned = smooth_step(population.maps["surface_water_mm"] / max(section.pond_mm, _LEAST_MM) - 1.0)
    saturation = np.maximum(population.maps["soil_water_mm"] / full_mm, drowned)
    return Wetness(drawn.recipe.site.size_m, np.minimum(saturation, 1.0))
