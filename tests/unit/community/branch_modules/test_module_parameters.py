"""What a recipe may say about branch modules, and what changes make of it."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.community.branch_modules.capabilities import check_changes
from forestgen.community.branch_modules.parameters import (
    BranchModulesParameters,
    is_blocked,
    parameters_at,
)
from forestgen.core.errors import RecipeError
from forestgen.recipe.messages import Explainer
from forestgen.recipe.sources import SourceMap
from forestgen.recipe.species import Building, PlantType
from support.error_messages import raises_error

PINE = PlantType(
    life_span_yr=200, root_vigour_max=80, growth_rate_per_yr=0.3, apical_control=0.8, determinacy=1, shade_tolerance=0.4
)


def made(**keys: Any) -> BranchModulesParameters:
    return BranchModulesParameters.model_validate(keys)


def told(**keys: Any) -> str:
    """The message that people get."""
    with pytest.raises(ValidationError) as caught:
        made(**keys)
    return str(Explainer(BranchModulesParameters, keys, SourceMap(), ("community",)).error(caught.value))


def test_defaults_are_200_steps_of_a_year_and_every_species_own_climate() -> None:
    parameters = made()
    assert (parameters.steps, parameters.step_yr) == (200, 1.0)
    assert parameters.temperature_c is parameters.precipitation_mm_per_yr is None


@pytest.mark.parametrize("total", [0, 1, 7, 1000])
def test_a_number_is_shared_evenly(total: int) -> None:
    counts = made(initial_plants=total).counts(["pine", "oak", "shrub"])
    assert counts.sum() == total
    assert np.ptp(counts) <= 1


def test_numbers_by_species_leave_the_others_without() -> None:
    assert made(initial_plants={"oak": 5}).counts(["pine", "oak"]).tolist() == [0, 5]


def test_two_numbers_of_a_biome_are_the_climate() -> None:
    parameters = made(biome={"temperature_c": 5.6, "precipitation_mm_per_yr": 940})
    assert (parameters.temperature_c, parameters.precipitation_mm_per_yr) == (5.6, 940)
    assert BranchModulesParameters.model_validate(parameters.model_dump(mode="json")) == parameters


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"step_yr": 0}, r"step_yr: bad value\n +expected  a number of at least 0.001"),
        ({"temperature_c": 5, "precipitation_mm_per_yr": 9}, "expected  10 to 4300 mm a year\n +got       9 mm a year"),
        ({"temperature_c": 5, "precipitation_mm_per_yr": 4301}, "10 to 4300"),
        ({"temperature_c": 33.5, "precipitation_mm_per_yr": 900}, "expected  -10 to 33 deg C\n +got       33.5"),
        ({"biome": {"temperature_c": -11, "precipitation_mm_per_yr": 900}}, "biome.temperature_c: no such climate"),
        ({"temperature_c": 5}, "half a climate"),
        ({"biome": {"place": "Helsinki"}}, "a biome without a climate"),
        ({"lapse_rate_k_per_km": 1}, "lapse_rate_k_per_km"),
        ({"initial_plants": -1}, "initial_plants: bad value\n +expected  a whole number from 0"),
        ({"initial_plants": math.nan}, "initial_plants: bad value"),
        ({"initial_plants": True}, "initial_plants: bad value"),
        ({"initial_plants": {"oak": 1.5}}, "initial_plants.oak: bad value"),
        ({"soil": [[1, 1], [0.6, 1]]}, "soil: the soil map bars the whole site"),
        ({"changes": [{"at_yr": -1, "set": {"temperature_c": 5}}]}, "changes.0.at_yr: bad value"),
        ({"changes": [{"at_yr": 1, "set": {}}]}, "changes.0.set"),
        ({"changes": [{"at_yr": 1, "set": {"step_yr": 2}}]}, "step_yr holds for the whole simulation"),
        ({"changes": [{"at_yr": 1, "set": {"species.pine": 2}}]}, "this names no key of a species"),
    ],
)
def test_mistakes_are_told(keys: dict[str, Any], message: str) -> None:
    assert re.search(message, told(**keys)), told(**keys)


def test_soil_bars_what_is_above_half_with_its_first_row_in_the_north() -> None:
    blocked = made(soil=[[1, 0], [0, 0.5]]).blocked_soil()
    points = np.array([[5.0, 15.0], [15.0, 15.0], [5.0, 5.0], [15.0, 5.0], [20.0, 20.0]])
    assert is_blocked(blocked, points, (20.0, 20.0)).tolist() == [True, False, False, False, False]
    assert not is_blocked(None, points, (20.0, 20.0)).any()


def test_an_obstacle_turns_clockwise() -> None:
    house = Building.model_validate({"kind": "house", "position_m": (10, 20), "azimuth_deg": 90, "size_m": (8, 4, 6)})
    corners = house.corners_m()
    np.testing.assert_allclose(corners.min(axis=0), [8, 16], atol=1e-12)
    np.testing.assert_allclose(corners.max(axis=0), [12, 24], atol=1e-12)
    slightly = Building.model_validate(
        {"kind": "house", "position_m": (0, 0), "azimuth_deg": 30, "size_m": (8, 4, 6)}
    ).corners_m()
    along = slightly[1] - slightly[0]  # its width, which pointed east
    assert along[0] > 0
    assert along[1] == pytest.approx(-8 * math.sin(math.radians(30)))


def test_changes_hold_from_the_end_of_their_step_on() -> None:
    parameters = made(
        step_yr=0.1,
        temperature_c=5,
        precipitation_mm_per_yr=900,
        soil=[[0, 1]],
        changes=[
            {"at_yr": 0.5, "set": {"temperature_c": 7, "crowding": 2}},
            {"at_yr": 0.3, "set": {"temperature_c": 6, "species.pine.shade_tolerance": 0.2}},
        ],
    )
    seen = [parameters_at(parameters, {"pine": PINE}, step) for step in range(7)]
    assert [one.temperature_c for one, _ in seen] == [5, 5, 5, 6, 6, 7, 7]
    assert [one.crowding for one, _ in seen] == [4, 4, 4, 4, 4, 2, 2]
    assert [kinds["pine"].shade_tolerance for _, kinds in seen] == [0.4] * 3 + [0.2] * 4
    assert seen[0][0] is parameters
    assert seen[6][0].soil is parameters.soil
    assert PINE.shade_tolerance == 0.4


def _checked(*changes: dict[str, Any]) -> None:
    def parse(model: Any, data: Any, keys: Any) -> Any:
        try:
            return model.model_validate(dict(data))
        except ValidationError as failure:
            raise Explainer(model, data, SourceMap(), tuple(keys)).error(failure) from failure

    parameters = made(temperature_c=5, precipitation_mm_per_yr=900, changes=list(changes))
    drawn: Any = SimpleNamespace(parse=parse, where=lambda *keys: ".".join(map(str, keys)))
    check_changes(drawn, parameters, {"pine": PINE}, ("column",))


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(
            {"crowdin": 5},
            marks=pytest.mark.slow,  # loads all models, to tell their keys apart
        ),
        {"precipitation_mm_per_yr": 9000},
        {"crowding": 2, "cell_m": 0},
        {"temperature_c": None},
        {"species.pine.shade_tolerence": 1},
        {"species.pine.vigour_max": 0.05},
        {"species.oak.vigour_min": 3},
    ],
)
def test_a_change_that_cannot_be_made_is_told_before(change: dict[str, Any]) -> None:
    good = {"at_yr": 9999, "set": {"temperature_c": 8}}
    _checked(good)
    with raises_error(RecipeError):
        _checked(good, {"at_yr": 5, "set": change})


def test_what_only_a_later_change_allows_is_refused_before_it() -> None:
    _checked({"at_yr": 2, "set": {"species.pine.vigour_max": 0.05, "species.pine.vigour_min": 0.01}})
    with raises_error(RecipeError, place="community.changes.0.set.species.pine.vigour_max"):
        _checked(
            {"at_yr": 1, "set": {"species.pine.vigour_max": 0.05}},
            {"at_yr": 2, "set": {"species.pine.vigour_min": 0.01}},
        )


def test_every_key_says_what_it_is() -> None:
    schema = BranchModulesParameters.model_json_schema()
    assert all(one.get("description") for one in schema["properties"].values())
    assert schema["$defs"]["Biome"]["properties"]["temperature_c"]["anyOf"][0]["maximum"] == 33
