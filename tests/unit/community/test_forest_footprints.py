from __future__ import annotations

import dataclasses
import pickle
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.stats import binom, kstest, poisson

from forestgen.community.competition.domination import dominated
from forestgen.community.disturbance import Planting
from forestgen.community.model import simulate
from forestgen.community.models.forest_footprints import MODEL, Plants, State, survivors
from forestgen.community.population import Site, Status
from forestgen.core.errors import ResourceError
from support.error_messages import raises_error

PARAMETERS = MODEL.Parameters()


def make_state(species, parameters=PARAMETERS, sp=None, **columns):
    n = len(columns["r_m"])
    plants = Plants(
        x_m=np.random.default_rng(0).random((n, 2)) * 1000,
        r_m=np.array(columns["r_m"], float),
        sp=np.zeros(n, np.uint16) if sp is None else np.array(sp, np.uint16),
        vigour=np.linspace(0.1, 0.9, n),
        health=np.array(columns.get("health", np.ones(n)), float),
        dominated=np.array(columns.get("dominated", np.zeros(n)), bool),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        born=np.zeros(n, np.int32),
    )
    return State(parameters, Site((1000.0, 1000.0)), tuple(species), 1, 0, n + 1, plants)


def run(parameters, site, species, seed, steps):
    state = MODEL.init(parameters, site, species, seed)
    for _ in range(steps):
        state = MODEL.step(state)
    return state


def test_parameters_are_checked(tree):
    for wrong in ({"health_loss_per_yr": -1}, {"growth_exponent": -1}, {"derivation_steps": -1}, {"vigor": 1}):
        with pytest.raises(ValidationError):
            MODEL.Parameters(**wrong)
    named = MODEL.Parameters(derivation_steps_of={"oak": 3}).named_species()
    assert list(named) == [(("derivation_steps_of", "oak"), "oak")]


def brute_force(xy, r, vigour, plant_id, size, periodic):
    away = np.abs(xy[:, None] - xy[None])
    if periodic:
        away = np.minimum(away, np.array(size) - away)
    meets = np.sum(away**2, axis=2) <= (r[:, None] + r[None]) ** 2
    beats = (vigour[None] > vigour[:, None]) | (
        (vigour[None] == vigour[:, None]) & (plant_id[None] < plant_id[:, None])
    )
    return np.any(meets & beats, axis=1)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 120),
    spread=st.sampled_from([0.0, 1.0, 3.0]),
    periodic=st.booleans(),
    ties=st.booleans(),
    size=st.sampled_from([(10.0, 10.0), (50.0, 2.0), (100.0, 100.0)]),
)
def test_domination_is_that_of_all_pairs(seed, n, spread, periodic, ties, size):
    rng = np.random.default_rng(seed)
    xy = rng.random((n, 2)) * size
    r = 0.3 * np.exp(spread * rng.normal(size=n))
    r = np.minimum(r, 100)
    vigour = rng.integers(0, 4, n).astype(float) if ties else rng.random(n)
    plant_id = rng.permutation(n).astype(np.uint32) + 1
    ours = dominated(xy, r, plant_id, size, periodic=periodic, strength=vigour)
    np.testing.assert_array_equal(ours, brute_force(xy, r, vigour, plant_id, size, periodic))


def test_health_falls_and_recovers(tree):
    species = [tree(shade_tolerance=0.0), tree(name="b", shade_tolerance=0.5), tree(name="c", shade_tolerance=1.0)]
    parameters = MODEL.Parameters(health_loss_per_yr=0.4, health_gain_per_yr=0.3, step_yr=0.5)
    state = make_state(
        species,
        parameters,
        sp=[0, 1, 2, 0, 0],
        r_m=[1] * 5,
        health=[0.5, 0.5, 0.5, 0.5, 0.95],
        dominated=[1, 1, 1, 0, 0],
    )
    after = survivors(state, np.zeros(5))
    np.testing.assert_allclose(after.health, [0.3, 0.4, 0.5, 0.65, 1.0])


def test_growth_is_a_function_of_health(tree):
    parameters = MODEL.Parameters(growth_exponent=2, health_gain_per_yr=0)
    species = [tree(growth_m_per_yr=0.2, max_radius_m=2.0)]
    after = survivors(make_state(species, parameters, r_m=[1, 1, 1.9], health=[1, 0.5, 1]), np.zeros(3))
    np.testing.assert_allclose(after.r_m, [1.2, 1.05, 2.0])


