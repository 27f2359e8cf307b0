"""The community and the scene stand on the same ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from forestgen.community.resume import origin
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, make_plan
from forestgen.scene.site import height_field
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
HILLS = "site.terrain={kind: rolling, amplitude_m: 6, wavelength_m: 60}"


def planned(*overrides: str) -> Plan:
    return make_plan(load_recipe(QUICKSTART, overrides).draw(0))


def test_a_plan_knows_the_ground_that_its_scene_will_have() -> None:
    plan = planned(HILLS, "site.altitude_m=700", "site.latitude_deg=-41.5", "site.wind_from_deg=300")
    assert (plan.community.site.altitude_m, plan.community.site.latitude_deg, plan.community.site.wind_from_deg) == (
        700,
        -41.5,
        300,
    )
    assert plan.community.site.height is height_field(plan.drawn)
    x = np.linspace(0, 50, 7)
    assert np.ptp(plan.community.site.height(x, x)) > 1


def test_sites_of_one_image_are_equal_and_those_of_others_are_not() -> None:
    first, again = planned(HILLS), planned(HILLS)
    assert first.community.site is first.community.site
    assert first.community.site == again.community.site
    assert hash(first.community.site) == hash(again.community.site)
    assert first.community.site != planned(HILLS, "seed=12").community.site
    assert first.community.site != planned(HILLS, "site.terrain.amplitude_m=7").community.site


@pytest.mark.parametrize("terrain", ["flat", "{kind: rolling, amplitude_m: 0}"])
def test_level_ground_has_no_height_function(terrain: str) -> None:
    assert planned(f"site.terrain={terrain}").community.site.height is None


def test_what_a_history_started_with_names_its_ground() -> None:
    about = origin(planned(HILLS, "site.altitude_m=700").community)["site"]
    assert about["terrain"] == {"kind": "rolling", "amplitude_m": 6.0, "wavelength_m": 60.0, "hills_m": 22.0}
    assert (about["altitude_m"], about["latitude_deg"], about["wind_from_deg"]) == (700.0, 50.0, 270.0)
    assert origin(planned("site.terrain=flat").community)["site"]["terrain"] == "flat"


@pytest.mark.parametrize("override", ["site.latitude_deg=91", "site.altitude_m=1e5", "site.wind_from_deg=400"])
def test_places_that_earth_does_not_have_are_refused(override: str) -> None:
    with raises_error(RecipeError, place=override.split("=")[0]):
        planned(override)
