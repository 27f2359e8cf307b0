"""Months of an ecoclimate (seeds 002, Algorithm 1): climate, soil, and then the plants by what they felt of both.

A step has whole months. In each, rain falls by the climate, over the forest more or less of it as its own air makes
clouds (`air`; on request); the water on and in the soil goes on by the leaves that stand there (Eqs. 43, 44); and what
plants feel, a mean over their memory, follows. Then the plants go one step on, each by the soil water of its own cell
and by the shade at its foot (Eq. 38).

Soil water is told to plants as precipitation, since that is what their optima are given in: the rain that would keep
the soil as wet under a stand of `reference_g_per_m2` of leaves, for ever:

    P = 365.25 (r W + g W / (W + k1) B_ref)

Without microclimate, every map is its mean where it is handed over: leaves to the soil, soil water and shade to plants.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from forestgen.community.branch_modules.climate import LocalClimate
from forestgen.community.branch_modules.seeding import NOBODY, Arriving
from forestgen.community.branch_modules.state import State, refuse_more_seeds
from forestgen.community.branch_modules.step import advanced
from forestgen.community.ecoclimate.air import Case, Given, case_of, month_of_air
from forestgen.community.ecoclimate.climate import DAYS_PER_MONTH, MONTHS_PER_YR, Month, month_at
from forestgen.community.ecoclimate.leaves import leaf_area_index
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.ecoclimate.state import Books, Ecoclimate, parameters_of
from forestgen.community.ecoclimate.weather_section import WeatherSection
from forestgen.community.model import Site
from forestgen.community.soil_water.ground import Floats, Ground
from forestgen.community.soil_water.model import SoilWater, Water
from forestgen.community.soil_water.parameters import SoilWaterParameters
from forestgen.core.randomness import child_rng

_DAYS_PER_YR = DAYS_PER_MONTH * MONTHS_PER_YR
_EXTINCTION = 0.5  # of leaves at all angles alike
_SPIN_UP_YR = 3  # of the water under the plants of the start


def begun(forest: State) -> Ecoclimate:
    """The ecoclimate of a new forest: its soil is as wet as some years of its climate leave it in December."""
    parameters = parameters_of(forest)
    soil = soil_of(parameters, forest.site)
    normals, p = parameters.climate.normals(), soil.parameters
    rain = normals.precipitation_mm_per_yr / _DAYS_PER_YR
    wet_mm = rain / p.loss_per_day if p.loss_per_day > 0 else 0.0
    water = Water(np.full(soil.ground.shape, wet_mm), np.zeros(soil.ground.shape))
    nothing, even = np.zeros(soil.ground.shape), np.ones(soil.ground.shape)
    state = Ecoclimate(forest, water, water.soil_mm, normals.mean_temperature_c, nothing, nothing, even, Books(0.0))
    leaves = _leaves(state, soil.ground)
    for month in range(-MONTHS_PER_YR * _SPIN_UP_YR, 0):
        state = _month_later(state, soil, leaves, month_at(normals, (), month % MONTHS_PER_YR))
    return replace(state, temperature_mean_c=normals.mean_temperature_c, books=Books(state.stored_mm))


def advanced_ecoclimate(state: Ecoclimate) -> Ecoclimate:
    """The state one step of the plants later."""
    parameters = state.parameters
    soil = soil_of(parameters, state.forest.site)
    leaves, first = _leaves(state, soil.ground), state.forest.step * parameters.months_per_step
    normals = parameters.climate.normals()
    for month in range(first, first + parameters.months_per_step):
        now = month_at(normals, parameters.turns, month)
        state = _month_later(_under_air(state, soil.ground, leaves, now, month), soil, leaves, now)
    climate = local_climate(state)
    return replace(state, forest=advanced(state.forest, climate, _arriving(state.forest, parameters)))


def local_climate(state: Ecoclimate) -> LocalClimate:
    """What plants feel of warmth and wetness by place."""
    parameters, soil = state.parameters, soil_of(state.parameters, state.forest.site)
    ground = soil.ground
    height_m = _heights(_Alike(state.forest.site), parameters.soil_water.cell_m)
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
    section = parameters.soil_water
    if not parameters.microclimate:
        site = replace(site, height=None)
    return _soil(_Alike(site), section.cell_m, parameters.periodic, section.water())


class _Alike:
    """A site as a key: the same object, or one of the same size without heights."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self._key = (site.size_m, None if site.height is None else id(site.height))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Alike) and self._key == other._key


@lru_cache(maxsize=4)
def _soil(site: _Alike, cell_m: float, periodic: bool, water: SoilWaterParameters) -> SoilWater:
    return SoilWater(Ground.of_site(site.site, cell_m, periodic=periodic), water)


