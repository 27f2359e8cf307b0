"""The base class of models that place plants once, by the model of examples/plugin."""

from __future__ import annotations

import importlib.util
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.community.disturbance import Planting
from forestgen.community.history import open_history, write_history
from forestgen.community.model import simulate
from forestgen.community.population import Site, Status
from forestgen.community.snapshot_checks import check_snapshot
from forestgen.community.static_model import Change, GrowingModel, Placement, StaticModel, StaticParameters
from forestgen.community.tree_columns import with_tree_sizes
from forestgen.core.dead_wood import UNKNOWN_CLASS, DeadForm
from forestgen.core.errors import RecipeError
from forestgen.recipe.tree_sizes import TreeSizes
from support.error_messages import raises_error

EXAMPLE = Path(__file__).parents[3] / "examples" / "plugin" / "forestgen_plantation" / "__init__.py"
SITE = Site((30.0, 20.0))


def _plantation():
    spec = importlib.util.spec_from_file_location("forestgen_plantation", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.MODEL


PLANTATION = _plantation()
SIZES = TreeSizes(
    tallest_m=30,
    dbh_m={"at_10_m": 0.1, "height_exponent": 1.0},
    crown_width_m={"at_10_m": 3.0},
    crown_ratio={"at_10_m": 1.0},
    leaf_kg={"at_10_m": 3.0},
)


@pytest.fixture
def species(tree):
    return [tree(max_radius_m=1.5), tree(name="b", max_radius_m=1.0)]


class Given(StaticModel[StaticParameters]):
    """Places what a test gives it."""

    Parameters = StaticParameters

    def __init__(self, placement):
        self.placement = placement

    def place(self, parameters, site, species, rng):
        return self.placement

    def most_plants(self, parameters, site, species):
        return float(len(self.placement.species))


def placed(kind=0, position_m=(1.0, 1.0), radius_m=0.5, height_m=None):
    heights = None if height_m is None else np.array([height_m])
    return Placement(np.array([kind]), np.array([position_m]), np.array([radius_m]), heights)


def test_the_example_is_as_short_as_its_page_says():
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) < 60


def test_rows_without_displacement_are_where_the_keys_say(species):
    parameters = PLANTATION.Parameters(row_m=10, tree_m=5, displacement_m=0, failed=0, smallest=1, largest=1)
    plants = PLANTATION.population(PLANTATION.init(parameters, SITE, species, 1))
    assert plants.position_m[:, 0].tolist() == [5.0] * 4 + [15.0] * 4 + [25.0] * 4
    assert plants.position_m[:4, 1].tolist() == [2.5, 7.5, 12.5, 17.5]
    assert plants.species.tolist() == [0] * 4 + [1] * 4 + [0] * 4
    assert set(plants.status) == {Status.MATURE}
    assert plants.height_m == pytest.approx(
        [species[kind].height_scale * plants.radius_m[i] ** species[kind].height_exponent
         for i, kind in enumerate(plants.species)]
    )  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1])
def test_a_seed_makes_one_stand_on_the_site(species, seed):
    first, again = (PLANTATION.init(PLANTATION.Parameters(), SITE, species, seed).plants for _ in range(2))
    other = PLANTATION.init(PLANTATION.Parameters(), SITE, species, seed - 1 if seed else 5).plants
    assert np.array_equal(first.x_m, again.x_m)
    assert not np.array_equal(first.x_m[:5], other.x_m[:5])
    assert np.all((first.x_m >= 0) & (first.x_m <= SITE.size_m))


def test_no_more_plants_than_expected(species):
    parameters = PLANTATION.Parameters(disturbances=({"at_step": 0, "plant": {"species": "b", "count": 7}},))
    numbers = [len(next(simulate(PLANTATION, parameters, SITE, species, k, steps=0))) for k in range(20)]
    assert np.mean(numbers) <= PLANTATION.expected_plants(parameters, SITE, species)
    assert PLANTATION.empty_reason(parameters, SITE, species) is None
    assert PLANTATION.empty_reason(PLANTATION.Parameters(failed=1), SITE, species) == "the model places no plant"
    assert PLANTATION.estimate_bytes(parameters, SITE, species) > 400 * max(numbers)


