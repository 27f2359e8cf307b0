"""What a forest of branch modules cannot do is refused where the recipe says it, before anything is simulated."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.architecture.geometry import skeletal_graph
from forestgen.architecture.graph_files import write_graph
from forestgen.architecture.prototypes import load_prototypes, tables_of
from forestgen.community.branch_modules.state import MOST_SEEDS, STAND_IN, no_modules, refuse_more_seeds
from forestgen.community.history_files import check_graphs
from forestgen.community.model import simulate
from forestgen.community.simulation import snapshots
from forestgen.core.errors import AssetError, OutputError, RecipeError, ResourceError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene import plan as plan_module
from forestgen.scene.plan import check_plan
from support.error_messages import raises_error

STAND = """
forestgen: 1
site: {size_m: [12, 12], buildings: [{kind: house, position_m: [6, 6], size_m: [2, 2, 2]}]}
species: {pine: }
community:
  model: branch_modules
  initial_plants: 8
  steps: 4
cameras: [{position_m: [0, -10, 2]}]
"""


def plan_of(tmp_path, *settings):
    (tmp_path / "stand.yaml").write_text(STAND)
    return check_plan(load_recipe(tmp_path / "stand.yaml", settings), simulate_only=True)


@pytest.mark.parametrize(
    ("setting", "place"),
    [
        (
            "community.changes=[{at_yr: 1, set: {species.pine.prototypes: [nonesuch]}}]",
            "changes.0.set.species.pine.prototypes",
        ),
        ("community.disturbances=[{at_yr: 1, plant: {species: house, count: 2}}]", "disturbances.0.plant.species"),
        ("community.initial_plants={'*': 5, pine: 2}", "initial_plants"),
    ],
)
def test_what_nobody_can_grow_is_told_at_its_place(tmp_path, setting, place):
    with raises_error(RecipeError, place=place):
        plan_of(tmp_path, setting)


CLIMATE = ", climate: {place: Juneau}"


@pytest.mark.parametrize("model", ["branch_modules", "ecoclimate"])
@pytest.mark.parametrize("name", ["snag", "stump", "log"])
def test_dead_wood_does_not_grow(tmp_path, model, name):
    with raises_error(RecipeError, place=f"species.{name}"):
        plan_of(
            tmp_path,
            f"species={{pine: , {name}: }}",
            f"community={{model: {model}, initial_plants: 8, steps: 4{CLIMATE * (model == 'ecoclimate')}}}",
        )


@pytest.mark.parametrize("model", ["branch_modules", "ecoclimate"])
def test_a_species_of_ones_own_needs_modules(tmp_path, model):
    with raises_error(RecipeError, place="species.mine"):
        plan_of(
            tmp_path,
            "species={pine: , mine: {from: fireweed, modules: null}}",
            f"community={{model: {model}, initial_plants: 8, steps: 4{CLIMATE * (model == 'ecoclimate')}}}",
        )


@pytest.mark.parametrize("model", ["branch_modules", "ecoclimate"])
def test_obstacles_of_older_recipes_are_told_their_new_key(tmp_path, model):
    with raises_error(RecipeError, place="community.obstacles"):
        plan_of(
            tmp_path,
            f"community={{model: {model}, steps: 4, obstacles: [{{species: house, position_m: [6, 6]}}]"
            f"{CLIMATE * (model == 'ecoclimate')}}}",
        )


def test_a_house_among_the_species_is_told_its_new_key(tmp_path):
    with raises_error(AssetError, place="species.house.from"):
        plan_of(tmp_path, "species={pine: , house: }", "site.buildings=[]")


def test_a_species_has_another_name_than_a_building(tmp_path):
    with raises_error(RecipeError, place="species.house"):
        plan_of(tmp_path, "species={house: {from: pine}}")


def test_buildings_need_a_community_that_knows_of_them(tmp_path):
    with raises_error(RecipeError, place="site.buildings"):
        plan_of(tmp_path, "community={model: uniform, plants: {pine: {count: 3}}}")


def test_seeds_from_elsewhere_of_a_stranger_are_refused_in_a_change_too(tmp_path):
    with raises_error(RecipeError, place="community.changes.0.set.global_seeding"):
        plan_of(
            tmp_path,
            "community={model: ecoclimate, initial_plants: 8, steps: 4, climate: {place: Juneau}, "
            "changes: [{at_yr: 1, set: {global_seeding: [{species: [house], seeds_per_ha: 1000}]}}]}",
        )


def test_a_graph_that_cannot_be_written_is_refused_before_anything_grows(tmp_path):
    plan = plan_of(tmp_path)
    for path, what in ((tmp_path / "no" / "x.glb", "no such folder"), (tmp_path / "x.glb", "a folder")):
        if what == "a folder":
            path.mkdir()
        with pytest.raises(OutputError) as told:
            check_graphs(plan.community, [path])
        assert told.value.got == what
    check_graphs(plan.community, [tmp_path / "y.glb"])


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".csv", ".parquet"])
def test_the_graph_of_a_stand_without_plants_is_an_empty_file(tmp_path, suffix):
    tables = tables_of(load_prototypes(), [STAND_IN])
    graph = skeletal_graph(tables, no_modules(), np.empty(0, np.uint16), np.empty(0, np.int64))
    write_graph(tmp_path / f"x{suffix}", graph, foot_m=np.empty((0, 3)), columns={})
    assert (tmp_path / f"x{suffix}").exists()


def test_more_plants_than_modules_may_be_are_refused_at_the_start(tmp_path):
    with raises_error(ResourceError, place="community.most_modules"):
        list(snapshots(plan_of(tmp_path, "community.most_modules=1").community, Silent()))


def test_more_seeds_than_memory_holds_are_refused():
    refuse_more_seeds(MOST_SEEDS)
    with raises_error(ResourceError, place="community.step_yr"):
        refuse_more_seeds(4e8)


def test_more_planted_than_modules_may_be_are_refused_before_they_are_drawn(tmp_path):
    planting = "{at_step: %d, plant: {species: pine, count: %d}}"
    with pytest.raises(ResourceError) as told:
        plan_of(tmp_path, f"community.disturbances=[{planting % (1, 10**8)}]")
    assert "community.disturbances.0.plant.count" in str(told.value.where)
    assert told.value.got == "100,000,000"
    plan = plan_of(tmp_path, f"community.disturbances=[{planting % (1, 60)}, {planting % (1, 60)}]",
                   "community.most_modules=110")  # fmt: skip
    with raises_error(ResourceError, place="community.most_modules"):  # in the step itself, and not one later
        list(model_simulate(plan, 1))


def model_simulate(plan, steps):
    return simulate(
        plan.community.model, plan.community.parameters, plan.community.site, plan.community.ecologies, 1, steps=steps
    )


@pytest.mark.parametrize("model", ["branch_modules", "ecoclimate"])
def test_a_finer_grid_of_a_change_is_foreseen(tmp_path, model):
    climate = ", climate: {place: Juneau}, soil_water: {cell_m: 50}" * (model == "ecoclimate")
    community = f"{{model: {model}, initial_plants: 8, steps: 4, most_modules: 999{climate}, cell_m: %g, changes: %s}}"
    sizes = ("site.size_m=[1000,1000]", "species={pine: }")

    def estimate(cell_m, changes="[]"):
        plan = plan_of(tmp_path, *sizes, "community=" + community % (cell_m, changes))
        return plan.community.model.estimate_bytes(
            plan.community.parameters, plan.community.site, plan.community.ecologies
        )

    assert estimate(0.25) > estimate(50) + 1e9
    assert estimate(50, "[{at_yr: 1, set: {cell_m: 0.25}}, {at_yr: 2, set: {cell_m: 9}}]") == estimate(0.25)


def test_seeds_from_elsewhere_of_a_change_are_foreseen(tmp_path, monkeypatch):
    monkeypatch.setattr(plan_module, "free_bytes", lambda: 64 * 10**9)  # whatever else runs on this machine
    community = (
        "{model: ecoclimate, initial_plants: 8, steps: 4, step_yr: 1, climate: {place: Juneau}, "
        "soil_water: {cell_m: 20}, changes: [{at_yr: 1, set: {global_seeding: [{seeds_per_ha: %d}]}}]}"
    )
    sizes = ("site.size_m=[2000,2000]", "species={pine: }")
    plan = plan_of(tmp_path, *sizes, "community=" + community % 10)
    assert (
        plan.community.model.empty_reason(plan.community.parameters, plan.community.site, plan.community.ecologies)
        is None
    )
    with raises_error(ResourceError, place="community.changes.0.set.global_seeding"):
        plan_of(tmp_path, *sizes, "community=" + community % 100_000)
