"""From a community of branch modules to a scene: own branches, stand-ins, houses, and recipes that cannot be."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.community.simulation import final_population
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.parts import Part
from forestgen.core.progress import Silent, Timings
from forestgen.plants.growing import grow_exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.scene import build as scene
from forestgen.scene import growth
from forestgen.scene.build import place_instances
from forestgen.scene.growth import has_branches
from forestgen.scene.plan import Plan, check_exemplars, estimate_bytes, make_plan, own_triangles
from forestgen.scene.views import drawn_cameras
from support.error_messages import raises_error

HOUSES = [
    {"kind": "house", "position_m": [12, 12], "azimuth_deg": 25, "size_m": [6, 5, 5]},
    {"kind": "house", "position_m": [4, 4], "azimuth_deg": 70, "size_m": [4, 3, 3]},
    {"kind": "house", "position_m": [4, 12], "azimuth_deg": 0, "size_m": [6, 5, 5]},
]


def planned(*, houses: bool = True, **plants: object) -> Plan:
    data = {
        "forestgen": 1,
        "seed": 3,
        "site": {"size_m": [16, 16], "buildings": HOUSES if houses else []},
        "species": {"oak": None, "spruce": None},
        "community": {
            "model": "branch_modules",
            "steps": 8,
            "initial_plants": {"oak": 4, "spruce": 5},
        },
        "plants": plants,
        "cameras": [
            {"kind": "perspective", "position_m": [8, -10, 3], "look_at_m": [8, 8, 2], "size_px": [320, 200],
             "hfov_deg": 60}
        ],
    }  # fmt: skip
    return make_plan(load_recipe_data(data, "test").draw(0))


@cache
def grown(*, houses: bool = True) -> Population:
    plan = planned(houses=houses)
    state = plan.community.model.init(
        plan.community.parameters, plan.community.site, plan.community.ecologies, plan.drawn.image_seed
    )
    for _ in range(plan.community.steps):
        state = plan.community.model.step(state)
    population: Population = plan.community.model.population(state)
    return population


def cameras(plan: Plan):
    return [camera for entry in drawn_cameras(plan.drawn) for camera in entry]


def test_unique_plants_have_their_own_wood_and_are_kept_on_no_disk():
    plan, plants = planned(unique=3, exemplars_per_species=1), grown()
    chosen = growth.choose_exemplars(plan, plants, cameras(plan))
    requests = growth.exemplar_requests(plan, chosen, plants)
    assert chosen.is_unique.sum() == 3
    grown_ones = np.flatnonzero(chosen.species != 2)
    for index, request in zip(grown_ones.tolist(), requests, strict=True):
        row = int(chosen.plant[index])
        assert request.species_name == plants.species_names[chosen.species[index]]
        assert request.wood is not None
        assert request.identity == ("own", int(plants.plant_id[row]))
        assert request.is_kept != chosen.is_unique[index]
        assert request.wood.height_m == pytest.approx(plants.height_m[row], abs=0.011)
    assert len({request.key() for request in requests}) == len(requests)


def test_exemplars_are_grown_from_the_branches_and_marked():
    plan, plants = planned(unique="all"), grown()
    chosen = growth.choose_exemplars(plan, plants, cameras(plan))
    requests = growth.exemplar_requests(plan, chosen, plants)
    grown_ones = np.flatnonzero(chosen.species != 2)
    place = int(np.argmax(plants.height_m[chosen.plant[grown_ones]]))
    tallest = grown_ones[place]
    plant = grow_exemplar(requests[place])
    marks, row = plant.marks(), int(chosen.plant[tallest])
    assert plants.modules is not None
    own = plants.modules.number[plants.modules.first[row] : plants.modules.first[row + 1]]
    assert marks is not None
    assert set(np.unique(marks // 32).tolist()) <= set(own.tolist())
    assert plant.height_m > 0.9 * plants.height_m[row]


def test_houses_have_one_exemplar_a_size_and_stand_turned():
    plan, plants = planned(unique="none"), grown()
    chosen = growth.choose_exemplars(plan, plants, cameras(plan))
    rows = np.flatnonzero(plants.species == 2)
    assert len(rows) == 3
    mine = chosen.exemplar_of_plant[rows]
    assert mine[0] == mine[2] != mine[1]
    exemplars = growth.grow_planned(plan, chosen, Silent(), plants)
    assert [exemplars[int(index)].height_m for index in mine[:2]] == [5.0, 3.0]
    house = exemplars[int(mine[0])]
    assert {organ.part for organ in house.organs} == {Part.STRUCTURE}
    stands_for_m = plants.height_m[chosen.plant]
    turned = plan.community.obstacles.turned(plants)
    placed = place_instances(turned, chosen.exemplar_of_plant, exemplars, 0, stands_for_m=stands_for_m)
    linear = placed.transform[rows, :, :3]
    np.testing.assert_allclose(np.linalg.det(linear), 1.0, atol=1e-9)
    for matrix, one in zip(linear, HOUSES, strict=True):
        turn = -np.radians(float(str(one["azimuth_deg"])))
        np.testing.assert_allclose(matrix[:2, 0], [np.cos(turn), np.sin(turn)], atol=1e-9)


def test_a_population_without_modules_is_drawn_by_its_generator():
    plan = planned(houses=False)
    bare = grown(houses=False)
    plain = Population(**{name: getattr(bare, name) for name in bare.__dataclass_fields__ if name != "modules"})
    assert has_branches(plan, bare).any()
    assert not has_branches(plan, plain).any()
    chosen = growth.choose_exemplars(plan, plain, cameras(plan))
    assert np.all(chosen.plant == -1)
    assert all(request.wood is None for request in growth.exemplar_requests(plan, chosen, plain))


def test_memory_counts_the_plants_that_are_unique():
    none, some, auto = (planned(unique=wanted) for wanted in ("none", 40, "auto"))
    need = [estimate_bytes(plan)["exemplars"] for plan in (none, some, auto)]
    assert 2 * need[0] < need[2] == need[1]
    assert own_triangles(replace(auto, plants=replace(auto.plants, foliage={}))) == 0


def test_plants_that_came_out_larger_than_the_memory_are_not_rendered(monkeypatch: pytest.MonkeyPatch):
    plan, population = planned(unique="none", exemplars_per_species=1), grown()
    chosen = growth.choose_exemplars(plan, population, cameras(plan))
    exemplars = growth.grow_planned(plan, chosen, Silent(), population)
    left = 130 * sum(one.triangles for one in exemplars)  # a mesh has some 70 of 200 bytes a triangle
    for free, refused in ((2 * left, False), (left // 2, True)):
        monkeypatch.setattr("forestgen.scene.plan.free_bytes", lambda free=free: free)
        with raises_error(ResourceError, place="plants.exemplars_per_species") if refused else nullcontext():
            check_exemplars(plan, exemplars)


def test_more_plants_as_themselves_than_memory_holds_are_refused(monkeypatch: pytest.MonkeyPatch):
    plan, population = planned(unique="all"), grown()
    growth.choose_exemplars(plan, population, cameras(plan))
    monkeypatch.setattr("forestgen.scene.plan.free_bytes", lambda: 5_000_000)
    with raises_error(ResourceError, place="plants.unique"):
        growth.choose_exemplars(plan, population, cameras(plan))
    growth.choose_exemplars(planned(unique="none"), population, cameras(plan))


@pytest.mark.parametrize("wanted", ["some", -1, 2.5, True])
def test_another_number_of_unique_plants_is_refused(wanted: object):
    with raises_error(RecipeError, place="plants.unique"):
        planned(unique=wanted)


def test_another_generator_clothes_no_modules():
    species = {"oak": {"from": "oak", "modules_plant": {"generator": "deadwood"}}}
    data = {"forestgen": 1, "species": species, "community": {"model": "branch_modules"}}
    with raises_error(RecipeError, place="species.oak.modules_plant.generator"):
        make_plan(load_recipe_data(data, "test").draw(0))


def test_a_species_without_modules_has_no_branches_to_be_drawn():
    species = {"larch": {"from": "larch", "modules": None}}
    data = {"forestgen": 1, "species": species, "community": {"model": "multiset_lsystem", "program": "succession"}}
    with raises_error(RecipeError, place="species.larch.plant.generator"):
        make_plan(load_recipe_data(data, "test").draw(0))


def test_in_another_community_a_species_of_modules_has_the_sizes_that_the_community_gives():
    plants = [{"species": "redgrass", "position_m": [x, 5], "radius_m": r} for x, r in ((3, 0.2), (6, 0.3))]
    data = {
        "forestgen": 1,
        "site": {"size_m": [9, 9]},
        "species": {"redgrass": None},
        "community": {"model": "placed", "plants": plants},
        "cameras": [{"position_m": [4, -5, 2]}],
    }
    plan = make_plan(load_recipe_data(data, "test").draw(0))
    assert plan.plants.foliage == {}
    built = scene.build_scene(plan, final_population(plan.community, Silent()), Silent(), Timings())
    heights = [float(plan.drawn.species["redgrass"].allometry.height(r)) for r in (0.2, 0.3)]
    assert sorted(one.height_m for one in built.spec.exemplars) == pytest.approx(heights, rel=0.1)
    assert all(one.leaf_area_m2 > 0 for one in built.spec.exemplars)
