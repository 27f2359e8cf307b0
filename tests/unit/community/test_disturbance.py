from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom, kstest

from forestgen.community.disturbance import Disturbance, Ground, planted
from forestgen.community.population import Population, Status
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

GROUND = Ground((40.0, 20.0), periodic=True)
BOUNDED = Ground((40.0, 20.0), periodic=False)


def stand(xy, radius_m=None, species=None, status=None) -> Population:
    n = len(xy)
    return Population(
        time_yr=1.0,
        species_names=("a", "b"),
        plant_id=np.arange(11, 11 + n, dtype=np.uint32),
        species=np.zeros(n, np.uint16) if species is None else np.array(species, np.uint16),
        position_m=np.concatenate([np.array(xy, float).reshape(n, 2), np.zeros((n, 1))], axis=1),
        radius_m=np.ones(n) if radius_m is None else np.array(radius_m, float),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.zeros(n, np.uint8) if status is None else np.array(status, np.uint8),
    )


def felled(population, ground=GROUND, **fell) -> list[int]:
    one = Disturbance(at_step=1, fell=fell)
    return one.affected_plants(population, ground, np.random.default_rng(1)).tolist()


XY = [(1, 1), (39, 19), (20, 10), (10, 5), (5, 10)]


@pytest.mark.parametrize(
    ("region", "inside"),
    [
        ({}, [11, 12, 13, 14, 15]),
        ({"circle": {"center_m": [0, 0], "radius_m": 2}}, [11, 12]),
        ({"circle": {"center_m": [20, 10], "radius_m": 100}}, [11, 12, 13, 14, 15]),
        ({"rectangle": {"min_m": [5, 5], "max_m": [20, 10]}}, [13, 14, 15]),
        ({"polygon": {"corners_m": [[2, 0], [11, 0], [11, 11]]}}, [14]),
        ({"polygon": {"corners_m": [[11, 11], [11, 0], [2, 0]]}}, [14]),
        (
            {"polygon": {"corners_m": [[0, 2], [40, 2], [40, 20], [30, 20], [30, 4], [8, 4], [8, 20], [0, 20]]}},
            [12, 15],
        ),
    ],
)
def test_regions(region, inside):
    assert felled(stand(XY), **region) == inside


def test_a_circle_ends_at_the_edge_of_a_bounded_site():
    assert felled(stand(XY), BOUNDED, circle={"center_m": [0, 0], "radius_m": 2}) == [11]


def test_only_those_of_a_species_and_size_that_live():
    population = stand(XY, [1, 2, 3, 4, 5], [0, 1, 0, 1, 1], [0, 1, 2, 0, Status.DEAD])
    assert felled(population) == [11, 12, 13, 14]
    assert felled(population, species=["b"]) == [12, 14]
    assert felled(population, min_radius_m=2, max_radius_m=3) == [12, 13]
    assert felled(population, species=["a"], min_radius_m=4) == []
    assert felled(population, species=[]) == []


def test_a_share_is_exact_and_random():
    population = stand(np.random.default_rng(0).random((1000, 2)))
    first, second = (
        Disturbance(at_step=1, fell={"share": 0.3}).affected_plants(population, GROUND, np.random.default_rng(k))
        for k in (1, 2)
    )
    assert len(first) == len(second) == 300
    assert np.all(np.diff(first.astype(int)) > 0)
    assert set(first) != set(second)
    assert felled(population, share=0) == []


@pytest.mark.parametrize("survival", [0.0, 0.1, 0.5, 1.0])
def test_a_fire_spares_each_plant_with_its_probability(survival):
    n = 20_000
    population = stand(np.ones((2 * n, 2)), species=np.arange(2 * n) % 2)
    burn = {"survival": survival, "survival_of": {"b": 0.7}}
    dead = Disturbance(at_step=1, burn=burn).affected_plants(population, GROUND, np.random.default_rng(3))
    for kind, probability in enumerate((survival, 0.7)):
        alive = n - np.count_nonzero((dead - 11) % 2 == kind)
        assert binom.ppf(1e-6, n, probability) <= alive <= binom.isf(1e-6, n, probability)
    only_a = {"species": ["a"], "survival": survival}
    dead = Disturbance(at_step=1, burn=only_a).affected_plants(population, GROUND, np.random.default_rng(3))
    assert np.all((dead - 11) % 2 == 0)


@pytest.mark.parametrize("ground", [GROUND, BOUNDED])
@pytest.mark.parametrize(
    ("region", "area_m2"),
    [
        ({}, 800.0),
        ({"circle": {"center_m": [0, 0], "radius_m": 6}}, np.pi * 36),
        ({"circle": {"center_m": [20, 10], "radius_m": 15}}, None),
        ({"rectangle": {"min_m": [30, 10], "max_m": [40, 20]}}, 100.0),
        ({"polygon": {"corners_m": [[0, 0], [20, 0], [0, 20]]}}, 200.0),
    ],
)
def test_random_places_are_uniform_in_the_region(tree, ground, region, area_m2):
    plant = Disturbance(at_step=0, plant={"species": "tree", "count": 4000, **region}).plant
    xy = plant.planting(ground, [tree()], np.random.default_rng(5)).position_m
    assert xy.shape == (4000, 2)
    assert np.all(plant.inside(xy, ground))
    assert np.all((xy >= 0) & (xy <= ground.size_m))
    # Against places of the whole site that happen to lie inside.
    others = np.random.default_rng(6).random((60_000, 2)) * ground.size_m
    others = others[plant.inside(others, ground)]
    for axis in (0, 1):
        assert kstest(xy[:, axis], others[:, axis]).pvalue > 1e-4
    if area_m2 and (ground.periodic or "circle" not in region):
        assert len(others) / 60_000 == pytest.approx(area_m2 / 800, rel=0.05)


