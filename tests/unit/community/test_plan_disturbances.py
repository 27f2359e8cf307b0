"""Disturbances that a recipe's species, site and duration do not allow."""

from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"


def planned(disturbance: str, model: str = "forest_footprints", *more: str) -> Plan:
    community = f"community={{model: {model}, steps: 60, step_yr: 0.5, disturbances: [{disturbance}]}}"
    return check_plan(load_recipe(QUICKSTART, [community, *more]), simulate_only=True)


@pytest.mark.parametrize(
    "disturbance",
    [
        "{at_step: 61, fell: {}}",
        "{at_yr: 30.1, fell: {}}",
        "{at_yr: 3, fell: {species: [spruse]}}",
        "{at_yr: 3, burn: {survival_of: {oak: 1}}}",
        "{at_yr: 3, plant: {species: oak, count: 3}}",
        "{at_yr: 3, plant: {species: spruce, positions_m: [[3, 3], [3, 121]]}}",
        "{at_yr: 3, fell: {circle: {center_m: [-1, 3], radius_m: 5}}}",
        "{at_yr: 3, burn: {rectangle: {min_m: [0, 3], max_m: [121, 5]}}}",
        "{at_yr: 3, plant: {species: spruce, count: 3, radius_m: 9}}",
        "{at_yr: 3, cut: {}}",
        "{at_yr: 3, fell: {circle: {center_m: [3], radius_m: 5}}}",
    ],
)
def test_what_cannot_be_is_refused(disturbance: str) -> None:
    with raises_error(RecipeError):
        planned(disturbance)


def test_vigour_belongs_to_models_that_have_it() -> None:
    plant = "{at_yr: 3, plant: {species: spruce, count: 3, vigour: 7}}"
    planned(plant)
    with raises_error(RecipeError, place="community.disturbances.0.plant.vigour"):
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
