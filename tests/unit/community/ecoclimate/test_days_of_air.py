"""What a month's days of air make of a ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.fluid.parameters import Surface
from forestgen.community.ecoclimate.air import BoundaryConditions, day_of, grid_of, hours_of, month_of_air
from forestgen.community.ecoclimate.parameters import Month, WeatherSection
from forestgen.community.soil_water import Ground

SECTION = WeatherSection.model_validate(
    {"hours": 0.5, "extent_m": 800, "cell_m": 100, "height_m": 1200, "cell_height_m": 100, "mixed_layer_m": 300,
     "inversion_m": 900, "relative_humidity": 0.86, "relative_humidity_aloft": 0.9, "wind_m_per_s": 0}
)  # fmt: skip
GROUND = Ground((800.0, 800.0), (10, 10))
MONTH = Month(15.0, 2.0)


def sky(vapour_mm_per_day=2.0, light=0.5, height=0.0, section=SECTION, seed=1, number=5, month=MONTH):
    maps = (
        np.broadcast_to(np.asarray(one, dtype=float), GROUND.shape).copy() for one in (height, vapour_mm_per_day, light)
    )
    height_m, vapour, left = maps
    return month_of_air(section, month, number, BoundaryConditions(GROUND, height_m, vapour, left, -6.5, 270.0, seed))


def test_the_same_ground_as_the_regions_has_the_regions_rain() -> None:
    """Usual evaporation and shade, everywhere: the two simulations are one."""
    usual = sky(SECTION.usual_evaporation * MONTH.rain_mm_per_day, 1.0 - SECTION.usual_shade)
    assert usual.condensed_kg_per_m2 > 1e-3
    assert usual.wetness.mean() == pytest.approx(1.0, abs=0.02)


def test_more_vapour_makes_more_clouds_and_none_are_made_of_nothing() -> None:
    dry, wet = sky(0.0), sky(6.0)
    assert wet.condensed_kg_per_m2 > 1.1 * dry.condensed_kg_per_m2
    assert wet.wetness.mean() > dry.wetness.mean()
    assert max(dry.water_error, wet.water_error) < 1e-5


@pytest.mark.slow
def test_each_year_has_the_same_days_and_each_seed_its_own() -> None:
    assert np.array_equal(sky(number=5).wetness, sky(number=17).wetness)
    assert not np.array_equal(sky(number=5).wetness, sky(number=6).wetness)
    assert not np.array_equal(sky(seed=1).wetness, sky(seed=2).wetness)


def test_days_are_drawn_about_the_regions_means() -> None:
    heat = np.array([day_of(SECTION, MONTH, k % 12, k, 270.0, 4).heat_w_per_m2 for k in range(400)])
    assert heat.mean() == pytest.approx(150.0, abs=3 * 15 / 20)
    assert heat.std() == pytest.approx(15.0, rel=0.15)


def test_each_month_may_have_its_own_heat_and_vapour() -> None:
    even = SECTION.model_copy(update={"spread": 0.0})
    months = tuple(10.0 * k for k in range(1, 13))
    section = WeatherSection.model_validate(
        {**even.model_dump(), "heat_w_per_m2": months, "vapour_w_per_m2": months[::-1]}
    )
    for of_year in range(12):
        day = day_of(section, MONTH, of_year, 0, 270.0, 1)
        assert day.heat_w_per_m2 == months[of_year]
        one = even.model_copy(update={"vapour_w_per_m2": months[11 - of_year]})
        assert day.vapour_kg_per_m2_s == day_of(one, MONTH, of_year, 0, 270.0, 1).vapour_kg_per_m2_s
        halved = day_of(section, replace(MONTH, vapour=0.5), of_year, 0, 270.0, 1)
        assert halved.vapour_kg_per_m2_s == pytest.approx(0.5 * day.vapour_kg_per_m2_s)


def test_months_all_alike_are_one_number() -> None:
    twelve = SECTION.model_copy(update={"heat_w_per_m2": (150.0,) * 12, "vapour_w_per_m2": (60.0,) * 12})
    assert np.array_equal(sky(section=twelve).wetness, sky().wetness)


@pytest.mark.slow
def test_where_the_region_has_less_vapour_there_is_less_rain_here_and_there() -> None:
    """Over ground that does what is usual, place and region change alike; without a change the normal rain falls."""
    usual = SECTION.usual_evaporation * MONTH.rain_mm_per_day, 1.0 - SECTION.usual_shade
    normal = sky(*usual)
    assert normal.region == 1.0
    less = [sky(*usual, month=replace(MONTH, vapour=factor)) for factor in (0.5, 0.0)]
    assert 1.0 > less[0].region > less[1].region > 0.0
    for one in less:
        assert one.wetness.mean() == pytest.approx(one.region, abs=0.02)
        assert one.water_error < 1e-5
    more = sky(*usual, month=replace(MONTH, vapour=2.0))
    assert more.region > 1.0


def test_shade_keeps_heat_back() -> None:
    section = SECTION.model_copy(update={"shade_heat_share": 0.3})
    assert sky(light=0.0, section=section).warmth_k.mean() < sky(light=1.0, section=section).warmth_k.mean()
    assert np.array_equal(sky(light=0.0).warmth_k, sky(light=1.0).warmth_k)


@pytest.mark.slow
def test_air_that_comes_down_behind_a_ridge_is_warmer_than_before_it() -> None:
    """Stably layered dry air, wind from the west, a ridge of 500 m from south to north: Foehn."""
    dry = {
        "wind_m_per_s": 8.0, "mixed_layer_m": 0.0, "lapse_rate_k_per_km": 4.0, "inversion_m": 2800.0, "hours": 1.0,
        "relative_humidity": 0.3, "relative_humidity_aloft": 0.3, "heat_w_per_m2": 0.0, "vapour_w_per_m2": 0.0,
        "height_m": 3000.0,
    }  # fmt: skip
    ground = Ground((12_800.0, 800.0), (8, 128))
    x_m = (np.arange(128) + 0.5) * 100.0 - 6400.0
    height = np.broadcast_to(500.0 * np.exp(-((x_m / 800.0) ** 2)), ground.shape).copy()
    given = BoundaryConditions(ground, height, np.zeros(ground.shape), np.ones(ground.shape), -6.5, 270.0, 1)
    warmth = month_of_air(SECTION.model_copy(update=dry), MONTH, 0, given).warmth_k.mean(axis=0)
    slopes = (np.abs(x_m) > 240.0) & (np.abs(x_m) < 1200.0)
    assert warmth[slopes & (x_m > 0)].mean() > warmth[slopes & (x_m < 0)].mean() + 0.2


def test_still_air_over_a_hill_is_as_cold_as_the_air_at_rest_there() -> None:
    """Without wind and heat nothing moves: warmth is what the sounding's lapse rate differs from the usual one."""
    still = {
        "mixed_layer_m": 0.0, "lapse_rate_k_per_km": 4.0, "inversion_m": 1100.0, "relative_humidity": 0.3,
        "relative_humidity_aloft": 0.3, "heat_w_per_m2": 0.0, "vapour_w_per_m2": 0.0,
    }  # fmt: skip
    ground, height = Ground((800.0, 800.0), (8, 8)), np.zeros((8, 8))
    height[:, 3:5] = 400.0
    given = BoundaryConditions(ground, height, np.zeros((8, 8)), np.ones((8, 8)), -6.5, 270.0, 1)
    warmth = month_of_air(SECTION.model_copy(update=still), MONTH, 5, given).warmth_k
    assert warmth[:, 3:5].mean() - warmth[:, [0, 7]].mean() == pytest.approx(0.4 * (6.5 - 4.0), abs=0.15)