def test_planted_plants(tree):
    species = [tree(), tree(name="b", max_radius_m=1.5)]
    plant = Disturbance(at_step=0, plant={"species": "b", "positions_m": [[1, 2], [3, 4]], "vigour": 100}).plant
    made = plant.planting(GROUND, species, np.random.default_rng(1))
    assert made.species.tolist() == [1, 1]
    assert made.position_m.tolist() == [[1, 2], [3, 4]]
    assert made.radius_m.tolist() == [0.1, 0.1]
    assert made.columns["vigour"].tolist() == [100, 100]
    large = Disturbance(at_step=0, plant={"species": "b", "count": 5, "radius_m": 1.5})
    assert large.plant.planting(GROUND, species, np.random.default_rng(1)).radius_m.tolist() == [1.5] * 5
    assert planted([large, large, Disturbance(at_step=0, fell={})]) == 10


def test_a_sliver_has_no_room_and_says_so(tree, monkeypatch):
    monkeypatch.setattr("forestgen.community.disturbance._MOST_DRAWS", 1000)
    sliver = {"polygon": {"corners_m": [[0, 0], [40, 20], [40, 19.9999]]}}
    plant = Disturbance(at_step=0, plant={"species": "tree", "count": 50, **sliver}).plant
    with raises_error(RecipeError):
        plant.planting(GROUND, [tree()], np.random.default_rng(1))


@pytest.mark.parametrize(
    ("when", "step_yr", "step"),
    [
        ({"at_step": 7}, 0.5, 7),
        ({"at_yr": 0}, 0.5, 0),
        ({"at_yr": 3}, 0.5, 6),
        ({"at_yr": 3.1}, 0.5, 7),
        ({"at_yr": 0.3}, 0.1, 3),  # 0.3 / 0.1 is 2.9999999999999996
        ({"at_yr": 0.7}, 0.1, 7),  # 0.7 / 0.1 is 6.999999999999999
        ({"at_yr": 1.1}, 0.1, 11),  # 1.1 / 0.1 is 11.000000000000002
    ],
)
def test_the_step_that_reaches_its_time(when, step_yr, step):
    assert Disturbance(**when, fell={}).step(step_yr) == step


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"fell": {}}, "either at_yr or at_step"),
        ({"at_yr": 1, "at_step": 2, "fell": {}}, "either at_yr or at_step"),
        ({"at_step": 2}, "one of fell, burn, plant"),
        ({"at_step": 2, "fell": {}, "burn": {}}, "one of fell, burn, plant"),
        ({"at_step": -1, "fell": {}}, "greater than or equal"),
        ({"at_step": 1, "fell": {"share": 1.1}}, "less than or equal"),
        ({"at_step": 1, "fell": {"survival": 0.5}}, "Extra"),
        ({"at_step": 1, "plant": {"species": "a"}}, "either positions_m or count"),
        ({"at_step": 1, "plant": {"species": "a", "count": 1, "positions_m": []}}, "either positions_m or count"),
        ({"at_step": 1, "plant": {"species": "a", "count": 0}}, "greater than or equal"),
        ({"at_step": 1, "plant": {"species": "a", "positions_m": [[1, 1]],
                                  "circle": {"center_m": [1, 1], "radius_m": 1}}}, "with count only"),
        ({"at_step": 1, "fell": {"circle": {"center_m": [1, 1], "radius_m": 1},
                                 "rectangle": {"min_m": [0, 0], "max_m": [1, 1]}}}, "at most one"),
        ({"at_step": 1, "fell": {"rectangle": {"min_m": [1, 0], "max_m": [1, 1]}}}, "north-east"),
        ({"at_step": 1, "fell": {"polygon": {"corners_m": [[0, 0], [1, 1], [2, 2]]}}}, "around an area"),
        ({"at_step": 1, "fell": {"polygon": {"corners_m": [[0, 0], [0, 1]]}}}, "at least 3"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(ValidationError, match=message):
        Disturbance.model_validate(wrong)


def test_an_empty_site_can_be_felled_and_burnt():
    nobody = stand(np.empty((0, 2)))
    assert felled(nobody, share=0.5) == []
    assert (
        len(Disturbance(at_step=1, burn={"survival": 0.5}).affected_plants(nobody, GROUND, np.random.default_rng(1)))
        == 0
    )


def test_sizes_that_no_plant_can_have_are_refused():
    with pytest.raises(ValidationError, match="at least min_radius_m = 3"):
        Disturbance(at_step=1, burn={"min_radius_m": 3, "max_radius_m": 1})
