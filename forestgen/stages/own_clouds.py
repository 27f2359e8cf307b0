"""Clouds of the community's own air: what can be told before it is simulated."""

from __future__ import annotations

from typing import Any

from forestgen.atmosphere.weather import AirGrid
from forestgen.community.branch_modules.changes import parameters_at
from forestgen.community.ecoclimate.air import grid_of
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.ecoclimate.weather_section import WeatherSection
from forestgen.community.model import CommunityParameters
from forestgen.community.soil_water.ground import Ground
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe

_MOST_S = 86_400.0


def own_section(drawn: DrawnRecipe, parameters: CommunityParameters) -> WeatherSection:
    """The community's weather at its last step, with the cells and the hours of the picture.

    Raises
    ------
    RecipeError : it simulates no air when the picture is taken; or too many cells, or too few; with the key's line.
    """
    clouds: Any = drawn.recipe.sky.clouds
    where = drawn.where("sky", "clouds", "type")
    if not isinstance(parameters, EcoclimateParameters):
        raise RecipeError(
            "this community has no air of its own",
            where=where,
            expected="community.model: ecoclimate, with a section weather",
            got=drawn.recipe.community.model,
            hint="set sky.clouds=cumulus for clouds that know no plants",
        )
    types = {name: one.modules for name, one in drawn.species.items() if one.modules is not None}
    at_the_end, _ = parameters_at(parameters, types, parameters.steps)
    assert isinstance(at_the_end, EcoclimateParameters)
    section = at_the_end.weather
    if section is None:
        turned_off = parameters.weather is not None
        raise RecipeError(
            "the community simulates no air" + (" any more when the picture is taken" if turned_off else ""),
            where=where,
            expected="a section community.weather",
            got="a change to weather: null" if turned_off else "none",
            hint="leave out that change" if turned_off else "set community.weather={} for one with usual values",
        )
    if clouds.time_s is not None and not 0 < clouds.time_s <= _MOST_S:
        raise RecipeError(
            "no time of the day's simulated hours",
            where=drawn.where("sky", "clouds", "time_s"),
            expected=f"more than 0 and at most {_MOST_S:g} s",
            got=f"{clouds.time_s:g}",
        )
    hours = None if clouds.time_s is None else clouds.time_s / 3600.0
    given = {"cell_m": clouds.cell_m, "cell_height_m": clouds.cell_height_m, "hours": hours}
    own = {key: value for key, value in given.items() if value is not None}
    return drawn.parse(WeatherSection, {**section.model_dump(), **own}, ("sky", "clouds"))


def own_grid(drawn: DrawnRecipe, parameters: CommunityParameters) -> AirGrid:
    """The cells of the air that the picture shows."""
    return grid_of(own_section(drawn, parameters), Ground(drawn.recipe.site.size_m, (1, 1)))
