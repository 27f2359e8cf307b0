"""A recipe's site as the scene has it: sun, sky, one height of the ground for community and scene, and wet soil."""

from __future__ import annotations

import datetime
import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from forestgen.atmosphere.daylight import SunPosition, sun_position
from forestgen.atmosphere.moon import MEAN_DISTANCE_KM, MoonPosition, moon_position
from forestgen.community.capabilities import SoilWater, capability, models_with
from forestgen.community.population import Population, Site
from forestgen.community.simulation import CommunityPlan
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.ground import WetSoil
from forestgen.recipe.land import MicroRelief, Paths, Waters
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import TERRAINS
from forestgen.recipe.schema import Recipe, Terrain
from forestgen.recipe.schema import Site as SiteSection
from forestgen.recipe.sky import SkySection
from forestgen.scene.shaped_ground import shaped
from forestgen.scene.spec import Moon, Sky, towards
from forestgen.scene.surfaces import Wetness
from forestgen.scene.terrain import HeightField, smooth_step

_SUN_SPARE_DEG = 2.0
_LEAST_MM = 1e-6  # of water: less would divide to infinity, or by 0


def sun_of(recipe: Recipe) -> SunPosition:
    """Where the sun stands, by the recipe's angles (at its mean distance) or by its date, time and place."""
    sun, site = recipe.sky.sun, recipe.site
    if sun.moment is None:
        assert sun.elevation_deg is not None
        assert sun.azimuth_deg is not None
        return SunPosition(sun.elevation_deg, sun.azimuth_deg, 1.0)
    assert site.longitude_deg is not None
    return sun_position(sun.moment, site.latitude_deg, site.longitude_deg, site.altitude_m)


def sky_of(recipe: Recipe, ground_albedo: float) -> Sky:
    """Sun, moon and sky of a recipe."""
    sun = sun_of(recipe)
    own = [key for key in type(recipe.sky).model_fields if key not in SkySection.model_fields]
    return Sky(
        sun_elevation_deg=sun.elevation_deg,
        sun_azimuth_deg=sun.azimuth_deg,
        turbidity=recipe.sky.turbidity,
        ground_albedo=ground_albedo,
        kind=recipe.sky.kind,
        altitude_m=recipe.site.altitude_m,
        sun_distance_au=sun.distance_au,
        precipitable_water_mm=recipe.sky.precipitable_water_mm,
        ozone_du=recipe.sky.ozone_du,
        visibility_m=recipe.sky.visibility_m,
        own=tuple((key, getattr(recipe.sky, key)) for key in own),
        moon=_moon_of(recipe, sun),
    )


def _moon_of(recipe: Recipe, sun: SunPosition) -> Moon | None:
    """The moon by the recipe's angles or by the sun's date; None: there is none, or the sun is up."""
    section, moment, site = recipe.sky.moon, recipe.sky.sun.moment, recipe.site
    if sun.elevation_deg > 0 or (section is None and moment is None):
        return None
    if section is not None:
        place = MoonPosition(section.elevation_deg, section.azimuth_deg, MEAN_DISTANCE_KM)
    else:
        assert moment is not None
        assert site.longitude_deg is not None
        place = moon_position(moment, site.latitude_deg, site.longitude_deg)
    if section is not None and section.illuminated is not None:
        phase = math.acos(2.0 * section.illuminated - 1.0)
    else:  # the sun is so far away that the angle at the moon is what is left of the half circle
        to_moon, to_sun = (towards(one.elevation_deg, one.azimuth_deg) for one in (place, sun))
        phase = math.pi - math.acos(float(np.clip(to_moon @ to_sun, -1.0, 1.0)))
    return Moon(place.elevation_deg, place.azimuth_deg, math.degrees(phase), place.distance_km)


