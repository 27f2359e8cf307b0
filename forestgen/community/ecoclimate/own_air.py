"""The air over an ecoclimate in a picture: a day of the month after a snapshot, as the community would simulate it.

It is kept with other weather, by the hash of what the hours of a day begin with.
"""

from __future__ import annotations

import hashlib
from typing import Any

from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.grid import Weather
from forestgen.atmosphere.simulate import described, read_weather, weather_store
from forestgen.community.branch_modules.changes import parameters_at
from forestgen.community.ecoclimate.air import hours_of
from forestgen.community.ecoclimate.months import air_over
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.ecoclimate.state import Ecoclimate
from forestgen.community.ecoclimate.weather_section import WeatherSection
from forestgen.core.code_hash import code_hash
from forestgen.core.errors import RecipeError
from forestgen.core.packed import pack
from forestgen.core.progress import Progress
from forestgen.recipe.load import DrawnRecipe

_MOST_S = 86_400.0
_SOURCES = ("atmosphere", "community", "core")
_COMPUTE_WITH = ("numpy", "scipy", "numba")


def shown_section(drawn: DrawnRecipe, parameters: EcoclimateParameters) -> WeatherSection:
    """The community's weather at its last step, with the cells and the hours of the picture.

    Raises
    ------
    RecipeError : no weather then; no such time; too many cells, or too few.
    """
    clouds: Any = drawn.recipe.sky.clouds
    types = {name: one.modules for name, one in drawn.species.items() if one.modules is not None}
    at_the_end, _ = parameters_at(parameters, types, parameters.steps)
    assert isinstance(at_the_end, EcoclimateParameters)
    section = at_the_end.weather
    if section is None:
        turned_off = parameters.weather is not None
        raise RecipeError(
            "the community simulates no air" + (" any more when the picture is taken" if turned_off else ""),
            where=drawn.where("sky", "clouds", "type"),
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


def shown_weather(drawn: DrawnRecipe, section: WeatherSection, state: Ecoclimate, progress: Progress) -> Weather:
    """The air at the end of the hours that are simulated of a day, from the cache or simulated.

    Raises
    ------
    RecipeError : the air cannot be stepped.
    """
    clouds: Any = drawn.recipe.sky.clouds
    case = air_over(state, section, clouds.day or 0)
    told = (code_hash(_SOURCES, _COMPUTE_WITH), section.hours, described(case))
    key, store = hashlib.blake2b(repr(told).encode(), digest_size=20).hexdigest(), weather_store()
    kept = None if store is None else read_weather(store, key)
    if kept is not None:
        return kept
    try:
        with progress.stage("weather", 1) as advance:
            weather = hours_of(section, case.grid, case.day, case.surface).weather
            advance(1)
    except UnstableError as cause:
        raise RecipeError(
            "the air over the community cannot be simulated",
            where=drawn.where("sky", "clouds"),
            expected="air that stays slower than any storm",
            got=str(cause),
            hint="lower the heat, the vapour or the wind of community.weather, or make the cells larger",
        ) from cause
    if store is not None:
        store.write(key, pack(weather))
        store.trim()
    return weather
