"""Months of an ecoclimate (Makowski 2023, Algorithm 1): climate, soil, and then the plants by what they felt of both.

A step has whole months. In each, rain falls by the climate, over the forest more or less of it as its own air makes
clouds (`air`; on request); the water on and in the soil goes on by the leaves that stand there (Eqs. 43, 44); and what
plants feel, a mean over their memory, follows. Then the plants go one step on, each by the soil water of its own cell
and by the shade at its foot (Eq. 38).

Plants get soil water as precipitation, the unit of their optima: the rain that would keep
the soil as wet under a stand of `reference_g_per_m2` of leaves, for ever:

    P = 365.25 (r W + g W / (W + k1) B_ref)

Without microclimate, every map is its mean where it is handed over: leaves to the soil, soil water and shade to plants.

A picture of an ecoclimate can show its air: a day of the month after a snapshot, as the community would simulate it. It
is kept with other weather, by the hash of what the hours of a day begin with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import spheres, terminal_leaf_area_m2
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import Tables
from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.grid import Weather
from forestgen.atmosphere.simulate import read_weather, weather_key, weather_store
from forestgen.community.branch_modules.parameters import parameters_at
from forestgen.community.branch_modules.state import LocalClimate, State, refuse_more_seeds, step_parameters
from forestgen.community.branch_modules.step import NO_SEEDS, Arriving, step_forest
from forestgen.community.ecoclimate.air import BoundaryConditions, Case, case_of, hours_of, month_of_air
from forestgen.community.ecoclimate.parameters import (
    DAYS_PER_MONTH,
    MONTHS_PER_YR,
    EcoclimateParameters,
    Month,
    WeatherSection,
    month_at,
)
from forestgen.community.population import Site
from forestgen.community.soil_water import Floats, Ground, SoilWater, SoilWaterParameters, Water, WaterBudget
from forestgen.core.array_serialization import pack
from forestgen.core.cache import BoundedCache, code_hash
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe

_DAYS_PER_YR = DAYS_PER_MONTH * MONTHS_PER_YR
_EXTINCTION = 0.5  # of leaves at all angles alike
_SPIN_UP_YR = 3  # of the water under the plants of the start
_MOST_S = 86_400.0
_SOURCES, _COMPUTE_WITH = ("atmosphere", "community", "core"), ("numpy", "scipy", "numba")


@dataclass(frozen=True)
class Ecoclimate:
    """Everything that the future of a simulation depends on."""

    forest: State
    water: Water
    soil_mean_mm: Floats  # (rows, cols) soil water over the memory of plants
    temperature_mean_c: float  # the same of the region's temperature at z = 0
    warmth_mean_k: Floats  # (rows, cols) the same of the place's own warmth
    vapour_mm_per_day: Floats  # (rows, cols) what the ground gave to the air in the last month
    wetness: Floats  # (rows, cols) last month's rain over the region's
    books: WaterBudget  # since the beginning

    @property
    def parameters(self) -> EcoclimateParameters:
        """What the next step goes by: with the recipe's changes up to now."""
        return parameters_of(self.forest)

    @property
    def stored_mm(self) -> float:
        """Mean water on the surface and in the soil."""
        return float(self.water.soil_mm.mean() + self.water.surface_mm.mean())


def parameters_of(forest: State) -> EcoclimateParameters:
    """The parameters at a forest's step, with the recipe's changes up to it."""
    parameters = step_parameters(forest).parameters
    assert isinstance(parameters, EcoclimateParameters)
    return parameters


def leaf_area_index(forest: State, ground: Ground) -> Floats:
    """(rows, cols) one-sided leaf area over the area of each cell: of the modules whose middle is over it.

    Leaves that hang beyond a bounded site's edge count for the cell at the edge.
    """
    tables, modules, plants = step_parameters(forest).tables, forest.modules, forest.plants
    rows, cols = ground.shape
    if not len(modules):
        return np.zeros(ground.shape)
    kind = np.repeat(plants.species, np.diff(modules.first))
    area_m2 = _leaf_area_m2(tables, modules, kind)
    centre, _ = spheres(tables, modules, plants.species)
    place = np.repeat(plants.position_m, np.diff(modules.first), axis=0) + centre[:, :2]
    cell = []
    for axis, count in ((1, rows), (0, cols)):
        at = np.floor(place[:, axis] / ground.size_m[axis] * count).astype(np.int64)
        cell.append(at % count if ground.periodic else np.clip(at, 0, count - 1))
    width_m, depth_m = ground.cell_m
    total = np.bincount(cell[0] * cols + cell[1], weights=area_m2, minlength=rows * cols)
    return np.asarray(total.reshape(rows, cols) / (width_m * depth_m))


