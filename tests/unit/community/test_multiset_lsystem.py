from __future__ import annotations

import dataclasses
import pickle
import tracemalloc

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom, kstest, poisson

from forestgen.community.model import Site, SpeciesEcology, simulate
from forestgen.community.models.multiset_lsystem import MODEL, State, Words, fragment, rewrite, successor_of_x
from forestgen.community.population import Status
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import RecipeError, ResourceError

SUCCESSION = MODEL.Parameters(program="succession")
SELF_THINNING = MODEL.Parameters(program="self_thinning")


def run(parameters, site, species, seed, steps):
    state = MODEL.init(parameters, site, species, seed)
    for _ in range(steps):
        state = MODEL.step(state)
    return state


def make_state(species, r, c, parameters=SUCCESSION, sp=None):
    n = len(r)
    words = Words(
        x_m=np.random.default_rng(0).random((n, 2)) * 1000,
        r_m=np.array(r, float),
        sp=np.zeros(n, np.uint16) if sp is None else np.array(sp, np.uint16),
        c=np.array(c, bool),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        born=np.zeros(n, np.int32),
    )
    return State(parameters, Site((1000.0, 1000.0)), tuple(species), 1, 0, n + 1, words)


def test_the_registry_knows_it():
    assert COMMUNITY_MODELS.load("multiset_lsystem") is MODEL
    with pytest.raises(RecipeError, match="multiset_lsystem"):
        COMMUNITY_MODELS.load("multiset")


def test_parameters_are_checked():
    wrongs = [{"steps": -1}, {"steps": 100_001}, {"step_yr": 0}, {"stepz": 3}, {"program": "x"}, {"step_yr": 1e999}]
    for wrong in wrongs:
        with pytest.raises(ValidationError):
            MODEL.Parameters(**wrong)
    with pytest.raises(ValidationError, match="bare ground"):
        MODEL.Parameters(program="succession", initial_plants_per_ha=10)


@pytest.mark.parametrize("name", ["max_radius_m", "seedling_radius_m", "height_scale"])
def test_species_and_site_are_checked(tree, name):
    with pytest.raises(ValueError, match=name):
        tree(**{name: 0.0})
    for numbers in ({"shade_tolerance": 1.1}, {"growth_m_per_yr": -1.0}, {"seedlings_per_ha_per_yr": float("nan")}):
        with pytest.raises(ValueError, match=next(iter(numbers))):
            tree(**numbers)
    for size in ((0.0, 1.0), (1.0, float("inf")), (1.0,)):
        with pytest.raises(ValueError, match="size_m"):
            Site(size)


def test_productions_of_succession_first_match_wins(tree):
    species = [tree(shade_tolerance=0.5, old_age_survival=0.8, max_radius_m=2.0, growth_m_per_yr=0.2)]
    #            2: shade    3: shade   2 before 4   4: old    5: old   6: grows  6: ends at R
    r = [1.0, 1.0, 2.0, 2.0, 2.0, 1.0, 1.95]
    c = [False, False, False, True, True, True, True]
    u = np.array([0.49, 0.5, 0.4, 0.79, 0.8, 0.99, 0.99])
    after = rewrite(make_state(species, r, c), u)
    assert after.plant_id.tolist() == [1, 3, 4, 6, 7]
    assert after.r_m.tolist() == [1.0, 2.0, 2.0, 1.1, 2.0]


def test_productions_of_self_thinning(tree):
    species = [tree(max_radius_m=2.0, growth_m_per_yr=0.2, old_age_survival=0.0, shade_tolerance=1.0)]
    after = rewrite(make_state(species, [1.0, 1.0, 2.0], [False, True, True], SELF_THINNING), np.zeros(3))
    assert after.plant_id.tolist() == [2, 3]
    assert after.r_m.tolist() == [1.1, 2.0]


@pytest.mark.parametrize("mature", [False, True])
@pytest.mark.parametrize("probability", [0.0, 0.03, 0.5, 0.98, 1.0])
def test_survival_has_the_probability_of_the_species(tree, mature, probability):
    n = 20_000
    key = "old_age_survival" if mature else "shade_tolerance"
    species = [tree(), tree(name="b", **{key: probability})]
    r = np.full(n, 2.0 if mature else 0.5)
    state = make_state(species, r, np.full(n, mature), sp=np.ones(n))
    alive = len(rewrite(state, np.random.default_rng(11).random(n)))
    assert binom.ppf(1e-6, n, probability) <= alive <= binom.isf(1e-6, n, probability)