@lru_cache(maxsize=4)
def _heights(site: _Alike, cell_m: float) -> Floats:
    ground = Ground.of_site(site.site, cell_m, periodic=False)
    return np.zeros(ground.shape) if ground.height_m is None else ground.height_m


def _leaves(state: Ecoclimate, ground: Ground) -> Floats:
    """(rows, cols) g/m2 as the soil sees them."""
    mass = leaf_area_index(state.forest, ground) * state.parameters.soil_water.leaf_mass_g_per_m2
    return _mean_unless(state.parameters.microclimate, mass)


def _mean_unless(local: bool, values: Floats) -> Floats:
    return values if local else np.full_like(values, values.mean())


def _under_air(state: Ecoclimate, ground: Ground, leaves: Floats, now: Month, month: int) -> Ecoclimate:
    """What the month's air makes of the rain and of the warmth; the same state if none is simulated in this month."""
    parameters, site = state.parameters, state.forest.site
    section = parameters.weather
    if section is None or month % section.every_months:
        return state
    sky = month_of_air(section, now, month, _given(state, ground, leaves), site.wind_from_deg, state.forest.seed)
    share, local = section.local_share, _mean_unless(parameters.microclimate, sky.wetness)
    wetness = (1.0 - share) * sky.region + share * local
    warmth = _mean_unless(parameters.microclimate, sky.warmth_k)
    felt = state.warmth_mean_k + _share_of_months(parameters, section.every_months) * (warmth - state.warmth_mean_k)
    return replace(state, wetness=wetness, warmth_mean_k=felt)


def air_over(state: Ecoclimate, section: WeatherSection, day: int) -> Case:
    """What the air of a day goes by, of those that the month after the state is told by.

    Parameters
    ----------
    section : of the state's parameters; another, such as one with finer cells, has days of its own.
    """
    parameters, site = state.parameters, state.forest.site
    ground = soil_of(parameters, site).ground
    month = state.forest.step * parameters.months_per_step
    now = month_at(parameters.climate.normals(), parameters.turns, month)
    given = _given(state, ground, _leaves(state, ground))
    return case_of(section, now, month, given, site.wind_from_deg, state.forest.seed, day)


def _given(state: Ecoclimate, ground: Ground, leaves: Floats) -> Given:
    """What the ground gives to the air."""
    parameters = state.parameters
    light = np.exp(-_EXTINCTION * leaves / max(parameters.soil_water.leaf_mass_g_per_m2, 1e-9))
    height_m = _heights(_Alike(state.forest.site), parameters.soil_water.cell_m)
    return Given(ground, height_m, state.vapour_mm_per_day, light, parameters.lapse_rate_k_per_km)


def _share_of_months(parameters: EcoclimateParameters, count: int) -> float:
    """Weight of so many months in what plants feel."""
    memory = parameters.memory_yr * MONTHS_PER_YR
    return 1.0 if memory == 0 else -math.expm1(-count / memory)


def _month_later(state: Ecoclimate, soil: SoilWater, leaves: Floats, now: Month) -> Ecoclimate:
    """The water one month later, and what plants feel."""
    parameters = state.parameters
    passed = soil.advance(
        state.water,
        DAYS_PER_MONTH,
        plants_g_per_m2=leaves,
        rain_mm_per_day=now.rain_mm_per_day * state.wetness,
        substep_days=parameters.soil_water.substep_days,
    )
    share = _share_of_months(parameters, 1)
    felt = state.soil_mean_mm + share * (passed.water.soil_mm - state.soil_mean_mm)
    warmth = state.temperature_mean_c + share * (now.temperature_c - state.temperature_mean_c)
    given = (passed.uptake_mm + parameters.soil_water.evaporating_share * passed.loss_mm) / DAYS_PER_MONTH
    before, budget = state.books, passed.budget
    books = Books(
        before.start_mm,
        before.rain_mm + budget.rain_mm,
        before.uptake_mm + budget.uptake_mm,
        before.loss_mm + budget.loss_mm,
    )
    return replace(
        state,
        water=passed.water,
        soil_mean_mm=felt,
        temperature_mean_c=warmth,
        vapour_mm_per_day=given,
        books=books,
    )


def _arriving(forest: State, parameters: EcoclimateParameters) -> Arriving:
    """Seeds from elsewhere in this step: each germinates with the probability o of its place and light."""
    if not parameters.global_seeding:
        return NOBODY
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
    return Arriving(np.concatenate(places), np.concatenate(species), np.concatenate(needed)) if places else NOBODY
