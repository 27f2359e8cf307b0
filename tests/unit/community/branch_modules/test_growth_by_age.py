"""Stands of shipped species: heights by age as published, self-thinning, straight trunks, and the laws behind them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from test_module_engine import last, plant_type, states

from forestgen.community.branch_modules.growth import on_axis, pace_of
from forestgen.community.branch_modules.state import State, step_parameters
from forestgen.community.models.branch_modules import MODEL
from support.site_curves import CURVES, PLANTS_PER_HA, RANGES_M, SIDE_M, grown_stand, measured

AREA_HA = SIDE_M**2 / 1e4
BY_DEFAULT = {"birch"}
NAMES = [pytest.param(name, marks=() if name in BY_DEFAULT else pytest.mark.slow) for name in CURVES]
# A moderately thinned stand has about three quarters of the basal area of one that is not (Assmann 1970, chapter D).
MOST_OVER_THINNED = 1.35


@cache
def grown(name: str) -> list[State]:
    return grown_stand(name, 80)


def ages(states: list[State]):
    return {age: measured(MODEL.population(state), AREA_HA) for age, state in enumerate(states) if age in (20, 40, 80)}


@pytest.mark.parametrize("name", NAMES)
def test_heights_at_80_years_are_within_a_fifth_of_published_ones_and_stands_thin_themselves(name):
    curve, stands = CURVES[name], ages(grown(name))
    height = {age: one.top_m if curve.height == "top" else one.mean_m for age, one in stands.items()}
    assert height[80] == pytest.approx(curve.height_m[80], rel=0.2)
    assert height[40] == pytest.approx(curve.height_m.get(40, height[40]), rel=0.2)
    assert stands[80].stems_per_ha < 0.9 * PLANTS_PER_HA
    if curve.basal_area_m2_per_ha is not None:
        assert stands[80].basal_area_m2_per_ha < MOST_OVER_THINNED * curve.basal_area_m2_per_ha


@pytest.mark.slow
@pytest.mark.parametrize("name", RANGES_M)
def test_trees_without_a_site_curve_are_as_tall_as_those_of_their_forests(name):
    low_m, high_m, age_yr, _ = RANGES_M[name]
    stand = measured(MODEL.population(grown(name)[age_yr]), AREA_HA)
    assert low_m < stand.top_m < high_m
    assert stand.basal_area_m2_per_ha < 50


@pytest.mark.parametrize("name", ["birch", pytest.param("poplar", marks=pytest.mark.slow)])
def test_trunks_of_forest_trees_are_straight(name):
    """The main axis leaves the line from foot to top by less than 2% of the height."""
    state = grown(name)[45]
    modules, is_axis = state.modules, on_axis(state.modules, step_parameters(state).main_path)
    away = []
    for first, end in zip(modules.first[:-1], modules.first[1:], strict=True):
        axis_m = modules.base_m[first:end][is_axis[first:end]].astype(np.float64)
        top = axis_m[-1]
        if top[2] < 8.0:
            continue
        along = top / np.linalg.norm(top)
        away.append(np.linalg.norm(axis_m - np.outer(axis_m @ along, along), axis=1).max() / top[2])
    assert len(away) > 10
    assert np.median(away) < 0.02


def test_growth_that_slows_with_the_way_follows_mitscherlichs_law_to_its_limit():
    """H(t) = L (1 - exp(-k t)) of a sole stem: equal steps of time take equal shares of what is left to the limit."""
    limit_m = 20.0
    kind = plant_type("c", slowing_per_m=1 / limit_m, reach_m=400.0, seeds_per_yr=0.0, prototypes=("column",))
    states_of = list(states("", 90, types={"x": kind.model_copy(update={"life_span_yr": 500.0})}))
    height = [float(MODEL.population(states_of[years]).height_m[0]) for years in (6, 12, 18, 90)]
    left = [height[-1] - one for one in height]
    assert 0.9 * limit_m < height[-1] < limit_m + 2.0  # the last module begins below the limit
    assert left[1] / left[0] == pytest.approx(left[2] / left[1], rel=0.25)


def test_plants_of_a_type_grow_at_rates_of_the_spread_that_it_gives():
    now = step_parameters(last("", 1, types={"x": plant_type("h", growth_spread=0.15)}))
    plant_id = np.arange(1, 20_001, dtype=np.uint32)
    pace = pace_of(3, plant_id, np.zeros(len(plant_id), dtype=np.uint16), now)
    assert pace.mean() == pytest.approx(1.0, abs=0.005)
    assert pace.std() == pytest.approx(0.15, rel=0.02)
    np.testing.assert_array_equal(pace[5:9], pace_of(3, plant_id[5:9], np.zeros(4, dtype=np.uint16), now))