def test_a_plant_dies_when_its_health_is_used_up(tree):
    """With a loss of 0.1 a year, ten years after domination begins, whatever rounding makes of 0.1."""
    parameters = MODEL.Parameters(health_loss_per_yr=0.1)
    state = make_state([tree(shade_tolerance=0.0)], parameters, r_m=[1.0], dominated=[True])
    years = 0
    while len(state.plants):
        state = dataclasses.replace(state, plants=survivors(state, np.ones(1)))
        years += 1
    assert years == 10


@pytest.mark.parametrize("probability", [0.0, 0.9, 0.98])
def test_old_plants_die_with_the_probability_of_the_species(tree, probability):
    n = 20_000
    species = [tree(), tree(name="b", old_age_survival=probability)]
    state = make_state(species, sp=np.ones(n), r_m=np.full(n, 2.0))
    alive = len(survivors(state, np.random.default_rng(1).random(n)))
    assert binom.ppf(1e-6, n, probability) <= alive <= binom.isf(1e-6, n, probability)
    young = make_state(species, sp=np.ones(n), r_m=np.full(n, 1.99))
    assert len(survivors(young, np.random.default_rng(1).random(n))) == n


def test_saplings_are_random(tree):
    state = MODEL.step(make_state([tree(seedlings_per_ha_per_yr=70.0)], r_m=[]))
    new = state.plants
    assert poisson.ppf(1e-6, 7000) <= len(new) <= poisson.isf(1e-6, 7000)
    for values in (new.vigour, new.x_m[:, 0] / 1000, new.x_m[:, 1] / 1000, new.r_m / 0.1 - 0.5):
        assert kstest(values, "uniform").pvalue > 1e-4
    assert np.all(new.health == 1)


def test_the_more_vigorous_wins_whatever_the_sizes(tree):
    """A small vigorous plant brings a large one down, which leaves it the place."""
    species = [tree(seedlings_per_ha_per_yr=0.0, shade_tolerance=0.0, max_radius_m=5.0)]
    state = MODEL.init(PARAMETERS, Site((40.0, 40.0)), species, 1)
    planting = Planting(
        np.zeros(2, np.uint16), np.array([[20.0, 20.0], [21.0, 20.0]]), np.array([4.0, 0.2]),
        {"vigour": np.array([0.3, 0.6])},
    )  # fmt: skip
    state = MODEL.plant(state, planting)
    radii = []
    for _ in range(4):
        population = MODEL.population(state)
        assert population.status.tolist() == [Status.DOMINATED, Status.GROWING]
        radii.append(population.radius_m[0])
        state = MODEL.step(state)
    assert MODEL.population(state).plant_id.tolist() == [2]
    growth = np.diff(radii)
    assert np.all(growth > 0)
    assert np.all(np.diff(growth) < 0)  # ever more stunted


def test_a_removed_tree_leaves_the_others_to_recover(tree):
    species = [tree(seedlings_per_ha_per_yr=0.0, shade_tolerance=0.5)]
    state = MODEL.init(PARAMETERS, Site((40.0, 40.0)), species, 1)
    planting = Planting(
        np.zeros(2, np.uint16), np.array([[20.0, 20.0], [21.0, 20.0]]), np.array([1.0, 1.0]),
        {"vigour": np.array([100.0, 0.6])},
    )  # fmt: skip
    state = MODEL.plant(state, planting)
    for _ in range(4):
        state = MODEL.step(state)
    assert MODEL.population(state).columns["health"][1] == 0.5
    state = MODEL.remove(state, np.array([1], np.uint32))
    assert MODEL.population(state).status.tolist() == [Status.GROWING]
    for _ in range(5):
        state = MODEL.step(state)
    assert MODEL.population(state).columns["health"][0] == pytest.approx(1.0)


def test_derivation_steps_are_the_radius_in_steps(tree):
    parameters = MODEL.Parameters(derivation_steps=5, derivation_steps_of={"b": 2})
    species = [tree(), tree(name="b")]
    state = make_state(species, parameters, sp=[0] * 6 + [1] * 3, r_m=[0.1, 0.39, 0.4, 1.0, 1.99, 2.0, 0.9, 1.0, 2.0])
    columns = MODEL.population(state).columns
    assert columns["derivation_steps"].tolist() == [0, 0, 1, 2, 4, 5, 0, 1, 2]
    assert set(columns) == {"vigour", "health", "derivation_steps"}


