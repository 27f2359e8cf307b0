"""Months, places, and how a climate changes."""

from __future__ import annotations

import pytest
from ecoclimate_cases import parameters

from forestgen.community.ecoclimate.parameters import (
    DAYS_PER_MONTH,
    ClimateChange,
    MonthlyClimate,
    climate_of,
    month_at,
    places,
)
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

NORMALS = MonthlyClimate(tuple(float(k) for k in range(12)), tuple(10.0 * k for k in range(1, 13)))


def test_months_follow_one_another_and_a_year_has_its_rain() -> None:
    for month in range(40):
        now = month_at(NORMALS, (), month)
        assert now.temperature_c == month % 12
        assert now.rain_mm_per_day * DAYS_PER_MONTH == pytest.approx(10.0 * (month % 12 + 1))
    year = sum(month_at(NORMALS, (), month).rain_mm_per_day * DAYS_PER_MONTH for month in range(12))
    assert year == pytest.approx(NORMALS.precipitation_mm_per_yr)
    assert 12 * DAYS_PER_MONTH == 365.25


def turn_of(
    from_yr: float, to_yr: float, precipitation: float = 1.0, warmer_k: float = 0.0, vapour: float = 1.0
) -> ClimateChange:
    return ClimateChange(
        from_yr=from_yr, to_yr=to_yr, precipitation=precipitation, temperature_k=warmer_k, vapour=vapour
    )


def factor(turns: tuple[ClimateChange, ...], month: int) -> float:
    return month_at(NORMALS, turns, month).rain_mm_per_day / month_at(NORMALS, (), month).rain_mm_per_day


def test_a_change_is_a_slope_between_two_ends() -> None:
    turn = (turn_of(10.0, 20.0, precipitation=0.4, warmer_k=5.0),)
    assert factor(turn, 119) == 1.0  # the December before
    assert factor(turn, 240) == pytest.approx(0.4)
    assert factor(turn, 100_000) == pytest.approx(0.4)
    steps = [factor(turn, month) - factor(turn, month + 1) for month in range(120, 239)]
    assert steps == pytest.approx([0.6 / 120] * 119)
    for month in (119, 150, 500):
        share = min(1.0, max(0.0, ((month + 0.5) / 12 - 10) / 10))
        warmer = month_at(NORMALS, turn, month).temperature_c - month_at(NORMALS, (), month).temperature_c
        assert warmer == pytest.approx(5.0 * share)


def test_changes_multiply_rain_and_add_warmth() -> None:
    turns = (turn_of(0.0, 1.0, 0.5, 1.0), turn_of(2.0, 3.0, 0.5, -4.0))
    assert factor(turns, 20) == pytest.approx(0.5)
    assert factor(turns, 60) == pytest.approx(0.25)
    assert month_at(NORMALS, turns, 60).temperature_c == pytest.approx(0.0 - 3.0)


def test_vapour_changes_by_factors_and_is_normal_before() -> None:
    turns = (turn_of(1.0, 2.0, vapour=0.5), turn_of(4.0, 4.0, vapour=0.4))
    assert [month_at(NORMALS, turns, month).vapour for month in (0, 30, 60)] == pytest.approx([1.0, 0.5, 0.2])
    assert month_at(NORMALS, turns, 17).vapour == pytest.approx(1.0 - 0.5 * (17.5 / 12 - 1.0))
    assert [factor(turns, month) for month in (0, 30, 60)] == [1.0, 1.0, 1.0]  # what clouds make of it is the air's


@pytest.mark.parametrize("at", [0.0, 1.0, 7.3])
def test_a_change_at_once_comes_between_two_months(at: float) -> None:
    """from_yr = to_yr is a step, and no division by zero before it."""
    turn = (turn_of(at, at, precipitation=3.0),)
    for month in range(120):
        assert factor(turn, month) == pytest.approx(3.0 if (month + 0.5) / 12 >= at else 1.0)


def test_a_change_as_recipes_write_it() -> None:
    chosen = parameters(climate_changes=[{"from_yr": 1, "to_yr": 2, "precipitation": 0.0}])
    assert chosen.climate_changes == (turn_of(1.0, 2.0, 0.0, 0.0),)


def test_the_places_are_those_of_the_paper_with_their_years_rain() -> None:
    assert set(places()) == {"San Diego", "Juneau"}
    san_diego, juneau = climate_of("San Diego"), climate_of("Juneau")
    assert san_diego.precipitation_mm_per_yr == pytest.approx(263, abs=1)
    assert juneau.precipitation_mm_per_yr == pytest.approx(1580, abs=5)
    assert san_diego.mean_temperature_c == pytest.approx(17.6, abs=0.5)
    assert juneau.mean_temperature_c == pytest.approx(5.6, abs=0.5)
    # San Diego's rain is of the winter, and Juneau's of the autumn.
    assert sum(san_diego.precipitation_mm[4:9]) < 0.05 * san_diego.precipitation_mm_per_yr
    assert juneau.precipitation_mm.index(max(juneau.precipitation_mm)) in (8, 9)


def test_places_are_found_in_any_case_and_near_names_are_told() -> None:
    assert climate_of("san diego") is climate_of("SAN DIEGO")
    with raises_error(RecipeError, place="community.climate.place"):
        climate_of("San Diago")
    with raises_error(RecipeError, place="community.climate.place"):
        climate_of("Xyzzy")


def test_a_places_numbers_can_be_replaced() -> None:
    wet = [100.0] * 12
    normals = parameters(climate={"place": "Juneau", "precipitation_mm": wet}).climate.normals()
    assert normals.precipitation_mm == tuple(wet)
    assert normals.temperature_c == climate_of("Juneau").temperature_c