def test_the_box_holds_the_site_and_its_middle_is_the_sites() -> None:
    grid = grid_of(SECTION, Ground((1500.0, 400.0), (4, 4)))
    assert grid.size_m[:2] == pytest.approx((1500.0, 800.0))
    assert grid.low_m[:2] == pytest.approx((0.0, -200.0))
    assert min(grid.cell_m[:2]) >= 100.0 - 1e-9


def test_a_box_may_be_longer_than_wide() -> None:
    section = WeatherSection.model_validate({"extent_m": [9600, 1600], "cell_m": 200})
    assert grid_of(section, Ground((3000.0, 200.0), (8, 120))).cells[:2] == (48, 8)


def test_vapour_is_given_by_day_and_all_of_it() -> None:
    """mm a day over 12 hours of light, in kg/(m2 s); the air holds it afterwards."""
    grid = grid_of(SECTION, GROUND)
    day = day_of(SECTION, MONTH, 0, 0, 270.0, 1)
    flux = 3.0 / (12 * 3600.0)
    across = grid.shape[1:]
    surface = Surface(np.full(across, 100.0, np.float32), np.full(across, flux, np.float32))
    left = hours_of(SECTION, grid, day, surface)
    assert left.water_error < 1e-5
    assert left.weather.time_s == 1800.0
