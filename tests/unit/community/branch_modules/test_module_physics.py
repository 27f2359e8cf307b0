"""Branch modules: what bounds plants and stands, by the types of Table 1."""

from __future__ import annotations

import numpy as np
import pytest
from test_module_engine import MODEL, ecology, last, mixed, plant_type, same, states

from forestgen.architecture.geometry import diameters
from forestgen.architecture.prototypes import load_prototypes
from forestgen.community.branch_modules.growth import PATIENCE, STUNTED, on_axis, stature_of
from forestgen.community.branch_modules.state import step_parameters
from forestgen.community.population import Site
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

PINE = {"apical_control": 0.95, "apical_control_mature": 0.5, "flowering_age_yr": 25, "determinacy": 0.82}


def pine(**more):
    return plant_type("h", **{**PINE, "determinacy_mature": None, "seeds_per_yr": 0.0, "shade_tolerance": 0.05, **more})


def test_a_type_has_the_prototypes_that_it_names_and_no_others():
    state = last("", 12, types={"x": plant_type("b", prototypes=("spiral", "zigzag"), seeds_per_yr=0.0)})
    names = [one.name for one in load_prototypes()]
    assert {names[k] for k in state.modules.prototype} <= {"spiral", "zigzag"}
    free = last("", 12, types={"x": plant_type("b", prototypes=tuple(names), seeds_per_yr=0.0)})
    assert same(free, last("", 12, types={"x": plant_type("b", seeds_per_yr=0.0)}))
    with raises_error(RecipeError):
        MODEL.init(MODEL.Parameters(), Site((9.0, 9.0)), [ecology("x", plant_type("b", prototypes=("whorld",)))], 1)


@pytest.mark.parametrize(("row", "low", "high"), [("c", 0.8, 1.3), ("b", 1.0, 2.0), ("o", 1.0, 2.0)])
def test_the_height_of_a_lone_plant_levels_off_by_its_reach(row, low, high):
    reach_m, rate = 12.0, 0.6
    prototypes = ("column",) if row == "c" else ()
    kind = plant_type(
        row, reach_m=reach_m, growth_rate_per_yr=rate, life_span_yr=300, prototypes=prototypes, seeds_per_yr=0.0
    )
    height = [float(MODEL.population(state).height_m[0]) for state in states("", 120, types={"x": kind})]
    assert low * reach_m < height[-1] < high * reach_m
    assert height[-1] - height[60] < 0.15 * (height[60] - height[0])


def test_leaves_and_sizes_of_modules_are_those_of_their_terminals():
    state = last(**mixed(12))
    modules, kinds = state.modules, step_parameters(state)
    stature = stature_of(modules, state.plants.species, kinds)
    assert np.all((stature.leaves >= 0) & (stature.leaves <= 1) & (stature.size > 0) & (stature.size <= 1))
    bearer, ends = modules.parent_row(), kinds.tables.terminals[modules.prototype]
    for row in range(0, len(modules), 5):
        borne = np.flatnonzero(bearer == row)
        if modules.age[row] < 1:
            assert len(borne) == 0
        elif bearer[row] >= 0:
            assert stature.leaves[row] == pytest.approx(1 - modules.age[borne].sum() / ends[row], abs=1e-5)
    # A bud has the weight of the terminal that it sits on, and adds no light to the plant.
    buds = (modules.age == 0) & (bearer >= 0)
    assert buds.any()
    assert np.all(stature.leaves[buds] == 0)
    assert np.allclose(stature.size[buds], 1 / ends[bearer[buds]])


def test_no_bud_waits_for_ever():
    kind = pine(root_vigour_max=12, growth_rate_per_yr=0.4)
    for state in states("", 60, plants=4, types={"x": kind}):
        waits = state.modules.age_yr > PATIENCE / 0.4 + 1
        assert np.all(state.modules.age[waits] >= STUNTED)
    assert waits.sum() > 20


def test_a_crown_that_sheds_and_grows_keeps_the_share_of_disused_pipes_and_no_node_shrinks():
    """Feet of all modules, year by year; with all pipes kept for good trunks end thicker."""

    def trunk_m(share):
        before = {}
        for state in states("", 45, plants=60, side_m=14.0, types={"x": pine(disused_share=share)}):
            modules = state.modules
            width = diameters(step_parameters(state).tables, modules, state.plants.species)
            plant = state.plants.plant_id[modules.plant()].tolist()
            after = dict(zip(zip(plant, modules.number.tolist(), strict=True), width.tolist(), strict=True))
            for key, wide in after.items():
                assert wide >= before.get(key, 0.0) * (1 - 1e-4)
            before = after
        return float(np.mean(width[modules.first[:-1]]))

    assert trunk_m(0.0) < trunk_m(1.0)


@pytest.mark.slow
def test_crowded_conifers_lose_their_lowest_branches_and_keep_their_tops():
    top, lowest, lost = {}, {}, 0.0
    for state in states("", 80, plants=60, side_m=14.0, periodic=True, types={"x": pine()}):
        found = MODEL.population(state)
        now = dict(zip(found.plant_id.tolist(), found.height_m.tolist(), strict=True))
        lost = max([lost, *(1 - height / top[key] for key, height in now.items() if top.get(key, 0) > 3)])
        top = {key: max(height, top.get(key, 0.0)) for key, height in now.items()}
        if state.step in (30, 80):
            kinds, modules = step_parameters(state), state.modules
            branch = ~on_axis(modules, kinds.main_path)
            foot = np.full(len(now), np.nan)
            np.fmin.at(foot, modules.plant()[branch], modules.base_m[branch, 2])
            lowest[state.step] = dict(zip(now, foot.tolist(), strict=True))
    assert len(now) < 50  # it is crowded
    rise = [lowest[80][key] - lowest[30][key] for key in lowest[80]]
    assert np.nanmedian(rise) > 1.0
    assert np.median([1 - now[key] / top[key] for key in now]) < 0.05  # of the living; who dies loses its top too
    assert lost < 0.6


@pytest.mark.slow
def test_two_hundred_years_of_seeding_do_not_fill_the_ground():
    """A type that lives in the deepest shade, and seeds freely."""
    kind = plant_type("b", shade_tolerance=0.6, seeds_per_yr=5.0, life_span_yr=120, growth_rate_per_yr=0.15)
    counts = [len(state.plants) for state in states("", 200, plants=16, side_m=10.0, periodic=True, types={"x": kind})]
    per_m2 = np.array(counts) / 10.0**2
    assert per_m2.max() < 1.3
    assert per_m2[150:].mean() < 1.25 * per_m2[90:150].mean()
