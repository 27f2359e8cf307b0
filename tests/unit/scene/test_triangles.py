"""Triangles of exemplars before anything has grown: those that there are then, rather more, at most twice as many."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.core.progress import Silent, Timings
from forestgen.core.randomness import child_rng
from forestgen.pipeline import assemble_image
from forestgen.plants.build import build_exemplar, tree_size
from forestgen.recipe.load import load_recipe, load_recipe_data
from forestgen.recipe.tree_sizes import own_normals
from forestgen.scene.ground_layers.layer import GROUND
from forestgen.scene.plan import Plan, check_plan, make_plan
from forestgen.scene.triangles import exemplar_triangles, triangles_of
from support.tiers import few, slow_but

ROOT = Path(__file__).parents[3]
RECIPES = (
    "walk_in_the_wind",
    "training_set",
    "quickstart",
    "old_forest",
    "kernel_growth",
    "weather_story",
    "mixed_stand",
    "drone",
    "robot",
    "sapling_stand",
    "afforestation",
    "vista",
)
FAR_COPIES = "(surroundings)"  # merged meshes, no exemplars of a species
SPECIES = sorted((ROOT / "scenes" / "species").glob("*.yaml"))
MEASURED = [one.stem for one in SPECIES if "\ntriangles:" in one.read_text(encoding="utf-8")]


def estimated(plan: Plan) -> float:
    return exemplar_triangles(plan.drawn, plan.plants, plan.community, plan.views.all_cameras)


@pytest.mark.parametrize("name", few(RECIPES))
def test_the_estimate_is_at_most_twice_what_there_is(name: str) -> None:
    plan = check_plan(load_recipe(ROOT / "recipes" / f"{name}.yaml", ("plants.near_foliage=false",)))
    made = assemble_image(plan, Silent(), Timings()).spec.exemplars
    there = sum(one.triangles for one in made if one.species not in (FAR_COPIES, GROUND))
    assert there < estimated(plan) < 2.0 * there


def planned(community: dict[str, Any], side_m: float = 40, **plants: Any) -> Plan:
    camera = {"position_m": [0, 0, 2], "look_at_m": [9, 9, 2], "obstructed": "note"}
    data = {"forestgen": 1, "site": {"size_m": [side_m] * 2}, "species": {"beech": None, "birch": None}}
    loaded = load_recipe_data({**data, "community": community, "plants": plants, "cameras": [camera]}, "test")
    return make_plan(loaded.draw(0))


def stand(stems_per_ha: float = 400, top_m: float = 20) -> dict[str, Any]:
    storey = {"species": {"beech": 1}, "stems_per_ha": stems_per_ha, "dominant_height_m": top_m}
    return {"model": "stand", "storeys": [storey]}


def test_plants_that_are_larger_and_more_have_more_triangles() -> None:
    assert 0 < 4 * estimated(planned(stand(top_m=8))) < estimated(planned(stand(top_m=30)))
    assert estimated(planned(stand(stems_per_ha=7))) < 0.2 * estimated(planned(stand()))  # one tree: no ten exemplars


def test_species_that_are_not_placed_have_none() -> None:
    beeches = estimated(planned(stand()))
    bare = {"model": "uniform", "plants": {}}
    assert estimated(planned(bare)) == 0
    planting = {"at_step": 0, "plant": {"species": "birch", "positions_m": [[3, 3]]}}
    assert 0 < estimated(planned({**bare, "disturbances": [planting]})) < beeches


@pytest.mark.parametrize("community", [stand(), {"model": "multiset_lsystem", "program": "succession"}])
def test_a_library_and_levels_of_detail_have_estimates(community: dict[str, Any]) -> None:
    once = estimated(planned(community))
    assert 0.3 * once < estimated(planned(community, library=4)) < 3.0 * once
    wide = [estimated(planned(community, 900, levels=levels)) for levels in (False, True)]
    assert wide[1] == pytest.approx(1.8 * wide[0])
    assert estimated(planned(community, 20, levels=True)) == pytest.approx(estimated(planned(community, 20)))


@pytest.mark.parametrize("name", slow_but(MEASURED, "fireweed"))
def test_the_triangles_of_a_species_are_those_of_its_file(name: str) -> None:
    """If not, run docs/species_triangles.py."""
    data = {"forestgen": 1, "site": {"size_m": [9, 9]}, "species": {name: None}, "community": {"model": "uniform"}}
    plan = make_plan(load_recipe_data(data, "test").draw(0))
    species, parameters = plan.drawn.species[name], plan.plants.generators[name]
    height_m, radius_m, trees = species.mature_height_m, species.ecology.max_radius_m, [None] * 3
    if species.tree is not None:
        sizes = species.tree.sizes(np.full(3, height_m), own_normals(5, np.arange(3, dtype=np.uint64)))
        trees = [tree_size(species, height_m, sizes, row) for row in range(3)]
    made = [
        build_exemplar(name, species, parameters, radius_m, child_rng(k, name), tree=one) for k, one in enumerate(trees)
    ]
    told = triangles_of(species, np.array([height_m]))[0]
    assert told == pytest.approx(np.mean([one.triangles for one in made]), rel=0.4)
