"""Disturbances that a recipe's species, site and duration do not allow."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"


def planned(disturbance: str, model: str = "forest_footprints", *more: str) -> Plan:
    community = f"community={{model: {model}, steps: 60, step_yr: 0.5, disturbances: [{disturbance}]}}"
    return check_plan(load_recipe(QUICKSTART, [community, *more]), simulate_only=True)


@pytest.mark.parametrize(
    ("disturbance", "message"),
    [
        ("{at_step: 61, fell: {}}", r"disturbances.0.at_step: the simulation ends[\s\S]*step 60, which is year 30"),
        ("{at_yr: 30.1, fell: {}}", r"disturbances.0.at_yr: [\s\S]*30.1 years, in step 61"),
        ("{at_yr: 3, fell: {species: [spruse]}}", r"fell.species.0: [\s\S]*'spruse'[\s\S]*did you mean 'spruce'"),
        ("{at_yr: 3, burn: {survival_of: {oak: 1}}}", "burn.survival_of.oak: the recipe has no species"),
        ("{at_yr: 3, plant: {species: oak, count: 3}}", "plant.species: the recipe has no species"),
        ("{at_yr: 3, plant: {species: spruce, positions_m: [[3, 3], [3, 121]]}}", r"positions_m.1: [\s\S]*\[3, 121\]"),
        ("{at_yr: 3, fell: {circle: {center_m: [-1, 3], radius_m: 5}}}", "fell.circle: this does not lie on the site"),
        ("{at_yr: 3, burn: {rectangle: {min_m: [0, 3], max_m: [121, 5]}}}", "burn.rectangle: this does not lie"),
        ("{at_yr: 3, plant: {species: spruce, count: 3, radius_m: 9}}", r"no spruce is so large[\s\S]*3\.2 m"),
        ("{at_yr: 3, cut: {}}", "unknown key 'cut'"),
        ("{at_yr: 3, fell: {circle: {center_m: [3], radius_m: 5}}}", "center_m"),
    ],
)
def test_what_cannot_be_is_refused(disturbance: str, message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        planned(disturbance)


def test_vigour_belongs_to_models_that_have_it() -> None:
    plant = "{at_yr: 3, plant: {species: spruce, count: 3, vigour: 7}}"
    planned(plant)
    with pytest.raises(RecipeError, match=r"plant.vigour: plants of this model have no vigour"):
        planned(plant, "multiset_lsystem")


def test_the_end_is_not_beyond_the_end() -> None:
    for disturbance in ("{at_step: 60, fell: {}}", "{at_yr: 30, fell: {}}", "{at_yr: 0, fell: {}}"):
        planned(disturbance)
    assert planned("").community.parameters.disturbances == ()


@pytest.mark.parametrize("model", ["forest_footprints", "multiset_lsystem"])
def test_a_planting_is_enough_to_grow_something(model: str) -> None:
    none = "species={fireweed: {from: fireweed, ecology: {seedlings_per_ha_per_yr: 0}}}"
    assert planned("{at_step: 3, plant: {species: fireweed, count: 1}}", model, none).community.empty_reason is None
    assert planned("{at_step: 3, fell: {}}", model, none).community.empty_reason
