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
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

EXAMPLE = Path(__file__).parents[3] / "examples" / "plugin" / "forestgen_plantation" / "__init__.py"
SITE = Site((30.0, 20.0))


def _plantation():
    spec = importlib.util.spec_from_file_location("forestgen_plantation", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.MODEL


PLANTATION = _plantation()


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
