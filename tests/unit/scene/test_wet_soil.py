"""From a community's water to the ground's wetness, and what a recipe says about it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.community.simulation import final_population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, make_plan
from forestgen.scene.site import wetness_of
from forestgen.scene.surfaces import Wetness
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
site: {size_m: [12, 9], ground: sand}
species: {shrub: }
community: {model: ecoclimate, climate: {place: Juneau}, steps: 1, initial_plants: 3, soil_water: {cell_m: 3}}
cameras: [{position_m: [6, -5, 2]}]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("wet")


def plan(folder: Path, *overrides: str, text: str = RECIPE) -> Plan:
    (folder / "recipe.yaml").write_text(text)
    return make_plan(load_recipe(folder / "recipe.yaml", overrides).draw(0))


@pytest.fixture(scope="module")
def population(folder: Path) -> Population:
    return final_population(plan(folder).community, Silent())


def wetness(folder: Path, population: Population, *overrides: str, **maps: float) -> Wetness:
    filled = {name: np.full((3, 4), value) for name, value in maps.items()}
    of = plan(folder, *overrides)
    found = wetness_of(of.community, replace(population, maps={**population.maps, **filled}))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("override", "soil_mm", "surface_mm", "saturation"),
    [
        ("community.soil_water.kind=forest", 100.0, 0.0, 0.25),  # of 400 mm
        ("community.soil_water.kind=dryland", 5.0, 0.0, 0.25),  # of 20 mm
        ("site.wet_soil={depth_m: 0.5, porosity: 0.5}", 100.0, 0.0, 0.4),
        ("community.soil_water.kind=forest", 900.0, 0.0, 1.0),
        ("community.soil_water.kind=forest", 100.0, 25.0, 0.25),
        ("community.soil_water.kind=forest", 100.0, 50.0, 1.0),
        ("community.soil_water.kind=forest", 0.0, 0.0, 0.0),
        ("site.wet_soil.pond_mm=10", 0.0, 15.0, 0.5),
    ],
)
def test_saturation(
    folder: Path, population: Population, override: str, soil_mm: float, surface_mm: float, saturation: float
) -> None:
    found = wetness(folder, population, override, soil_water_mm=soil_mm, surface_water_mm=surface_mm)
    assert found.size_m == (12.0, 9.0)
    np.testing.assert_allclose(found.saturation, np.full((3, 4), saturation))


def test_it_may_be_left_out(folder: Path, population: Population) -> None:
    for off in ("site.wet_soil=false", "site.wet_soil.shown=false"):
        of = plan(folder, off)
        assert wetness_of(of.community, population) is None


def test_other_communities_have_none_and_their_recipes_do_not_tell(folder: Path, population: Population) -> None:
    community = "{model: forest_footprints, steps: 1}"
    text = "\n".join(f"community: {community}" if "ecoclimate" in line else line for line in RECIPE.splitlines())
    of = plan(folder, text=text)
    assert wetness_of(of.community, population) is None
    assert "wet_soil" not in of.drawn.data["site"]
    with raises_error(RecipeError, place="site.wet_soil"):
        plan(folder, "site.wet_soil.depth_m=1", text=text)
    assert plan(folder, "site.wet_soil=false", text=text).drawn.recipe.site.wet_soil is not None


@pytest.mark.parametrize("least", ["{depth_m: 1e-9, porosity: 1e-300}", "{depth_m: 1e-200, porosity: 1e-200}"])
@pytest.mark.filterwarnings("error")
def test_a_soil_of_hardly_any_room_is_wet_as_soon_as_it_has_water(
    folder: Path, population: Population, least: str
) -> None:
    overrides = (f"site.wet_soil={least}", "site.wet_soil.pond_mm=1e-300")
    assert (wetness(folder, population, *overrides, soil_water_mm=5.0, surface_water_mm=0.0).saturation == 1).all()
    assert (wetness(folder, population, *overrides, soil_water_mm=0.0, surface_water_mm=5.0).saturation == 1).all()
    assert (wetness(folder, population, *overrides, soil_water_mm=0.0, surface_water_mm=0.0).saturation == 0).all()
