"""The recipe's sky as the scene has it: the sun's place is worked out where the recipe gives a date."""

from __future__ import annotations

from forestgen.atmosphere.daylight import SunPosition, sun_position
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.schema import Recipe
from forestgen.recipe.sky import SkySection
from forestgen.scene.spec import Sky


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
    """Sun and sky of a recipe whose sun is up; see `check_sun`."""
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
    )


def check_sun(drawn: DrawnRecipe) -> None:
    """Raise `RecipeError` if the sun is below the horizon at the recipe's date, time and place."""
    moment = drawn.recipe.sky.sun.moment
    if moment is None:
        return
    sun, site = sun_of(drawn.recipe), drawn.recipe.site
    if sun.elevation_deg <= 0:
        raise RecipeError(
            "the sun is below the horizon",
            where=drawn.where("sky", "sun", "time" if drawn.recipe.sky.sun.time is not None else "date"),
            expected=f"a time of day at latitude {site.latitude_deg:g}, longitude {site.longitude_deg:g}",
            got=f"{moment:%Y-%m-%d %H:%M:%S %Z}, when the sun stands at {sun.elevation_deg:.1f} degrees",
            hint="choose another time; check utc_offset_h and the sign of longitude_deg, which is positive in the east",
        )