def sun_notes(recipe: Recipe) -> list[str]:
    """Whether the sun is down at its date, or stands by its angles where it never is on the plants' day."""
    sun, site = recipe.sky.sun, recipe.site
    if sun.moment is not None and sun_of(recipe).elevation_deg <= 0:
        told = (
            f"the sun is {-sun_of(recipe).elevation_deg:.1f} degrees below the horizon at {sun.moment:%Y-%m-%d %H:%M}"
        )
        return [f"{told}; if no night is meant, check utc_offset_h and longitude_deg, which is positive in the east"]
    if site.date is None or sun.moment is not None or sun.elevation_deg is None:
        return []
    day = datetime.date.fromisoformat(site.date).timetuple().tm_yday
    # Declination within half a degree: Cooper, P. I. (1969). Solar Energy 12, 333-346.
    declination_deg = 23.45 * math.sin(2.0 * math.pi * (284 + day) / 365.0)
    noon_deg = 90.0 - abs(site.latitude_deg - declination_deg)
    if sun.elevation_deg <= max(noon_deg, 0.0) + _SUN_SPARE_DEG:
        return []
    told = f"the sun is {sun.elevation_deg:g} degrees high, but at most {max(noon_deg, 0.0):.0f} on {site.date}"
    return [f"{told} at latitude {site.latitude_deg:g}; sky.sun.date with its time puts it where it is"]


def height_field(drawn: DrawnRecipe) -> HeightField:
    """Height of the ground at any x and y; the same object whenever a recipe's image is asked for again.

    Raises `RecipeError`: a map of heights that cannot be read, has holes, or has not the site's shape; a stream that
    would run uphill; with its line.
    """
    site = drawn.recipe.site
    try:
        base = _height_field(site.size_m, site.terrain, drawn.image_seed, drawn.folder)
    except AssetError as cause:
        where = drawn.where("site", "terrain", *TERRAINS.load(site.terrain.kind).file_keys)
        raise cause.at(where) from cause
    if site.micro_relief is None and not site.paths and not site.water:
        return base
    try:
        return _shaped(base, site.micro_relief, site.paths, site.water, drawn.image_seed)
    except RecipeError as cause:
        raise cause.at(drawn.where("site", "water", int(cause.where or 0))) from cause


@lru_cache(maxsize=16)
def _shaped(base: HeightField, relief: MicroRelief | None, paths: Paths, water: Waters, image_seed: int) -> HeightField:
    return shaped(base, relief, paths, water, image_seed)


@lru_cache(maxsize=16)
def _height_field(size_m: tuple[float, float], terrain: Terrain, image_seed: int, folder: Path) -> HeightField:
    height: HeightField = TERRAINS.load(terrain.kind).height(terrain, size_m, image_seed, folder)
    return height


def community_site(drawn: DrawnRecipe) -> Site:
    """The site as its community knows it. The height function is kept, so that sites of one image are equal."""
    site = drawn.recipe.site
    return Site(
        site.size_m,
        height=None if _is_level(site) else height_field(drawn),
        altitude_m=site.altitude_m,
        latitude_deg=site.latitude_deg,
        wind_from_deg=site.wind_from_deg,
        buildings=site.buildings,
    )


def _is_level(site: SiteSection) -> bool:
    shaped_by = site.micro_relief, site.paths, site.water
    return TERRAINS.load(site.terrain.kind).is_level(site.terrain) and not any(shaped_by)


def check_wet_soil(plan: CommunityPlan) -> None:
    """Raise `RecipeError` for a recipe that says how wet soil shows where its community knows of none."""
    drawn, section = plan.drawn, plan.drawn.recipe.site.wet_soil
    if section is not None and section.shown and capability(plan.model, SoilWater) is None:
        problem, expected = "this community has no water in its soil", f"community.model: {models_with(SoilWater)}"
        got, hint = drawn.recipe.community.model, "leave out site.wet_soil; site.ground: soil_wet is wet everywhere"
        raise RecipeError(problem, where=drawn.where("site", "wet_soil"), expected=expected, got=got, hint=hint)


def wetness_of(plan: CommunityPlan, population: Population) -> Wetness | None:
    """Saturation of the site's soil by the maps of a snapshot; None: unknown, or not to be shown."""
    section, water = plan.drawn.recipe.site.wet_soil or WetSoil.model_validate({}), capability(plan.model, SoilWater)
    if not section.shown or water is None:
        return None
    soil_mm, surface_mm, depth_m = water.soil_water(plan.parameters, population)
    full_mm = max(1000.0 * (section.depth_m or depth_m) * section.porosity, _LEAST_MM)
    drowned = smooth_step(surface_mm / max(section.pond_mm, _LEAST_MM) - 1.0)
    saturation = np.maximum(soil_mm / full_mm, drowned)
    return Wetness(plan.site.size_m, np.minimum(saturation, 1.0))
