"""The water of an ecoclimate: books that close, rest, what leaves do to it, lengths of steps."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from ecoclimate_cases import HILLY, SEASONS, SITE, STEADY, after, ecology, parameters, plant_type, states

from forestgen.community.ecoclimate import months
from forestgen.community.ecoclimate.air import MonthOfAir
from forestgen.community.ecoclimate.months import (
    Ecoclimate,
    WaterBudget,
    initial_ecoclimate,
    local_climate,
    soil_of,
    step_ecoclimate,
    worth_mm_per_yr,
)
from forestgen.community.ecoclimate.parameters import KINDS
from forestgen.community.models.branch_modules import MODEL as FOREST
from forestgen.community.models.ecoclimate import MODEL
from forestgen.community.population import Site
from forestgen.community.soil_water import SoilWaterParameters, Water

DAYS = 365.25


def error(state: Ecoclimate) -> float:
    books = state.books
    return abs(state.stored_mm + books.uptake_mm + books.loss_mm - books.rain_mm - books.start_mm)


@pytest.mark.parametrize("site", [SITE, HILLY], ids=["level", "hills"])
@pytest.mark.parametrize("periodic", [False, True], ids=["bounded", "periodic"])
@pytest.mark.parametrize(
    ("step_yr", "steps"), [(1 / 12, 24), (0.25, 12), (1.0, 4)], ids=["months", "quarters", "years"]
)
def test_rain_is_stored_drunk_or_lost(site: Site, periodic: bool, step_yr: float, steps: int) -> None:
    state = after(steps, site, periodic=periodic, step_yr=step_yr, initial_plants=12)
    books = state.books
    assert books.rain_mm == pytest.approx(sum(SEASONS["precipitation_mm"]) * steps * step_yr, rel=1e-12)
    assert books.uptake_mm > 1e-3 * books.rain_mm  # plants do drink
    assert books.loss_mm > 0
    assert error(state) < 1e-11 * books.rain_mm
    for field in (state.water.soil_mm, state.water.surface_mm, state.soil_mean_mm):
        assert np.isfinite(field).all()
        assert field.min() >= 0


@pytest.mark.parametrize("microclimate", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_books_close_for_every_kind_of_soil_and_while_the_climate_changes(kind: str, microclimate: bool) -> None:
    turn = {"from_yr": 1, "to_yr": 3, "precipitation": 0.1, "temperature_k": 2}
    seeds = {"seeds_per_ha": 2000, "every_yr": 0.5}
    state = after(
        8,
        HILLY,
        step_yr=0.5,
        microclimate=microclimate,
        soil_water={"kind": kind},
        climate_changes=[turn],
        global_seeding=[seeds],
    )
    assert error(state) < 1e-11 * state.books.rain_mm
    # Factors of the years: 1, then from 1 to 0.1 in two, then 0.1; wet months count for more.
    factor = state.books.rain_mm / sum(SEASONS["precipitation_mm"])
    assert 1 + 2 * 0.5 < factor < 1 + 2 * 0.6 + 0.1


@pytest.mark.parametrize("reference", [0.0, 120.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_stand_without_plants_ends_at_rest(kind: str, reference: float) -> None:
    """R = f O, r W = R; and bare soil under the rain P is worth P."""
    soil = {"kind": kind, "reference_g_per_m2": reference}
    state = after(12, initial_plants=0, climate=STEADY, soil_water=soil)
    p = state.parameters.soil_water.water()
    rain = 60.0 * 12 / DAYS
    assert state.water.soil_mm == pytest.approx(rain / p.loss_per_day, rel=1e-6)
    assert state.water.surface_mm == pytest.approx(rain / (p.infiltration_per_day * p.bare_infiltration), rel=1e-6)
    assert worth_mm_per_yr(state.water.soil_mm, p, 0.0) == pytest.approx(720.0, rel=1e-6)
    assert state.soil_mean_mm == pytest.approx(state.water.soil_mm, rel=2e-3)  # it remembers a ground that was dry
    assert (worth_mm_per_yr(state.soil_mean_mm, p, reference) > 720.0).all() == (reference > 0)


def test_soil_under_leaves_is_worth_the_rain_that_keeps_it_so_wet() -> None:
    """The inverse of the soil model: so many leaves, even rain, until it rests."""
    p = parameters(soil_water={"kind": "forest"})
    soil = soil_of(p, SITE)
    for leaves, rain in ((60.0, 1.0), (300.0, 3.0)):
        dry = Water(np.zeros(soil.ground.shape), np.zeros(soil.ground.shape))
        water = soil.advance(dry, 30 * DAYS, plants_g_per_m2=leaves, rain_mm_per_day=rain, substep_days=2.0).water
        assert worth_mm_per_yr(water.soil_mm, soil.parameters, leaves) == pytest.approx(DAYS * rain, rel=1e-3)


def test_twelve_months_are_a_year_where_nobody_stands() -> None:
    months = after(24, HILLY, initial_plants=0, step_yr=1 / 12)
    years = after(2, HILLY, initial_plants=0, step_yr=1.0)
    assert months.water.soil_mm.tobytes() == years.water.soil_mm.tobytes()
    assert months.water.surface_mm.tobytes() == years.water.surface_mm.tobytes()
    assert months.soil_mean_mm.tobytes() == years.soil_mean_mm.tobytes()
    assert (months.temperature_mean_c, months.books) == (years.temperature_mean_c, years.books)


@pytest.mark.parametrize("step_yr", [0.0833333333, 0.08333334, 0.9999999])
def test_a_step_that_is_nearly_of_whole_months_has_whole_months(step_yr: float) -> None:
    months = round(12 * step_yr)
    state = after(24 // months, initial_plants=0, step_yr=step_yr)
    assert state.books.rain_mm == pytest.approx(2 * sum(SEASONS["precipitation_mm"]), rel=1e-12)


def test_it_rains_by_the_month_and_drought_shows() -> None:
    """The rain of each step is its month's; the soil is driest after the dry months, and January comes first."""
    found = []
    for state, _ in zip(states(initial_plants=0), range(13), strict=False):
        found.append((state.books.rain_mm, float(state.water.soil_mm.mean())))
    rain, soil = np.transpose(found)
    assert np.diff(rain) == pytest.approx(SEASONS["precipitation_mm"], abs=1e-9)
    assert soil[8] < 0.5 * soil[12]