def test_a_stored_snapshot_resumes_to_the_same_future(species, tmp_path):
    felling = {"at_step": 3, "fell": {"share": 0.5}}
    parameters = PLANTATION.Parameters(steps=6, disturbances=(felling,))
    whole = list(simulate(PLANTATION, parameters, SITE, species, 4, steps=6))
    write_history(tmp_path / "a.parquet", whole)
    start = open_history(tmp_path / "a.parquet").snapshot(2)
    check_snapshot(start, SITE, species)
    PLANTATION.check_snapshot(parameters, SITE, species, start)
    again = list(simulate(PLANTATION, parameters, SITE, species, 4, steps=6, start=start))
    for one, other in zip(again, whole[2:], strict=True):
        assert np.array_equal(one.plant_id, other.plant_id)
        assert np.array_equal(one.position_m, other.position_m)
        assert np.array_equal(one.age_yr, other.age_yr)
    assert len(whole[-1]) < len(whole[0])


def test_planting_and_removing(species):
    state = PLANTATION.init(PLANTATION.Parameters(), SITE, species, 4)
    n = len(state.plants)
    planted = PLANTATION.plant(state, Planting(np.array([1], np.uint16), np.array([[2.0, 3.0]]), np.array([0.7])))
    assert PLANTATION.population(planted).plant_id[-1] == n + 1
    assert len(PLANTATION.population(PLANTATION.remove(planted, np.arange(1, n + 1, dtype=np.uint32)))) == 1


def test_given_heights_are_kept(species):
    model = Given(placed(height_m=3.25))
    assert model.population(model.init(StaticParameters(), SITE, species, 0)).height_m.tolist() == [3.25]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": 2},
        {"position_m": (31.0, 1.0)},
        {"position_m": (np.nan, 1.0)},
        {"radius_m": 1.6},
        {"radius_m": 0.0},
        {"height_m": -1.0},
    ],
)
def test_plants_that_no_later_stage_can_use_are_refused(species, wrong):
    with raises_error(RecipeError):
        Given(placed(**wrong)).init(StaticParameters(), SITE, species, 0)


def test_what_is_no_placement_and_keys_that_no_snapshot_may_have_are_refused(species):
    for model in (
        Given(None),
        Given(replace(placed(), found={"mean_m": 2.0})),
    ):
        with raises_error(RecipeError):
            model.init(StaticParameters(), SITE, species, 0)


def test_columns_of_different_lengths_are_refused():
    with raises_error(RecipeError):
        Placement(np.array([0]), np.zeros((2, 2)), np.ones(1))


def test_a_placement_without_plants_is_one(species):
    model = Given(Placement(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0)))
    assert len(model.population(model.init(StaticParameters(), SITE, species, 0))) == 0


class Knowing(Given):
    """As `Given`, with sizes of trees."""

    knows_trees = True


@pytest.fixture
def trees(tree):
    """Two species, of which the first has allometries."""
    return [tree(max_radius_m=1.5, tree=SIZES), tree(name="b", max_radius_m=1.0)]


def test_sizes_of_trees_and_dead_trees_are_in_the_snapshot(trees):
    one = replace(
        placed(height_m=9.0),
        tree_sizes={"dbh_m": np.array([0.2]), "crown_base_m": np.array([3])},
        dead=np.array([True]),
        age_yr=np.array([40]),
        azimuth_deg=np.array([15.0]),
    )
    model = Knowing(one)
    found = model.population(model.init(StaticParameters(), SITE, trees, 0))
    assert {name: values[0] for name, values in found.columns.items() if not np.isnan(values[0])} == {
        "dead_form": DeadForm.STANDING,
        "decay_class": UNKNOWN_CLASS,
        "azimuth_deg": 15.0, "first_age_yr": 40.0, "first_step": 0, "dbh_m": 0.2, "crown_base_m": 3.0
    }  # fmt: skip
    assert (found.status[0], found.age_yr[0]) == (Status.DEAD, 40)


