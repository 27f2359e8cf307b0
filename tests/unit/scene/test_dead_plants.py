"""Standing dead trees in a scene: bare, of dead wood, and drawn by nobody who lives."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_explicit_plants import cameras, grown, planned

from forestgen.community.population import Population, Status
from forestgen.community.simulation import dead_plants
from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.plants.dead_exemplar import WEATHERED
from forestgen.plants.growing import grow_exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import growth
from forestgen.scene.growth import species_seen
from forestgen.scene.plan import check_plan
from forestgen.scene.surfaces import materials_of
from support.error_messages import raises_error


@cache
def dying() -> Population:
    """The stand with every second plant dead."""
    alive = grown(houses=False)
    dead = np.arange(len(alive)) % 2 == 1
    status = np.where(dead, np.uint8(Status.DEAD), alive.status)
    return replace(alive, status=status, columns={**alive.columns, "dead_yr": np.where(dead, 3.0, 0.0)})


@pytest.mark.parametrize("unique", ["all", "none", 3])
def test_the_dead_are_bare_dead_wood_and_the_living_are_as_they_were(unique: str | int) -> None:
    plants = dying()
    plan = planned(houses=False, unique=unique, exemplars_per_species=1)
    chosen = growth.choose_exemplars(plan, plants, cameras(plan))
    requests = growth.exemplar_requests(plan, chosen, plants)
    dead = plants.status == Status.DEAD
    assert np.array_equal(dead[chosen.plant][chosen.exemplar_of_plant], dead)  # nobody stands for another kind
    materials = materials_of(species_seen(plan.drawn.species, plants))
    usual = planned(houses=False, unique=unique, exemplars_per_species=1)
    before = {request.key() for request in growth.exemplar_requests(usual, chosen, grown(houses=False))}
    for index, request in enumerate(requests):
        plant = grow_exemplar(request)
        parts = {organ.part for organ in plant.organs}
        if dead[chosen.plant[index]]:
            assert parts == {Part.DEAD_WOOD}
            assert {organ.material for organ in plant.organs} == {WEATHERED}
            assert plant.leaf_area_m2 == 0
            assert request.key() not in before
        else:
            assert Part.LEAF in parts
            assert Part.DEAD_WOOD not in parts
            assert request.key() in before
        assert all((request.species_name, organ.material) in materials for organ in plant.organs)


def test_a_species_may_have_dead_wood_of_its_own() -> None:
    plants, plan = dying(), planned(houses=False)
    oak = plan.drawn.species["oak"]
    own = oak.materials["bark"]
    with_own = oak.model_copy(update={"materials": {**oak.materials, WEATHERED: own}})
    seen = species_seen({**plan.drawn.species, "oak": with_own}, plants)
    assert seen["oak"].materials[WEATHERED] is own
    assert WEATHERED in seen["spruce"].materials
    assert all(WEATHERED not in one.materials for one in species_seen(plan.drawn.species, grown(houses=False)).values())


def test_dead_trees_that_would_bear_leaves_are_refused_before_anything_grows() -> None:
    data = {
        "forestgen": 1,
        "site": {"size_m": [16, 16]},
        "species": {"oak": {"from": "oak", "modules_plant": None}},
        "community": {"model": "branch_modules", "steps": 2, "standing_dead_yr": 5},
        "cameras": [{"position_m": [8, -10, 3]}],
    }
    with raises_error(RecipeError, place="species.oak"):
        check_plan(load_recipe_data(data, "test"))
    check_plan(load_recipe_data(data, "test"), simulate_only=True)
    data["community"] = {"model": "branch_modules", "steps": 2}
    check_plan(load_recipe_data(data, "test"))


def test_a_stand_of_nothing_but_dead_trees_is_told_from_one_that_lives() -> None:
    plants = dying()
    dead = replace(plants, status=np.full_like(plants.status, Status.DEAD))
    assert dead_plants(dead) == len(dead) > 0
    assert 0 < dead_plants(plants) < len(plants)
    assert dead_plants(grown(houses=False)) == 0