def test_seedlings_arrive_at_the_rate_and_uniformly(tree):
    species = [tree(seedlings_per_ha_per_yr=70.0), tree(name="b", seedlings_per_ha_per_yr=0.0)]
    state = make_state(species, [], [])
    new = successor_of_x(state, np.random.default_rng(4))
    mean = 70.0 * 100 * 0.5
    assert poisson.ppf(1e-6, mean) <= len(new) <= poisson.isf(1e-6, mean)
    assert np.all(new.sp == 0)
    assert kstest(new.x_m[:, 0] / 1000, "uniform").pvalue > 1e-4
    assert kstest(new.x_m[:, 1] / 1000, "uniform").pvalue > 1e-4
    assert kstest(new.r_m / 0.1 - 0.5, "uniform").pvalue > 1e-4


def test_seedlings_are_never_larger_than_their_species(tree):
    species = [tree(max_radius_m=0.1, seedling_radius_m=0.1)]
    state = run(SUCCESSION, Site((100.0, 100.0)), species, 0, 3)
    assert state.words.r_m.max() == 0.1


def test_fragmentation_neither_loses_nor_invents_words(tree, columns_equal):
    state = make_state([tree()], [1.0, 1.0, 0.5], [True, False, True])
    survivors = rewrite(state, np.array([0.1, 0.9, 0.9]))
    cut_off = successor_of_x(state, np.random.default_rng(1))
    both = fragment(survivors, cut_off)
    assert len(both) == len(survivors) + len(cut_off)
    n = len(survivors)
    assert columns_equal(both.where(np.arange(len(both)) < n, both.r_m), survivors)
    assert columns_equal(both.where(np.arange(len(both)) >= n, both.r_m), cut_off)


@pytest.mark.parametrize("parameters", [SUCCESSION, SELF_THINNING])
def test_life_histories(tree, site, parameters):
    species = [tree(), tree(name="b", growth_m_per_yr=0.05, shade_tolerance=0.9)]
    gone: set[int] = set()
    before = None
    for now in simulate(MODEL, parameters, site, species, 3, steps=60):
        ids = now.plant_id.tolist()
        assert not gone.intersection(ids)
        assert now.position_m[:, 2].tolist() == [0.0] * len(now)
        assert np.all((now.position_m[:, :2] >= 0) & (now.position_m[:, :2] <= site.size_m))
        assert np.all(now.radius_m <= 2.0)
        np.testing.assert_allclose(now.height_m, 8.0 * now.radius_m**0.75)
        if before is not None:
            row = {k: i for i, k in enumerate(ids)}
            stay = [(i, row[k]) for i, k in enumerate(before.plant_id.tolist()) if k in row]
            i, j = np.array(stay, int).reshape(-1, 2).T
            gone.update(set(before.plant_id.tolist()) - set(ids))
            assert set(ids) - set(before.plant_id.tolist()) == set(ids[len(stay) :])  # the new have the highest ids
            grew = now.radius_m[j] - before.radius_m[i]
            assert np.all(grew[before.status[i] == Status.DOMINATED] == 0)
            assert np.all(grew[before.status[i] == Status.MATURE] == 0)
            assert np.all(grew[before.status[i] == Status.GROWING] > 0)
            np.testing.assert_array_equal(now.position_m[j], before.position_m[i])
            np.testing.assert_allclose(now.age_yr[j] - before.age_yr[i], 0.5)
            assert np.all(now.age_yr[len(stay) :] == 0)
        before = now
    assert gone


def test_a_step_leaves_its_state_as_it_was(tree, site):
    state = run(SUCCESSION, site, [tree()], 2, 20)
    copy = pickle.dumps(state)
    MODEL.step(state)
    assert pickle.dumps(state) == copy


def test_same_seed_same_bytes(tree, site, columns_equal):
    one, two = (run(SUCCESSION, site, [tree()], 0, 40) for _ in range(2))
    assert columns_equal(one.words, two.words)
    assert not columns_equal(one.words, run(SUCCESSION, site, [tree()], 1, 40).words)


@pytest.mark.parametrize("parameters", [SUCCESSION, SELF_THINNING])
def test_a_saved_state_resumes_to_the_same_future(tree, site, columns_equal, parameters):
    whole = run(parameters, site, [tree()], 5, 40)
    half = pickle.loads(pickle.dumps(run(parameters, site, [tree()], 5, 17)))
    for _ in range(23):
        half = MODEL.step(half)
    assert columns_equal(half.words, whole.words)
    assert (half.step, half.next_id) == (whole.step, whole.next_id)


@pytest.mark.parametrize("species_of", [lambda tree: [tree(seedlings_per_ha_per_yr=0.0)], lambda tree: []])
def test_no_seedlings_is_an_empty_population(tree, site, species_of):
    populations = list(simulate(MODEL, SUCCESSION, site, species_of(tree), 1, steps=5))
    assert [len(p) for p in populations] == [0] * 6
    assert [p.time_yr for p in populations] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    empty = MODEL.Parameters(program="self_thinning", initial_plants_per_ha=0)
    assert [len(p) for p in simulate(MODEL, empty, site, species_of(tree), 1, steps=2)] == [0] * 3