WRONG_TREES = {
    "a size of no tree": {"species": np.array([1]), "tree_sizes": {"dbh_m": np.array([0.2])}},
    "no such size": {"tree_sizes": {"dbh_cm": np.array([20.0])}},
    "a negative diameter": {"tree_sizes": {"dbh_m": np.array([-0.2])}},
    "an infinite crown": {"tree_sizes": {"crown_radius_m": np.array([np.inf])}},
    "a crown above the tree": {"height_m": np.array([9.0]), "tree_sizes": {"crown_base_m": np.array([9.5])}},
    "negative leaves": {"tree_sizes": {"leaf_area_m2": np.array([-1.0])}},
    "text": {"tree_sizes": {"leaf_area_m2": np.array(["much"])}},
    "perhaps dead": {"dead": np.array([0.5])},
    "a negative age": {"age_yr": np.array([-1.0])},
    "an unknown age": {"age_yr": np.array([np.nan])},
    "an infinite turn": {"azimuth_deg": np.array([np.inf])},
}


@pytest.mark.parametrize("name", WRONG_TREES)
def test_trees_that_no_later_stage_can_use_are_refused(trees, name):
    with raises_error(RecipeError):
        Knowing(replace(placed(), **WRONG_TREES[name])).init(StaticParameters(), SITE, trees, 0)


@pytest.mark.parametrize("given", [{"tree_sizes": {"dbh_m": np.array([0.2])}}, {"dead": np.array([True])}])
def test_a_model_that_does_not_say_that_it_knows_trees_loses_no_sizes_of_them(trees, given):
    with raises_error(RecipeError):
        Given(replace(placed(), **given)).init(StaticParameters(), SITE, trees, 0)


@pytest.mark.parametrize("given", [{"tree_sizes": {"dbh_m": np.ones(2)}}, {"dead": np.zeros((1, 1), bool)}])
def test_sizes_of_other_lengths_are_refused(given):
    with raises_error(RecipeError):
        replace(placed(), **given)


class Grove(GrowingModel[StaticParameters]):
    """Ten plants; each year they widen by 0.1 m, one in five dies, and three come up. A height is given to the new."""

    Parameters = StaticParameters

    def place(self, parameters, site, species, rng):
        return Placement(np.arange(10) % 2, rng.random((10, 2)) * site.size_m, np.full(10, 0.2))

    def most_plants(self, parameters, site, species):
        return 10 + 3 * parameters.steps

    def change(self, parameters, site, species, population, rng):
        radius_m = np.minimum(population.radius_m + 0.1, 1.0)
        new = Placement(np.zeros(3, int), rng.random((3, 2)) * site.size_m, np.full(3, 0.1), np.full(3, 0.7))
        return Change(rng.random(len(population)) < 0.2, radius_m, arrivals=new)


def test_plants_grow_arrive_and_die(species):
    history = list(simulate(Grove(), StaticParameters(steps=30), SITE, species, 4, steps=30))
    for before, after in itertools.pairwise(history):
        lived, at, was = np.intersect1d(after.plant_id, before.plant_id, return_indices=True)
        assert after.radius_m[at] == pytest.approx(np.minimum(before.radius_m[was] + 0.1, 1))
        assert np.array_equal(after.age_yr[at], before.age_yr[was] + 1)
        assert after.height_m[at] == pytest.approx(
            [species[kind].height_scale * r ** species[kind].height_exponent
             for kind, r in zip(after.species[at], after.radius_m[at], strict=True)]
        )  # fmt: skip
        new = ~np.isin(after.plant_id, before.plant_id)
        assert new.sum() == 3
        assert np.all(after.plant_id[new] > before.plant_id.max(initial=0))
        assert set(after.height_m[new]) == {0.7}
        assert set(after.age_yr[new]) == {0.0}
        assert len(lived) <= len(before)
    # Births 3 a year and deaths 1 in 5: 12 to 15 plants in balance, with a standard deviation of some 3.
    assert 8 < np.mean([len(one) for one in history[10:]]) < 20