def test_a_cohort_begins_where_it_is_asked_for(tree):
    parameters = MODEL.Parameters(initial_plants_per_ha=1000)
    population = MODEL.population(MODEL.init(parameters, Site((100.0, 50.0)), [tree(), tree(name="b")], 1))
    assert len(population) == 500
    assert 150 < np.count_nonzero(population.species) < 350


@pytest.mark.parametrize("periodic", [True, False])
def test_life_histories(tree, site, periodic):
    few = {"seedlings_per_ha_per_yr": 60.0}
    species = [tree(**few), tree(name="b", growth_m_per_yr=0.05, shade_tolerance=0.9, **few)]
    gone: set[int] = set()
    before = None
    for now in simulate(MODEL, MODEL.Parameters(periodic=periodic), site, species, 3, steps=60):
        ids = set(now.plant_id.tolist())
        assert not gone & ids
        assert np.all(now.radius_m <= 2.0)
        assert np.all((now.columns["health"] > 0) & (now.columns["health"] <= 1))
        free = now.status != Status.DOMINATED
        xy = now.position_m[:, :2]
        alone = brute_force(xy, now.radius_m, now.columns["vigour"], now.plant_id, site.size_m, periodic)
        np.testing.assert_array_equal(free, ~alone)
        if before is not None:
            _, i, j = np.intersect1d(before.plant_id, now.plant_id, return_indices=True)
            gone |= set(before.plant_id.tolist()) - ids
            np.testing.assert_array_equal(now.position_m[j], before.position_m[i])
            np.testing.assert_array_equal(now.columns["vigour"][j], before.columns["vigour"][i])
            assert np.all(now.radius_m[j] >= before.radius_m[i])
            assert np.all(
                (now.columns["health"][j] < before.columns["health"][i])[before.status[i] == Status.DOMINATED]
            )
        before = now
    assert gone


def test_a_step_leaves_its_state_as_it_was(tree, site):
    state = run(PARAMETERS, site, [tree()], 2, 20)
    copy = pickle.dumps(state)
    MODEL.step(state)
    MODEL.remove(state, state.plants.plant_id[:3])
    assert pickle.dumps(state) == copy


def test_ids_are_used_up_with_an_error(tree, site):
    state = dataclasses.replace(MODEL.init(PARAMETERS, site, [tree()], 1), next_id=2**32 - 3)
    with raises_error(ResourceError):
        MODEL.step(state)
    with pytest.raises(ResourceError):
        MODEL.step(MODEL.init(PARAMETERS, site, [tree(seedlings_per_ha_per_yr=1e200)], 1))


@pytest.mark.parametrize("rate", [0.0, 400.0, 5000.0])
@pytest.mark.parametrize("numbers", [{}, {"shade_tolerance": 1.0, "old_age_survival": 1.0}, {"growth_m_per_yr": 0.0}])
@pytest.mark.parametrize("size", [(60.0, 60.0), (10_000.0, 1.0)])
def test_the_estimate_is_above_what_is_allocated(tree, rate, numbers, size):
    species = [tree(seedlings_per_ha_per_yr=rate, **numbers), tree(name="b", max_radius_m=0.3)]
    parameters = MODEL.Parameters(steps=30)
    run(parameters, Site(size), species, 1, 30)  # compile all that the steps need first
    tracemalloc.start()
    try:
        for _ in simulate(MODEL, parameters, Site(size), species, 1, steps=30):
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < MODEL.estimate_bytes(parameters, Site(size), species)


@pytest.mark.slow
def test_a_hundred_thousand_plants_take_less_than_a_second(tree):
    site, species = (
        Site((1000.0, 1000.0)),
        [tree(seedlings_per_ha_per_yr=40.0), tree(name="b", seedlings_per_ha_per_yr=40.0, max_radius_m=0.5)],
    )
    state = run(PARAMETERS, site, species, 1, 60)
    start = time.perf_counter()
    after = MODEL.step(state)
    seconds = time.perf_counter() - start
    print(f"{len(after.plants)} plants: {seconds:.3f} s a step")  # noqa: T201
    assert len(after.plants) > 100_000
    assert seconds < 1


def test_the_estimate_of_plants_that_never_regain_health_is_finite(tree):
    never = PARAMETERS.model_copy(update={"health_gain_per_yr": 0.0})
    assert MODEL.estimate_bytes(never, Site((50.0, 50.0)), [tree()]) < 1e12
