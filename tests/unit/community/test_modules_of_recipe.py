"""Branch modules in a whole recipe: resumed to the bit, exported, and refused where something does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from forestgen.community.history import write_history
from forestgen.community.history_files import check_graphs, write_graphs
from forestgen.community.resume import origin, snapshot_to_resume
from forestgen.community.simulation import final_population, snapshots
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.building import exemplar_of
from forestgen.scene.plan import Plan, check_plan
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
site: {size_m: [30, 30], buildings: [{kind: house, position_m: [15, 15], azimuth_deg: 30, size_m: [10, 8, 7]}]}
species: {spruce: }
community:
  model: branch_modules
  steps: 6
  initial_plants: {spruce: 5}
  temperature_c: 5
  precipitation_mm_per_yr: 800
  changes: [{at_yr: 2, set: {temperature_c: 9}}, {at_yr: 5, set: {species.spruce.shade_tolerance: 0.2}}]
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE)
    return path


def planned(path: Path, *overrides: str) -> Plan:
    return check_plan(load_recipe(path, overrides), simulate_only=True)


@pytest.mark.slow
def test_the_future_is_the_same_to_the_bit(recipe: Path, tmp_path: Path) -> None:
    plan = planned(recipe)
    whole = list(snapshots(plan.community, Silent()))
    for kept in (False, True):
        write_history(tmp_path / "history.parquet", whole, origin(plan.community), modules=kept)
        if not kept:
            with raises_error(RecipeError, place="resume"):
                snapshot_to_resume(plan.community, tmp_path / "history.parquet", 3)
    for step in (0, 2, 5):
        start = snapshot_to_resume(plan.community, tmp_path / "history.parquet", step)
        for before, after in zip(whole[step:], snapshots(plan.community, Silent(), start), strict=True):
            assert before.modules is not None
            assert after.modules is not None
            for mine, theirs in ((before, after), (before.modules, after.modules)):
                for name, values in vars(mine).items():
                    if isinstance(values, np.ndarray):
                        assert values.tobytes() == getattr(theirs, name).tobytes(), name
    later = planned(recipe, "community.changes.1.set={crowding: 2}")
    assert snapshot_to_resume(later.community, tmp_path / "history.parquet", 4).step == 4
    with raises_error(RecipeError, place="resume"):
        snapshot_to_resume(later.community, tmp_path / "history.parquet", 5)
    write_graphs(plan.community, whole[-1], [tmp_path / "graph.csv"])
    assert (tmp_path / "graph.csv").read_text().count("\n") > 20


def test_obstacles_are_the_first_plants_and_stand_as_they_are_told(recipe: Path) -> None:
    plan = planned(recipe, "community.steps=0", "community.initial_plants=0")
    population = plan.community.obstacles.turned(final_population(plan.community, Silent()))
    ((row, house),) = plan.community.obstacles.rows_of(population).items()
    assert population.columns["azimuth_deg"][row] == 30
    exemplar = exemplar_of(house, 6.4)
    assert exemplar.height_m == population.height_m[row] == 7
    np.testing.assert_allclose(exemplar.bounds_m()[1, :2], [5, 4])


@pytest.mark.parametrize(
    "overrides",
    [
        ("site.buildings.0.position_m=[5,5]",),
        ("site.buildings.0.kind=hause",),
        ("site.buildings.0.size_m=[0,3,3]",),
        ("site.buildings.0.chimneys=2",),
        ("community.initial_plants={house: 3}",),
        ("community.changes.1.set={species.house.opacity: 1}",),
        ("community.changes.0.set={temperature_c: 40}",),
        ("community.step_yr=0",),
        ("community.precipitation_mm_per_yr=5000",),
    ],
)
def test_what_does_not_fit_is_told_before_anything_grows(recipe: Path, overrides: tuple[str, ...]) -> None:
    with raises_error(RecipeError):
        planned(recipe, *overrides)


def test_terrain_with_holes_is_refused_with_its_line(recipe: Path, tmp_path: Path) -> None:
    heights = np.zeros((30, 30))
    np.save(tmp_path / "good.npy", heights)
    heights[3:5, 7] = np.nan
    np.save(tmp_path / "bad.npy", heights)
    np.save(tmp_path / "wide.npy", np.zeros((10, 30)))
    assert planned(recipe, "site.terrain={kind: map, map: good.npy}").community.site.height is not None
    with raises_error(AssetError, place="site.terrain.map"):
        planned(recipe, "site.terrain={kind: map, map: bad.npy}")
    with raises_error(AssetError, place="site.terrain.map"):
        planned(recipe, "site.terrain={kind: map, map: wide.npy}")
    planned(recipe, "site.terrain={kind: map, map: wide.npy, fit: stretch}")


def test_a_map_is_its_content_wherever_it_lies(recipe: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((30, 30)))
    np.save(tmp_path / "b.npy", np.zeros((30, 30)))
    plans = [planned(recipe, f"site.terrain={{kind: map, map: {name}.npy}}") for name in "ab"]
    assert origin(plans[0].community) == origin(plans[1].community)


def test_graphs_are_of_branches_and_of_known_formats(recipe: Path) -> None:
    plan = planned(recipe)
    check_graphs(plan.community, [Path("a.GLB"), Path("b.parquet")])
    with raises_error(RecipeError, place="graphs"):
        check_graphs(plan.community, [Path("a.ply")])
    plain = planned(recipe, "site.buildings=[]", "community={model: uniform, plants: {spruce: {count: 3}}}")
    with raises_error(RecipeError, place="graphs"):
        check_graphs(plain.community, [Path("a.glb")])