def grown(**keys: Any) -> Ecoclimate:
    """A stand of some years, with all of its water as at the beginning."""
    return after(5, step_yr=1.0, climate=STEADY, **keys)


def test_more_leaves_make_water_sink_in_faster_and_drink_more() -> None:
    """The same soil and rain with plants and without: less stands on the ground, less is in the soil, more is drunk."""
    state = grown(initial_plants=20)
    bare = replace(MODEL.remove(state, state.forest.plants.plant_id), books=WaterBudget(state.stored_mm))
    planted = replace(state, books=WaterBudget(state.stored_mm))
    assert len(bare.forest.plants) == 0
    with_plants, without = step_ecoclimate(planted), step_ecoclimate(bare)
    assert without.books.uptake_mm == 0
    assert with_plants.books.uptake_mm > 1.0
    assert with_plants.water.surface_mm.mean() < without.water.surface_mm.mean()
    assert with_plants.water.soil_mm.mean() < without.water.soil_mm.mean()
    assert with_plants.books.loss_mm < without.books.loss_mm


def test_leaf_mass_scales_what_plants_drink_and_none_does_nothing() -> None:
    drunk = []
    for mass in (0.0, 20.0, 70.0, 200.0):
        state = grown(soil_water={"leaf_mass_g_per_m2": mass})
        drunk.append(state.books.uptake_mm)
    assert drunk[0] == 0
    assert np.all(np.diff(drunk) > 0)


def test_plants_drink_where_they_stand_unless_there_is_no_microclimate() -> None:
    """Water under the fullest cell against the emptiest, of a soil that crusts without plants."""
    spread = {}
    for microclimate in (True, False):
        state = grown(microclimate=microclimate, initial_plants=6, soil_water={"kind": "dryland"})
        spread[microclimate] = np.ptp(state.water.surface_mm) / state.water.surface_mm.mean()
    assert spread[True] > 0.05
    assert spread[False] < 1e-12


def test_without_microclimate_the_ground_is_level_for_water() -> None:
    on_hills, level = (after(2, site, step_yr=1.0, microclimate=False, initial_plants=0) for site in (HILLY, SITE))
    assert on_hills.water.soil_mm.tobytes() == level.water.soil_mm.tobytes()
    uneven = after(2, HILLY, step_yr=1.0, initial_plants=0)
    assert np.ptp(uneven.water.soil_mm) > 0.5 * uneven.water.soil_mm.mean()  # it does run downhill otherwise


def test_the_start_is_as_wet_as_years_of_the_climate_leave_it() -> None:
    """A first year from the start ends as it began, but for what the plants' first year changes."""
    first, *_, last = (state for state, _ in zip(states(initial_plants=0), range(13), strict=False))
    assert last.water.soil_mm == pytest.approx(first.water.soil_mm, rel=1e-4)
    assert last.soil_mean_mm == pytest.approx(first.soil_mean_mm, rel=0.06)  # three years of a memory of one
    assert first.books == WaterBudget(first.stored_mm)