def _leaf_area_m2(tables: Tables, modules: Modules, kind: NDArray[np.uint16]) -> Floats:
    """(M,) one-sided leaf area of each module; those of a plant sum to `PlantSizes.leaf_area_m2`."""
    shape, shapes = modules.prototype, np.arange(len(tables.nodes))
    grown = np.minimum(modules.age / tables.mature_age[kind], 1.0)
    borne = np.flatnonzero(modules.parent >= 0)
    bearer = modules.parent_row()[borne]
    slot = tables.terminal_index[shape[bearer], modules.node[borne]]
    pipes = np.zeros(len(modules))
    for k in range(tables.most_terminals):
        node = tables.terminal[:, k]
        birth, thickness = tables.birth[shapes, node], np.where(node >= 0, tables.thickness[shapes, node], 0.0)
        bare = np.ones(len(modules))
        bare[bearer[slot == k]] -= grown[borne[slot == k]]
        share = np.maximum(grown - birth[shape], 0.0) / (1.0 - birth[shape])
        pipes += (share * thickness[shape]) ** 2 * bare
    return np.asarray(terminal_leaf_area_m2(tables)[kind, shape] * pipes)


def initial_ecoclimate(forest: State) -> Ecoclimate:
    """The ecoclimate of a new forest: its soil is as wet as some years of its climate leave it in December."""
    parameters = parameters_of(forest)
    soil = soil_of(parameters, forest.site)
    normals, p = parameters.climate.normals(), soil.parameters
    rain = normals.precipitation_mm_per_yr / _DAYS_PER_YR
    wet_mm = rain / p.loss_per_day if p.loss_per_day > 0 else 0.0
    water = Water(np.full(soil.ground.shape, wet_mm), np.zeros(soil.ground.shape))
    nothing, even = np.zeros(soil.ground.shape), np.ones(soil.ground.shape)
    state = Ecoclimate(
        forest, water, water.soil_mm, normals.mean_temperature_c, nothing, nothing, even, WaterBudget(0.0)
    )
    leaves = _leaves(state, soil.ground)
    for month in range(-MONTHS_PER_YR * _SPIN_UP_YR, 0):
        state = _month_later(state, soil, leaves, month_at(normals, (), month % MONTHS_PER_YR))
    return replace(state, temperature_mean_c=normals.mean_temperature_c, books=WaterBudget(state.stored_mm))


def step_ecoclimate(state: Ecoclimate) -> Ecoclimate:
    """The state one step of the plants later."""
    parameters = state.parameters
    soil = soil_of(parameters, state.forest.site)
    leaves, first = _leaves(state, soil.ground), state.forest.step * parameters.months_per_step
    normals = parameters.climate.normals()
    for month in range(first, first + parameters.months_per_step):
        now = month_at(normals, parameters.climate_changes, month)
        state = _month_later(_under_air(state, soil.ground, leaves, now, month), soil, leaves, now)
    climate = local_climate(state)
    return replace(state, forest=step_forest(state.forest, climate, _arriving(state.forest, parameters)))


def local_climate(state: Ecoclimate) -> LocalClimate:
    """What plants feel of warmth and wetness by place."""
    parameters, soil = state.parameters, soil_of(state.parameters, state.forest.site)
    ground = soil.ground
    height_m = _heights(parameters, state.forest.site)
    warmth = state.temperature_mean_c + state.warmth_mean_k + parameters.lapse_rate_k_per_km * height_m / 1000.0
    wetness = _mean_unless(parameters.microclimate, state.soil_mean_mm)
    rain = worth_mm_per_yr(wetness, soil.parameters, parameters.soil_water.reference_g_per_m2)
    return LocalClimate(ground.size_m, warmth, rain, parameters.shade_cooling_k, even_shade=not parameters.microclimate)


def worth_mm_per_yr(soil_mm: Floats, soil: SoilWaterParameters, leaves_g_per_m2: float) -> Floats:
    """Rain that keeps soil as wet under so many leaves."""
    drunk = soil.uptake_mm_m2_per_g_day * leaves_g_per_m2 * soil_mm / (soil_mm + soil.half_uptake_mm)
    return np.asarray(_DAYS_PER_YR * (soil.loss_per_day * soil_mm + drunk))


