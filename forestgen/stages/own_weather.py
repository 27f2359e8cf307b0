"""Population -> the air over it: a day of the month that comes after the snapshot, as the community would simulate it.

It is kept with other weather, by the hash of what the hours of a day begin with.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.kept_weather import read_weather, weather_store
from forestgen.atmosphere.simulate import described
from forestgen.atmosphere.weather import Weather
from forestgen.community.ecoclimate.air import hours_of
from forestgen.community.ecoclimate.months import air_over
from forestgen.community.population import Population
from forestgen.core.code_hash import code_hash
from forestgen.core.errors import RecipeError
from forestgen.core.packed import pack
from forestgen.core.progress import Progress
from forestgen.stages.own_clouds import own_section

if TYPE_CHECKING:
    from forestgen.stages.plan import Plan

_SOURCES = ("atmosphere", "community", "core")
_COMPUTE_WITH = ("numpy", "scipy", "numba")


def own_weather(plan: Plan, population: Population, progress: Progress) -> Weather:
    """The air at the end of the hours that are simulated of a day, from the cache or simulated.

    Parameters
    ----------
    population : the snapshot as the community left it, with its modules and maps.

    Raises
    ------
    RecipeError : the snapshot has no maps, or the air cannot be stepped.
    """
    clouds: Any = plan.drawn.recipe.sky.clouds
    section = own_section(plan.drawn, plan.model_parameters)
    seed = plan.drawn.image_seed
    state = plan.model.resume(plan.model_parameters, plan.site, plan.ecologies, seed, population)
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
            where=plan.drawn.where("sky", "clouds"),
            expected="air that stays slower than any storm",
            got=str(cause),
            hint="lower the heat, the vapour or the wind of community.weather, or make the cells larger",
        ) from cause
    if store is not None:
        store.write(key, pack(weather))
        store.trim()
    return weather