@pytest.mark.parametrize("memory_yr", [0.0, 0.5, 10.0])
def test_what_plants_feel_is_a_mean_over_their_memory(memory_yr: float) -> None:
    state = after(1, memory_yr=memory_yr)
    later = MODEL.step(state)
    share = 1.0 if memory_yr == 0 else 1 - np.exp(-1 / (12 * memory_yr))
    expected = state.soil_mean_mm + share * (later.water.soil_mm - state.soil_mean_mm)
    assert later.soil_mean_mm == pytest.approx(expected, rel=1e-12)
    warmth = state.temperature_mean_c + share * (SEASONS["temperature_c"][1] - state.temperature_mean_c)
    assert later.temperature_mean_c == pytest.approx(warmth, rel=1e-12)
    if memory_yr == 0:
        assert later.soil_mean_mm == pytest.approx(later.water.soil_mm, rel=1e-14)
        assert later.temperature_mean_c == pytest.approx(SEASONS["temperature_c"][1], rel=1e-14)


def test_a_soil_that_loses_nothing_is_dry_at_first_and_only_plants_empty_it() -> None:
    state = after(24, climate=STEADY, initial_plants=0, soil_water={"loss_per_day": 0.0})
    assert state.books.loss_mm == 0
    assert state.stored_mm == pytest.approx(state.books.start_mm + state.books.rain_mm, rel=1e-12)


def test_a_change_of_the_soil_or_the_microclimate_holds_from_its_year_on() -> None:
    """Keys of this model change as those of branch modules do."""
    changes = [{"at_yr": 2, "set": {"microclimate": False, "soil_water": {"kind": "dryland", "cell_m": 3.0}}}]
    before, now = (after(n, HILLY, step_yr=1.0, changes=changes) for n in (1, 2))
    assert before.parameters.microclimate
    assert not now.parameters.microclimate
    assert now.parameters.soil_water.water() == SoilWaterParameters()
    assert np.ptp(now.soil_mean_mm) > 1  # still as uneven as before,
    assert np.ptp(local_climate(now).precipitation_mm_per_yr) == 0  # but plants go by its mean at once
    later = MODEL.step(now)
    assert later.soil_mean_mm.std() < before.soil_mean_mm.std()
    assert error(later) < 1e-11 * later.books.rain_mm


def test_a_single_cell_will_do() -> None:
    state = after(12, HILLY, soil_water={"cell_m": 100.0})
    assert state.water.soil_mm.shape == (1, 1)
    assert error(state) < 1e-11 * state.books.rain_mm


def test_a_forest_begins_where_that_of_branch_modules_does() -> None:
    """The soil is added to the forest; it draws no random number of its own."""
    p, species = parameters(), [ecology()]
    forest = FOREST.init(p, SITE, species, 5)
    assert initial_ecoclimate(forest).forest is forest
    assert plant_type() == species[0].modules


@pytest.mark.parametrize("memory_yr", [0.0, 1.0, 3.0])
def test_months_between_simulated_ones_have_the_last_ones_rain_and_warmth(
    memory_yr: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def air(section: Any, month: Any, number: int, given: Any, *_: Any) -> MonthOfAir:
        seen.append(number)
        even = np.ones(given.ground.shape)
        return MonthOfAir((3.0 if number else 2.0) * even, 1.0, 1.5 * even, 0.1, 0.0)

    monkeypatch.setattr(months, "month_of_air", air)
    weather = {"every_months": 5, "local_share": 0.5}
    course = list(islice(states(HILLY, climate=STEADY, memory_yr=memory_yr, weather=weather), 13))
    assert seen == [0, 5, 10]
    assert [float(one.wetness.mean()) for one in course[1:]] == pytest.approx([1.5] * 5 + [2.0] * 7)
    felt = 1.5 * (1.0 - math.exp(-15 / 12 / memory_yr)) if memory_yr else 1.5
    assert course[-1].warmth_mean_k == pytest.approx(felt)
    assert error(course[-1]) < 1e-11 * course[-1].books.rain_mm
    assert course[-1].books.rain_mm == pytest.approx(60.0 * (5 * 1.5 + 7 * 2.0))


@pytest.mark.slow
def test_less_vapour_from_the_region_is_less_rain_and_the_books_close() -> None:
    weather = {
        "hours": 0.5, "extent_m": 800, "cell_m": 100, "height_m": 1200, "cell_height_m": 100, "mixed_layer_m": 300,
        "inversion_m": 900, "relative_humidity": 0.86, "relative_humidity_aloft": 0.9, "wind_m_per_s": 0,
        "every_months": 2,
    }  # fmt: skip
    normal, drier = (
        after(3, climate=STEADY, weather=weather, climate_changes=[{"from_yr": 0, "to_yr": 0, "vapour": vapour}])
        for vapour in (1.0, 0.2)
    )
    assert drier.books.rain_mm < 0.95 * normal.books.rain_mm
    assert drier.wetness.max() < normal.wetness.min()
    for one in (normal, drier):
        assert error(one) < 1e-11 * one.books.rain_mm