def soil_of(parameters: EcoclimateParameters, site: Site) -> SoilWater:
    """The soil of a site; level without microclimate."""
    return _soil_and_heights(parameters, site)[1]


def _heights(parameters: EcoclimateParameters, site: Site) -> Floats:
    """(rows, cols) heights of the ground, metres, with microclimate or without."""
    return _soil_and_heights(parameters, site)[2]


def _soil_and_heights(parameters: EcoclimateParameters, site: Site) -> tuple[Site, SoilWater, Floats]:
    section, water, uneven = parameters.soil_water, parameters.soil_water.water(), parameters.microclimate

    def made() -> tuple[Site, SoilWater, Floats]:
        ground = Ground.of_site(site, section.cell_m, periodic=parameters.periodic)
        height_m = np.zeros(ground.shape) if ground.height_m is None else ground.height_m
        return site, SoilWater(ground if uneven else replace(ground, height_m=None), water), height_m

    # By the height function's identity, which cannot be another's while the site is kept.
    return _soils.get((site.size_m, id(site.height), section.cell_m, parameters.periodic, uneven, water), made)


_soils: BoundedCache[tuple[Site, SoilWater, Floats]] = BoundedCache(4, lambda kept: 1)


def _leaves(state: Ecoclimate, ground: Ground) -> Floats:
    """(rows, cols) g/m2 as the soil sees them."""
    mass = leaf_area_index(state.forest, ground) * state.parameters.soil_water.leaf_mass_g_per_m2
    return _mean_unless(state.parameters.microclimate, mass)


def _mean_unless(local: bool, values: Floats) -> Floats:
    return values if local else np.full_like(values, values.mean())


def _under_air(state: Ecoclimate, ground: Ground, leaves: Floats, now: Month, month: int) -> Ecoclimate:
    """What the month's air makes of the rain and of the warmth; the same state if none is simulated in this month."""
    parameters = state.parameters
    section = parameters.weather
    if section is None or month % section.every_months:
        return state
    sky = month_of_air(section, now, month, _boundary_conditions(state, ground, leaves))
    share, local = section.local_share, _mean_unless(parameters.microclimate, sky.wetness)
    wetness = (1.0 - share) * sky.region + share * local
    warmth = _mean_unless(parameters.microclimate, sky.warmth_k)
    felt = state.warmth_mean_k + _share_of_months(parameters, section.every_months) * (warmth - state.warmth_mean_k)
    return replace(state, wetness=wetness, warmth_mean_k=felt)


def air_over(state: Ecoclimate, section: WeatherSection, day: int) -> Case:
    """What the air of a day goes by, of those that stand for the month after the state.

    The section is that of the state's parameters; another, such as one with finer cells, has days of its own.
    """
    parameters = state.parameters
    ground = soil_of(parameters, state.forest.site).ground
    month = state.forest.step * parameters.months_per_step
    now = month_at(parameters.climate.normals(), parameters.climate_changes, month)
    return case_of(section, now, month, _boundary_conditions(state, ground, _leaves(state, ground)), day)


def _boundary_conditions(state: Ecoclimate, ground: Ground, leaves: Floats) -> BoundaryConditions:
    """What the ground gives to the air."""
    parameters, forest = state.parameters, state.forest
    light = np.exp(-_EXTINCTION * leaves / max(parameters.soil_water.leaf_mass_g_per_m2, 1e-9))
    height_m, lapse_rate = _heights(parameters, forest.site), parameters.lapse_rate_k_per_km
    given = ground, height_m, state.vapour_mm_per_day, light
    return BoundaryConditions(*given, lapse_rate, forest.site.wind_from_deg, forest.seed)


def _share_of_months(parameters: EcoclimateParameters, count: int) -> float:
    """Weight of so many months in what plants feel."""
    memory = parameters.memory_yr * MONTHS_PER_YR
    return 1.0 if memory == 0 else -math.expm1(-count / memory)


def _month_later(state: Ecoclimate, soil: SoilWater, leaves: Floats, now: Month) -> Ecoclimate:
    """The water one month later, and what plants feel."""
    parameters = state.parameters
    rain, step_days = now.rain_mm_per_day * state.wetness, parameters.soil_water.substep_days
    passed = soil.advance(
        state.water, DAYS_PER_MONTH, plants_g_per_m2=leaves, rain_mm_per_day=rain, substep_days=step_days
    )
    share = _share_of_months(parameters, 1)
    felt = state.soil_mean_mm + share * (passed.water.soil_mm - state.soil_mean_mm)
    warmth = state.temperature_mean_c + share * (now.temperature_c - state.temperature_mean_c)
    given = (passed.uptake_mm + parameters.soil_water.evaporating_share * passed.loss_mm) / DAYS_PER_MONTH
    return replace(
        state,
        water=passed.water,
        soil_mean_mm=felt,
        temperature_mean_c=warmth,
        vapour_mm_per_day=given,
        books=state.books.and_then(passed.budget),
    )