def test_a_growing_stand_resumes_to_the_same_future(species, tmp_path):
    parameters = StaticParameters(steps=6, disturbances=({"at_step": 3, "fell": {"share": 0.5}},))
    whole = list(simulate(Grove(), parameters, SITE, species, 4, steps=6))
    write_history(tmp_path / "a.parquet", whole)
    start = open_history(tmp_path / "a.parquet").snapshot(2)
    Grove().check_snapshot(parameters, SITE, species, start)
    again = list(simulate(Grove(), parameters, SITE, species, 4, steps=6, start=start))
    for one, other in zip(again, whole[2:], strict=True):
        for name in ("plant_id", "species", "position_m", "radius_m", "height_m", "age_yr", "status"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name


@pytest.mark.parametrize(
    "change",
    [
        None,
        Change(dead=np.zeros(9, bool)),
        Change(radius_m=np.full(10, 2.0)),
        Change(height_m=np.zeros(10)),
        Change(arrivals=placed(kind=5)),
    ],
)
def test_changes_that_no_later_stage_can_use_are_refused(species, change):
    class Wrong(Grove):
        def change(self, parameters, site, species, population, rng):
            return change

    with raises_error(RecipeError):
        list(simulate(Wrong(), StaticParameters(), SITE, species, 4, steps=1))


class Measured(Grove):
    """Trees 1 m taller each year, whose crowns it leaves to the allometry; each year a dead one arrives."""

    knows_trees = True

    def place(self, parameters, site, species, rng):
        sizes = {"dbh_m": np.full(10, 0.1), "crown_radius_m": np.full(10, 2.0)}
        return replace(super().place(parameters, site, species, rng), height_m=np.full(10, 8.0), tree_sizes=sizes)

    def change(self, parameters, site, species, population, rng):
        dead = population.status == Status.DEAD
        height_m = np.where(dead, population.height_m, population.height_m + 1.0)
        new = replace(
            placed(height_m=4.0),
            tree_sizes={"crown_radius_m": np.ones(1)},
            dead=np.array([True]),
            age_yr=np.array([30.0]),
            azimuth_deg=np.array([90.0]),
        )
        return Change(height_m=height_m, arrivals=new, tree_sizes={"dbh_m": population.columns["dbh_m"] * 1.1})


def test_sizes_follow_the_change_or_the_height_and_arrivals_keep_theirs(tree, tmp_path):
    both = [tree(tree=SIZES), tree(name="b", tree=SIZES)]
    history = list(simulate(Measured(), StaticParameters(steps=3), SITE, both, 4, steps=3))
    last = history[-1].columns
    assert last["dbh_m"][:10] == pytest.approx(np.full(10, 0.1331))
    assert np.isnan(last["crown_radius_m"][:10]).all()  # of the new height now
    assert last["crown_radius_m"][10:].tolist() == [1, 1, 1]  # these did not grow
    whole = with_tree_sizes(history[-1], both, SITE, 4, periodic=True)
    assert (whole.columns["leaf_area_m2"] > 0).tolist() == [True] * 10 + [False] * 3
    assert last["azimuth_deg"][10:].tolist() == [90, 90, 90]
    assert history[-1].age_yr[10:].tolist() == [32, 31, 30]
    assert (history[-1].status == Status.DEAD).tolist() == [False] * 10 + [True] * 3
    write_history(tmp_path / "a.parquet", history)
    start = open_history(tmp_path / "a.parquet").snapshot(1)
    Measured().check_snapshot(StaticParameters(steps=3), SITE, both, start)
    again = list(simulate(Measured(), StaticParameters(steps=3), SITE, both, 4, steps=3, start=start))
    for name, values in last.items():
        assert np.array_equal(again[-1].columns[name], values, equal_nan=True)


@pytest.mark.parametrize("sizes", [{"dbh_m": np.ones(9)}, {"dbh_m": np.zeros(10)}, {"girth_m": np.ones(10)}])
def test_changes_of_sizes_that_no_later_stage_can_use_are_refused(tree, sizes):
    class Wrong(Measured):
        def change(self, parameters, site, species, population, rng):
            return Change(tree_sizes=sizes)

    with raises_error(RecipeError):
        list(simulate(Wrong(), StaticParameters(), SITE, [tree(tree=SIZES), tree(name="b", tree=SIZES)], 4, steps=1))