def test_ids_are_used_up_with_an_error(tree, site):
    state = dataclasses.replace(MODEL.init(SUCCESSION, site, [tree()], 1), next_id=2**32 - 3)
    with pytest.raises(ResourceError, match="plant ids are used up"):
        MODEL.step(state)
    last = dataclasses.replace(MODEL.init(SUCCESSION, site, [tree(seedlings_per_ha_per_yr=0.0)], 1), next_id=2**32)
    assert len(MODEL.step(last).words) == 0
    with pytest.raises(ResourceError):
        MODEL.step(MODEL.init(SUCCESSION, site, [tree(seedlings_per_ha_per_yr=1e200)], 1))


def test_a_lone_plant_grows_at_its_rate_to_its_radius(tree):
    species = [tree(growth_m_per_yr=0.3, max_radius_m=1.0, seedlings_per_ha_per_yr=0.0)]
    parameters = MODEL.Parameters(program="self_thinning", initial_plants_per_ha=1)
    radii = [p.radius_m[0] for p in simulate(MODEL, parameters, Site((100.0, 100.0)), species, 1, steps=9)]
    np.testing.assert_allclose(np.minimum(radii[0] + 0.15 * np.arange(10), 1.0), radii)
    assert radii[-1] == 1.0


def test_self_thinning_follows_the_minus_three_halves_law(tree):
    """Lane 2002, Fig. 4.4: mean mass (r^3) against density, once crowding has set in."""
    parameters = MODEL.Parameters(program="self_thinning", initial_plants_per_ha=30_000)
    species = [tree(growth_m_per_yr=0.05, max_radius_m=50.0)]
    mass, density = [], []
    for population in simulate(MODEL, parameters, Site((100.0, 100.0)), species, 6, steps=120):
        density.append(len(population))
        mass.append(np.mean(population.radius_m**3))
    crowded = np.array(density) < 0.2 * density[0]
    slope = np.polyfit(np.log(np.array(density)[crowded]), np.log(np.array(mass)[crowded]), 1)[0]
    assert slope == pytest.approx(-1.5, abs=0.1)


def peak_bytes(parameters, site, species, steps):
    tracemalloc.start()
    try:
        for _ in simulate(MODEL, parameters, site, species, 1, steps=steps):
            pass
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("rate", [0.0, 400.0, 5_000.0])
@pytest.mark.parametrize("numbers", [{}, {"shade_tolerance": 1.0, "old_age_survival": 1.0}, {"growth_m_per_yr": 0.0}])
@pytest.mark.parametrize("size", [(60.0, 60.0), (10_000.0, 1.0)])
def test_the_estimate_is_above_what_is_allocated(tree, rate, numbers, size):
    species = [tree(seedlings_per_ha_per_yr=rate, **numbers), tree(name="b", max_radius_m=0.3)]
    parameters = MODEL.Parameters(steps=30)
    peak_bytes(parameters, Site(size), species, 2)  # compile first
    assert peak_bytes(parameters, Site(size), species, 30) < MODEL.estimate_bytes(parameters, Site(size), species)


@pytest.mark.parametrize("per_ha", [0.0, 5e4, 1e6])
def test_the_estimate_of_a_cohort(tree, site, per_ha):
    parameters = MODEL.Parameters(program="self_thinning", initial_plants_per_ha=per_ha, steps=3)
    peak_bytes(parameters, Site((1.0, 1.0)), [tree()], 2)
    peak, estimate = peak_bytes(parameters, site, [tree()], 3), MODEL.estimate_bytes(parameters, site, [tree()])
    assert peak < estimate < 4 * peak + 1e6


def test_the_estimate_of_the_absurd_is_finite(tree):
    for rate, side in ((1e12, 120.0), (1e300, 1e150), (1e12, 1e-9)):
        species = [tree(seedlings_per_ha_per_yr=rate, shade_tolerance=1.0)]
        estimate = MODEL.estimate_bytes(MODEL.Parameters(steps=100_000), Site((side, side)), species)
        assert isinstance(estimate, int)
        cohort = MODEL.Parameters(program="self_thinning", initial_plants_per_ha=rate)
        assert isinstance(MODEL.estimate_bytes(cohort, Site((side, side)), species), int)
    assert MODEL.estimate_bytes(SUCCESSION, Site((120.0, 120.0)), [tree(seedlings_per_ha_per_yr=1e12)]) > 1e15


def test_protocol_fields_reach_the_population(site):
    herb = SpeciesEcology("herb", 0.2, 0.4, 0.1, 0.9, 900.0, 0.1, 3.0, 0.7)
    state = run(SUCCESSION, site, [herb], 9, 12)
    population = MODEL.population(state)
    assert population.species_names == ("herb",)
    assert population.time_yr == 6.0
    assert {Status.GROWING, Status.MATURE, Status.DOMINATED} >= set(population.status.tolist())
    assert np.all(population.radius_m[population.status == Status.MATURE] == 0.4)
