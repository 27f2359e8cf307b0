"""The ground of a recipe's site: one height function for the community and for the scene, and how wet its soil is."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from forestgen.community.capabilities import SoilWater, capability, models_with
from forestgen.community.model import Site
from forestgen.community.plan import CommunityPlan
from forestgen.community.population import Population
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import TERRAINS
from forestgen.recipe.schema import Terrain, WetSoil
from forestgen.scene.soil_colour import Wetness
from forestgen.scene.terrain import HeightField, smooth_step

_LEAST_MM = 1e-6  # of water: less would divide to infinity, or by 0


def height_field(drawn: DrawnRecipe) -> HeightField:
    """Height of the ground at any x and y; the same object whenever a recipe's image is asked for again.

    Raises `RecipeError`: a map of heights that cannot be read, has holes, or has not the site's shape; with its line.
    """
    site = drawn.recipe.site
    try:
        return _height_field(site.size_m, site.terrain, drawn.image_seed, drawn.folder)
    except AssetError as cause:
        where = drawn.where("site", "terrain", *TERRAINS.load(site.terrain.kind).file_keys)
        raise cause.at(where) from cause


@lru_cache(maxsize=16)
def _height_field(size_m: tuple[float, float], terrain: Terrain, image_seed: int, folder: Path) -> HeightField:
    height: HeightField = TERRAINS.load(terrain.kind).height(terrain, size_m, image_seed, folder)
    return height


def community_site(drawn: DrawnRecipe) -> Site:
    """The site as its community knows it. The height function is kept, so that sites of one image are equal."""
    site = drawn.recipe.site
    terrain = site.terrain
    return Site(
        site.size_m,
        height=None if TERRAINS.load(terrain.kind).is_level(terrain) else height_field(drawn),
        altitude_m=site.altitude_m,
        latitude_deg=site.latitude_deg,
        wind_from_deg=site.wind_from_deg,
        buildings=site.buildings,
    )


def check_wet_soil(plan: CommunityPlan) -> None:
    """Raise `RecipeError` for a recipe that says how wet soil shows where its community knows of none."""
    drawn, section = plan.drawn, plan.drawn.recipe.site.wet_soil
    if section is not None and section.shown and capability(plan.model, SoilWater) is None:
        raise RecipeError(
            "this community knows no water in its soil",
            where=drawn.where("site", "wet_soil"),
            expected=f"community.model: {models_with(SoilWater)}",
            got=drawn.recipe.community.model,
            hint="leave out site.wet_soil; site.ground: soil_wet is wet everywhere",
        )


def wetness_of(plan: CommunityPlan, population: Population) -> Wetness | None:
    """Saturation of the site's soil by the maps of a snapshot; None: unknown, or not to be shown."""
    section, water = plan.drawn.recipe.site.wet_soil or WetSoil(), capability(plan.model, SoilWater)
    if not section.shown or water is None:
        return None
    soil_mm, surface_mm, depth_m = water.soil_water(plan.parameters, population)
    full_mm = max(1000.0 * (section.depth_m or depth_m) * section.porosity, _LEAST_MM)
    drowned = smooth_step(surface_mm / max(section.pond_mm, _LEAST_MM) - 1.0)
    saturation = np.maximum(soil_mm / full_mm, drowned)
    return Wetness(plan.site.size_m, np.minimum(saturation, 1.0))