def _arriving(forest: State, parameters: EcoclimateParameters) -> Arriving:
    """Seeds from elsewhere in this step: each germinates with the probability o of its place and light."""
    if not parameters.global_seeding:
        return NO_SEEDS
    growing = {one.name: k for k, one in enumerate(forest.species) if one.modules is not None}
    places, species, needed, expected = [], [], [], 0.0
    for index, one in enumerate(parameters.global_seeding):
        month = forest.step * parameters.months_per_step
        times = one.times_before(month + parameters.months_per_step) - one.times_before(month)
        rng = child_rng(forest.seed, "arrivals", index, forest.step)
        kinds = one.species or tuple(growing)
        expected += times * one.seeds_per_ha * forest.site.area_ha * len(kinds)
        refuse_more_seeds(expected)  # before they are drawn
        for name in kinds:
            count = int(rng.poisson(times * one.seeds_per_ha * forest.site.area_ha))
            places.append(rng.random((count, 2)) * forest.site.size_m)
            species.append(np.full(count, growing[name], dtype=np.uint16))
            needed.append(rng.random(count))
    return Arriving(np.concatenate(places), np.concatenate(species), np.concatenate(needed)) if places else NO_SEEDS


def shown_section(drawn: DrawnRecipe, parameters: EcoclimateParameters) -> WeatherSection:
    """The community's weather at its last step, with the cells and the hours of the picture."""
    clouds: Any = drawn.recipe.sky.clouds
    types = {name: one.modules for name, one in drawn.species.items() if one.modules is not None}
    at_the_end, _ = parameters_at(parameters, types, parameters.steps)
    assert isinstance(at_the_end, EcoclimateParameters)
    section = at_the_end.weather
    if section is None:
        turned_off = parameters.weather is not None
        problem = "the community simulates no air" + (" any more when the picture is taken" if turned_off else "")
        expected, got = "a section community.weather", "a change to weather: null" if turned_off else "none"
        hint = "leave out that change" if turned_off else "set community.weather={} for one with usual values"
        raise RecipeError(problem, where=drawn.where("sky", "clouds", "type"), expected=expected, got=got, hint=hint)
    if clouds.time_s is not None and not 0 < clouds.time_s <= _MOST_S:
        problem, expected = "no time of the day's simulated hours", f"more than 0 and at most {_MOST_S:g} s"
        got = f"{clouds.time_s:g}"
        raise RecipeError(problem, where=drawn.where("sky", "clouds", "time_s"), expected=expected, got=got)
    hours = None if clouds.time_s is None else clouds.time_s / 3600.0
    given = {"cell_m": clouds.cell_m, "cell_height_m": clouds.cell_height_m, "hours": hours}
    own = {key: value for key, value in given.items() if value is not None}
    return drawn.parse(WeatherSection, {**section.model_dump(), **own}, ("sky", "clouds"))


def shown_weather(drawn: DrawnRecipe, section: WeatherSection, state: Ecoclimate, progress: Progress) -> Weather:
    """The air at the end of the hours that are simulated of a day, from the cache or simulated."""
    clouds: Any = drawn.recipe.sky.clouds
    case = air_over(state, section, clouds.day or 0)
    key, store = weather_key(code_hash(_SOURCES, _COMPUTE_WITH), section.hours, case), weather_store()
    kept = None if store is None else read_weather(store, key)
    if kept is not None:
        return kept
    try:
        with progress.stage("weather", 1) as advance:
            weather = hours_of(section, case.grid, case.day, case.surface).weather
            advance(1)
    except UnstableError as cause:
        problem, expected = "the air over the community cannot be simulated", "air that stays slower than any storm"
        got, hint = str(cause), "lower the heat, the vapour or the wind of community.weather, or make the cells larger"
        raise RecipeError(problem, where=drawn.where("sky", "clouds"), expected=expected, got=got, hint=hint) from cause
    if store is not None:
        store.write(key, pack(weather))
        store.trim()
    return weather
