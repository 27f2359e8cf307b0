"""A community in time as numbers."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forestgen.community.population import Population, Site, Status
from forestgen.community.trajectory import (
    ALL,
    Trajectory,
    describe_step,
    describe_thinning,
    moment,
    thinning_slope,
)

SITE = Site((100.0, 50.0))


def stand(points, radius_m, step=0, species=None, status=None, names=("a", "b"), **columns):
    n = len(points)
    return Population(
        time_yr=0.5 * step,
        species_names=names,
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.zeros(n, np.uint16) if species is None else np.array(species, np.uint16),
        position_m=np.concatenate([np.reshape(points, (n, 2)), np.zeros((n, 1))], axis=1),
        radius_m=np.broadcast_to(np.asarray(radius_m, float), n).copy(),
        height_m=np.ones(n),
        age_yr=np.full(n, 0.5 * step),
        status=np.zeros(n, np.uint8) if status is None else np.array(status, np.uint8),
        columns=columns,
        step=step,
    )


def self_thinning(steps=60, plants=4000):
    """Plants of one sowing grow alike; of two that touch, the smaller one dies (Lane 2002, section 4.3)."""
    rng = np.random.default_rng(0)
    points, first = rng.random((plants, 2)) * SITE.size_m, rng.uniform(0.05, 0.1, plants)
    alive = np.arange(plants)
    for step in range(steps):
        radius = first + 0.05 * step
        tree = cKDTree(points[alive], boxsize=SITE.size_m)
        pairs = alive[tree.query_pairs(2 * float(radius.max()), output_type="ndarray")]
        apart = np.abs(points[pairs[:, 0]] - points[pairs[:, 1]])
        apart = np.hypot(*np.minimum(apart, np.array(SITE.size_m) - apart).T)
        touching = pairs[apart < radius[pairs].sum(axis=1)]
        smaller = np.where(first[touching[:, 0]] < first[touching[:, 1]], touching[:, 0], touching[:, 1])
        alive = np.setdiff1d(alive, smaller)
        yield stand(points[alive], radius[alive], step)


@pytest.fixture(scope="module")
def thinning():
    return Trajectory.of([moment(one, SITE) for one in self_thinning()], ("a", "b"), SITE, "m³")


def test_a_stand_that_thins_itself_follows_the_line(thinning):
    assert thinning.is_even_aged()
    slope = thinning_slope(thinning)
    assert slope.value == pytest.approx(-1.5, abs=0.1)
    assert thinning.density_per_ha[slope.first] <= thinning.density_per_ha[0] / 3
    told = describe_thinning(thinning, slope)
    assert told["slope_log_mean_mass_on_log_density"]["value"] == slope.value
    # Equal circles: mass ~ d³ and mass ~ N^slope, so N ~ d^(3 / slope).
    assert told["slope_log_density_on_log_diameter"]["value"] == pytest.approx(3 / slope.value, rel=0.01)
    assert told["from_time_yr"] == 0.5 * slope.first
    assert told["to_time_yr"] == 0.5 * slope.last
    json.dumps(told, allow_nan=False)


def test_a_stand_that_gains_plants_has_no_line():
    populations = list(self_thinning())
    newcomers = Trajectory.of([moment(one, SITE) for one in [*populations, populations[0]]], ("a", "b"), SITE, "m³")
    assert not newcomers.is_even_aged()
    assert thinning_slope(newcomers) is None


def test_moments_count_the_living():
    points = np.random.default_rng(0).random((4, 2))
    status = [Status.GROWING, Status.DEAD, Status.DOMINATED, Status.MATURE]
    one = moment(stand(points, [1.0, 5.0, 2.0, 3.0], 7, [0, 0, 0, 1], status), SITE)
    assert (one.step, one.time_yr) == (7, 3.5)
    assert one.counts.tolist() == [2, 1]
    assert one.mass_sum.tolist() == [9.0, 27.0]
    assert one.square_sum_m2.tolist() == [5.0, 9.0]
    assert one.cover == pytest.approx(np.pi * np.array([1, 9]) / 5000)


def test_a_models_own_mass_is_taken():
    points = np.random.default_rng(0).random((10, 2)) * 50
    heavy = stand(points, 1.0, mass_kg=np.arange(1.0, 11.0))
    assert moment(heavy, SITE).mass_sum.tolist() == [55.0, 0.0]
    assert describe_step(heavy, SITE, 0)["mean_mass"] == 5.5


def test_trajectories_have_means_where_there_are_plants():
    some, none = stand(np.ones((2, 2)), [1.0, 3.0]), stand(np.empty((0, 2)), [], step=1)
    both = Trajectory.of([moment(some, SITE), moment(none, SITE)], ("a", "b"), SITE, "m³")
    assert both.density_per_ha.tolist() == [4.0, 0.0]
    assert both.mean_mass[0] == 14.0
    assert both.quadratic_mean_diameter_m[0] == pytest.approx(2 * math.sqrt(5))
    assert np.isnan(both.mean_mass[1])
    assert np.isnan(both.quadratic_mean_diameter_m[1])
    with pytest.raises(ValueError, match="at least one"):
        Trajectory.of([], ("a",), SITE, "m³")


def test_a_step_is_told_in_full_and_alike_each_time():
    rng = np.random.default_rng(1)
    clustered = np.mod(
        np.repeat(rng.random((10, 2)), 20, axis=0) * SITE.size_m + rng.normal(0, 1, (200, 2)), SITE.size_m
    )
    points = np.concatenate([clustered, rng.random((200, 2)) * SITE.size_m])
    population = stand(points, rng.lognormal(0, 0.3, 400), 4, np.repeat([0, 1], 200))
    told = describe_step(population, SITE, 5)
    assert told == describe_step(population, SITE, 5)
    assert told["hopkins"] != describe_step(population, SITE, 6)["hopkins"]
    assert (told["step"], told["time_yr"], told["n"], told["density_per_m2"]) == (4, 2.0, 400, 0.08)
    assert told["shares"] == {"a": 0.5, "b": 0.5}
    high = np.count_nonzero(population.height_m > 1.3)
    assert sum(told["stems_over_1_3_m"].values()) == high
    assert sum(told["stems_over_1_3_m_per_ha"].values()) == pytest.approx(high / SITE.area_m2 * 1e4)
    h = told["hopkins"]
    assert set(h) == {ALL, "a", "b"}
    assert h["a"]["value"] - 1 > 3 * h["a"]["error"]
    assert abs(h["b"]["value"] - 1) < 4 * h["b"]["error"]
    assert told["clark_evans_donnelly"]["a"]["value"] < 0.6
    fit = told["mass_log_normal"]["b"]
    assert fit["sigma"] == pytest.approx(0.9, rel=0.2)
    assert fit["p_value"] > 0.001
    json.dumps(told, allow_nan=False)


@pytest.mark.parametrize("n", [0, 1, 2, 9])
def test_few_plants_are_no_error(n):
    points = np.random.default_rng(0).random((n, 2)) * SITE.size_m
    told = describe_step(stand(points, 1.0), SITE, 0)
    assert told["n"] == n
    assert (told["hopkins"][ALL] is None) == (n < 2)
    assert told["hopkins"]["b"] is None
    assert told["mass_log_normal"][ALL] is None
    json.dumps(told, allow_nan=False)


def test_plants_at_one_place_and_beyond_the_edge_are_no_error():
    points = np.array([[5.0, 5.0], [5.0, 5.0], [5.0, 5.0], [-1.0, 60.0]] * 4)
    told = describe_step(stand(points, 1.0), SITE, 0)
    assert told["hopkins"][ALL] == {"value": None, "error": None}
    json.dumps(told, allow_nan=False)
