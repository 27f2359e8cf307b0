"""Plants at given places: where and how large the recipe says, and nothing but older."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.model import simulate
from forestgen.community.models.placed import MODEL, PlacedParameters
from forestgen.community.population import Site, Status
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error

SITE = Site((20.0, 10.0))


@pytest.fixture
def species(tree):
    return [tree(), tree(name="shrub", height_scale=2.0, height_exponent=0.5)]


def placed(species, steps=0, **given):
    parameters = PlacedParameters(steps=steps, **given)
    return list(simulate(MODEL, parameters, SITE, species, 7, steps=steps))


def test_plants_stand_as_given_and_grow_older(species):
    plants = [
        {"species": "shrub", "position_m": [3, 4], "radius_m": 0.25, "age_yr": 2.5, "azimuth_deg": 90},
        {"species": "tree", "position_m": [0, 10]},
        {"species": "tree", "position_m": [1.5, 2], "height_m": 4},
        {"species": "shrub", "position_m": [20, 10], "age_yr": 30},
    ]
    first, *_, last = placed(species, 3, plants=plants, step_yr=0.5)
    assert first.plant_id.tolist() == [1, 2, 3, 4]
    assert first.position_m.tolist() == [[3, 4, 0], [0, 10, 0], [1.5, 2, 0], [20, 10, 0]]
    assert first.species.tolist() == [1, 0, 0, 1]
    assert first.status.tolist() == [Status.GROWING, Status.MATURE, Status.GROWING, Status.MATURE]
    assert first.height_m == pytest.approx([1.0, 8 * 2**0.75, 4.0, 2 * 2**0.5])
    assert first.radius_m == pytest.approx([0.25, 2, 0.5 ** (1 / 0.75), 2])
    assert first.age_yr.tolist() == [2.5, 0, 0, 30]
    assert (last.age_yr - first.age_yr).tolist() == [1.5] * 4
    for name in ("position_m", "radius_m", "height_m", "status"):
        assert np.array_equal(getattr(first, name), getattr(last, name))


def test_a_height_is_kept_to_the_bit_and_its_radius_gives_it_back(species):
    heights = np.linspace(0.01, 13.4, 50)
    plants = [{"species": "tree", "position_m": [1, 1], "height_m": h} for h in heights]
    (population,) = placed(species, plants=plants)
    assert population.height_m.tolist() == heights.tolist()
    assert 8 * population.radius_m**0.75 == pytest.approx(heights)


def test_the_turn_is_given_or_the_plants_own(species):
    plants = [{"species": "tree", "position_m": [1, 1], "azimuth_deg": a} for a in (None, 30, None)]
    (one,) = placed(species, plants=plants)
    (other,) = placed(species, plants=[*plants[:2], plants[1], plants[2]])
    angle = one.columns["azimuth_deg"]
    assert angle[1] == 30
    assert angle[0] != angle[2]
    assert other.columns["azimuth_deg"][0] == angle[0]
    many = [{"species": "tree", "position_m": [1, 1]}] * 400
    drawn = placed(species, plants=many)[0].columns["azimuth_deg"]
    assert np.histogram(drawn, 4, (0, 360))[0].min() > 70


@pytest.mark.parametrize(
    "plant",
    [{"position_m": [20.1, 5]}, {"position_m": [5, -0.1]}, {"radius_m": 2.5}, {"height_m": 14}, {"height_m": 1e-320}],
)
def test_what_cannot_stand_there_is_refused(species, plant):
    with raises_error(RecipeError, place="community.plants.0"):
        placed(species, plants=[{"species": "tree", "position_m": [1, 1], **plant}])


def test_a_species_of_one_height_takes_no_other(tree):
    constant = [tree(height_exponent=0.0)]
    assert placed(constant, plants=[{"species": "tree", "position_m": [1, 1], "height_m": 8}])[0].radius_m == 2.0
    for height in (7.9, 8.1):
        with raises_error(RecipeError, place="community.plants.0"):
            placed(constant, plants=[{"species": "tree", "position_m": [1, 1], "height_m": height}])


def test_a_plan_refuses_what_the_simulation_would():
    recipe = {
        "forestgen": 1,
        "site": {"size_m": [20, 10]},
        "species": {"spruce": {"from": "spruce"}},
        "community": {"model": "placed", "plants": [{"species": "spruce", "position_m": [30, 5]}]},
    }
    with raises_error(RecipeError, place="community.plants.0"):
        check_plan(load_recipe_data(recipe, "test"), simulate_only=True)


def test_a_recipe_with_traits_may_place_plants_anywhere_on_a_large_site():
    recipe = {
        "forestgen": 1,
        "site": {"size_m": [90, 90]},
        "species": {"spruce": {"from": "spruce"}},
        "community": {"model": "placed", "plants": [{"species": "spruce", "position_m": [80, 80]}]},
        "plants": {"traits": ["height_m"]},
        "cameras": [{"position_m": [40, -20, 5]}],
    }
    check_plan(load_recipe_data(recipe, "test"))
