from __future__ import annotations

import dataclasses
import itertools
import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom, kstest, poisson

from forestgen.community.model import simulate
from forestgen.community.models.multiset_lsystem import MODEL
from forestgen.community.population import Population, Site, SpeciesEcology, Status
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import AssetError, ForestgenError, LsystemError, RecipeError, ResourceError
from support.error_messages import raises_error

SUCCESSION = MODEL.Parameters(program="succession")
SELF_THINNING = MODEL.Parameters(program="self_thinning")
PROPAGATION = MODEL.Parameters(program="propagation", parameters={"initial_plants_per_ha": (300.0, 200.0)})
WIDE = Site((100_000.0, 100_000.0))


def cohort(per_ha, **more):
    return MODEL.Parameters(program="self_thinning", parameters={"initial_plants_per_ha": float(per_ha)}, **more)


def program(text, **more):
    return MODEL.Parameters(program={"name": "own.lsys", "text": text}, **more)


def run(parameters, site, species, seed, steps):
    state = MODEL.init(parameters, site, species, seed)
    for _ in range(steps):
        state = MODEL.step(state)
    return state


def words(state):
    """All arrays of a state's multiset."""
    multiset = state.derivation.multiset
    return [getattr(multiset, name) for name in ("code", "parameter", "word_start", "word_id", "born_step")]


def same(one, two):
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in zip(words(one), words(two), strict=True))


def state_of(species, r, c, parameters=SUCCESSION, sp=None, seed=1):
    """Plants of these radii and answers far apart on a wide site, without X: nothing arrives."""
    n = len(r)
    sp = np.zeros(n, np.uint16) if sp is None else np.array(sp, np.uint16)
    side = int(np.ceil(np.sqrt(max(n, 1))))
    at = np.arange(n)
    population = Population(
        time_yr=0.0,
        species_names=tuple(one.name for one in species),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=sp,
        position_m=np.stack([at % side, at // side, 0 * at], axis=1) * (90_000.0 / side),
        radius_m=np.array(r, float),
        height_m=np.ones(n),
        age_yr=np.zeros(n),
        status=np.zeros(n, np.uint8),
        columns={"word": at.astype(np.uint32), "c": np.array(c, float)},
        state={"next_id": n + 1, "globals": [0.0], "words": []},
    )
    return MODEL.resume(parameters, WIDE, species, seed, population)


def after_a_step(state):
    return MODEL.population(MODEL.step(state))


def test_the_registry_knows_it():
    assert COMMUNITY_MODELS.load("multiset_lsystem") is MODEL
    with raises_error(RecipeError):
        COMMUNITY_MODELS.load("multiset")


def test_parameters_are_checked():
    wrongs = [{"steps": -1}, {"steps": 100_001}, {"step_yr": 0}, {"stepz": 3}, {"step_yr": 1e999}]
    for wrong in wrongs:
        with pytest.raises(ValidationError):
            MODEL.Parameters(**wrong)
    with raises_error(AssetError):
        MODEL.Parameters(program="x")


def test_sites_are_checked():
    for size in ((0.0, 1.0), (1.0, float("inf")), (1.0,)):
        with pytest.raises(ValueError, match="size_m"):
            Site(size)


@pytest.mark.parametrize("shaded", [0.0, 1.0])
@pytest.mark.parametrize("oldage", [0.0, 1.0])
def test_productions_of_succession_first_match_wins(tree, shaded, oldage):
    species = [tree(shade_tolerance=shaded, old_age_survival=oldage, max_radius_m=2.0, growth_m_per_yr=0.2)]
    #    2 and 3: shade, 2 and 3 before 4, 4 and 5: old, 6: grows, 6: ends at R
    r, c = [1.0, 2.0, 2.0, 1.0, 1.95], [0, 0, 1, 1, 1]
    after = after_a_step(state_of(species, r, c))
    lives = [shaded == 1, shaded == 1, oldage == 1, True, True]
    assert after.plant_id.tolist() == [k + 1 for k in range(5) if lives[k]]
    assert after.radius_m.tolist() == [
        one for one, alive in zip([1.0, 2.0, 2.0, 1.1, 2.0], lives, strict=True) if alive
    ]


def test_productions_of_self_thinning(tree):
    species = [tree(max_radius_m=2.0, growth_m_per_yr=0.2, old_age_survival=0.0, shade_tolerance=1.0)]
    after = after_a_step(state_of(species, [1.0, 1.0, 2.0], [0, 1, 1], SELF_THINNING))
    assert after.plant_id.tolist() == [2, 3]
    assert after.radius_m.tolist() == [1.1, 2.0]


def test_productions_of_propagation(tree):
    """An undominated plant below R grows and sows one seed near itself; others as in succession."""
    species = [tree(max_radius_m=2.0, growth_m_per_yr=0.2, old_age_survival=1.0, shade_tolerance=0.0)]
    parameters = MODEL.Parameters(
        program="propagation", parameters={"dispersal_m": (3.0,), "initial_plants_per_ha": (10.0,)}
    )
    n = 4000
    r, c = np.where(np.arange(n) % 4 == 0, 2.0, 1.0), np.arange(n) % 4 != 1
    after = after_a_step(state_of(species, r, c, parameters))
    sowers = np.flatnonzero((r < 2) & c) + 1
    assert set(after.plant_id[after.plant_id <= n]) == set(np.flatnonzero(c) + 1)
    children = after.plant_id > n
    assert children.sum() == len(sowers)
    before = MODEL.population(state_of(species, r, c, parameters)).position_m[sowers - 1, :2]
    away = (after.position_m[children, :2] - before + 50_000) % 100_000 - 50_000
    distance, direction = np.hypot(*away.T), np.arctan2(*away.T)
    assert kstest((distance / 3.0) ** 2, "uniform").pvalue > 1e-4
    assert kstest(direction / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-4
    assert set(after.radius_m[children]) == {0.1}


@pytest.mark.parametrize("mature", [False, True])
@pytest.mark.parametrize("probability", [0.0, 0.03, 0.5, 0.98, 1.0])
def test_survival_has_the_probability_of_the_species(tree, mature, probability):
    n = 20_000
    key = "old_age_survival" if mature else "shade_tolerance"
    species = [tree(), tree(name="b", **{key: probability})]
    r = np.full(n, 2.0 if mature else 0.5)
    alive = len(after_a_step(state_of(species, r, np.full(n, mature), sp=np.ones(n))))
    assert binom.ppf(1e-6, n, probability) <= alive <= binom.isf(1e-6, n, probability)


def test_seedlings_arrive_at_the_rate_and_uniformly(tree):
    species = [tree(seedlings_per_ha_per_yr=70.0), tree(name="b", seedlings_per_ha_per_yr=0.0)]
    new = MODEL.population(run(SUCCESSION, Site((1000.0, 1000.0)), species, 4, 1))
    mean = 70.0 * 100 * 0.5
    assert poisson.ppf(1e-6, mean) <= len(new) <= poisson.isf(1e-6, mean)
    assert np.all(new.species == 0)
    assert kstest(new.position_m[:, 0] / 1000, "uniform").pvalue > 1e-4
    assert kstest(new.position_m[:, 1] / 1000, "uniform").pvalue > 1e-4
    assert kstest(new.radius_m / 0.1 - 0.5, "uniform").pvalue > 1e-4


def test_seedlings_are_never_larger_than_their_species(tree):
    species = [tree(max_radius_m=0.1, seedling_radius_m=0.1)]
    assert MODEL.population(run(SUCCESSION, Site((100.0, 100.0)), species, 0, 3)).radius_m.max() == 0.1


@pytest.mark.parametrize("parameters", [SUCCESSION, SELF_THINNING, PROPAGATION])
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
    copy = pickle.dumps(words(state))
    MODEL.step(state)
    assert pickle.dumps(words(state)) == copy


def test_same_seed_same_bytes(tree, site):
    one, two = (run(SUCCESSION, site, [tree()], 0, 40) for _ in range(2))
    assert same(one, two)
    assert not same(one, run(SUCCESSION, site, [tree()], 1, 40))


@pytest.mark.parametrize("parameters", [SUCCESSION, SELF_THINNING, PROPAGATION])
def test_a_snapshot_resumes_to_the_same_future(tree, site, parameters):
    whole = run(parameters, site, [tree()], 5, 30)
    half = MODEL.resume(parameters, site, [tree()], 5, MODEL.population(run(parameters, site, [tree()], 5, 17)))
    for _ in range(13):
        half = MODEL.step(half)
    assert same(half, whole)
    assert (half.step, half.derivation.next_id) == (whole.step, whole.derivation.next_id)


@pytest.mark.parametrize("species_of", [lambda tree: [tree(seedlings_per_ha_per_yr=0.0)], lambda tree: []])
def test_no_seedlings_is_an_empty_population(tree, site, species_of):
    populations = list(simulate(MODEL, SUCCESSION, site, species_of(tree), 1, steps=5))
    assert [len(p) for p in populations] == [0] * 6
    assert [p.time_yr for p in populations] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    empty = cohort(0)
    assert [len(p) for p in simulate(MODEL, empty, site, species_of(tree), 1, steps=2)] == [0] * 3


def with_next_id(state, next_id):
    return dataclasses.replace(state, derivation=dataclasses.replace(state.derivation, next_id=next_id))


def test_ids_are_used_up_with_an_error(tree, site):
    with raises_error(ResourceError, place="succession.lsys"):
        MODEL.step(with_next_id(MODEL.init(SUCCESSION, site, [tree()], 1), 2**32 - 3))
    last = with_next_id(MODEL.init(SUCCESSION, site, [tree(seedlings_per_ha_per_yr=0.0)], 1), 2**32)
    assert len(MODEL.population(MODEL.step(last))) == 0
    with pytest.raises(ForestgenError):
        MODEL.step(MODEL.init(SUCCESSION, site, [tree(seedlings_per_ha_per_yr=1e200)], 1))


def test_a_community_that_grows_too_large_stops_with_an_error(tree, site):
    crowded = MODEL.Parameters(most_plants=1000)
    with raises_error(ResourceError, place="succession.lsys"):
        run(crowded, site, [tree(seedlings_per_ha_per_yr=1e5)], 1, 3)


def test_a_lone_plant_grows_at_its_rate_to_its_radius(tree):
    species = [tree(growth_m_per_yr=0.3, max_radius_m=1.0, seedlings_per_ha_per_yr=0.0)]
    parameters = cohort(1)
    radii = [p.radius_m[0] for p in simulate(MODEL, parameters, Site((100.0, 100.0)), species, 1, steps=9)]
    np.testing.assert_allclose(np.minimum(radii[0] + 0.15 * np.arange(10), 1.0), radii)
    assert radii[-1] == 1.0


def test_self_thinning_follows_the_minus_three_halves_law(tree):
    """Lane 2002, Fig. 4.4: mean mass (r^3) against density, once crowding has set in."""
    parameters = cohort(30_000)
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
    parameters = MODEL.Parameters(steps=15)
    peak_bytes(parameters, Site((20.0, 20.0)), species, 2)  # compile first
    assert peak_bytes(parameters, Site(size), species, 15) < MODEL.estimate_bytes(parameters, Site(size), species)


@pytest.mark.parametrize("per_ha", [0.0, 5e4, 1e6])
def test_the_estimate_of_a_cohort(tree, site, per_ha):
    parameters = cohort(per_ha, steps=3)
    peak_bytes(parameters, Site((1.0, 1.0)), [tree()], 2)
    peak, estimate = peak_bytes(parameters, site, [tree()], 3), MODEL.estimate_bytes(parameters, site, [tree()])
    assert peak < estimate < 4 * peak + 5e6


def test_the_estimate_of_the_absurd_is_finite(tree):
    for rate, side in ((1e12, 120.0), (1e300, 1e150), (1e12, 1e-9)):
        species = [tree(seedlings_per_ha_per_yr=rate, shade_tolerance=1.0)]
        estimate = MODEL.estimate_bytes(MODEL.Parameters(steps=100_000), Site((side, side)), species)
        assert isinstance(estimate, int)
        assert isinstance(MODEL.estimate_bytes(cohort(rate), Site((side, side)), species), int)
    assert MODEL.estimate_bytes(SUCCESSION, Site((120.0, 120.0)), [tree(seedlings_per_ha_per_yr=1e12)]) > 1e15


def test_protocol_fields_reach_the_population(site):
    herb = SpeciesEcology("herb", 0.2, 0.4, 0.1, 0.9, 900.0, 0.1, 3.0, 0.7)
    state = run(SUCCESSION, site, [herb], 9, 12)
    population = MODEL.population(state)
    assert population.species_names == ("herb",)
    assert population.time_yr == 6.0
    assert {Status.GROWING, Status.MATURE, Status.DOMINATED} >= set(population.status.tolist())
    assert np.all(population.radius_m[population.status == Status.MATURE] == 0.4)


# --- programs of one's own


@pytest.mark.parametrize(
    "text",
    [
        "axiom: { X }\nX --> X",
        "axiom: T(1,1,1,0)?E(1)\nT(x,y,r,sp) --> T(x,y,r,sp)",
        "axiom: { T(1,1)?E(1) }\nT(x,y) --> T(x,y)",
        "axiom: { T(1,1,1,0)?E(1)A }\nA --> A",
        "axiom: { T(1,1,0,0)?E(1) }\nA --> A",
        "axiom: { T(1,1,1,3)?E(1) }\nA --> A",
    ],
)
def test_programs_that_write_no_plants(tree, site, text):
    with raises_error(LsystemError, place="own.lsys"):
        MODEL.init(program(text), site, [tree()], 1)


def test_parameters_that_the_program_does_not_have():
    with pytest.raises(ValidationError, match=r"(?s)no parameter sowings.*initial_plants_per_ha.*sowing"):
        MODEL.Parameters(program="propagation", parameters={"sowings": 1.0})
    for value in (-500.0, [1.0], "many"):
        with pytest.raises(ValidationError):
            MODEL.Parameters(program="self_thinning", parameters={"initial_plants_per_ha": value})
    with pytest.raises(ValidationError, match=r"species' ecology set shade_tolerance"):
        MODEL.Parameters(parameters={"shade_tolerance": [1.0]})
    with pytest.raises(ValidationError, match=r"site, step and species set step_yr"):
        MODEL.Parameters(parameters={"step_yr": 3.0})


def test_more_parameters_become_columns_and_survive_resuming(tree, site):
    text = "axiom: { T(1,1,1,0,7)?E(1,9), T(9,9,1,0,8)?E(1,9) }\n"
    text += "T(x,y,r,sp,mass_kg)?E(c,note) --> T(x,y,r,sp,mass_kg+1)?E(1,note)"
    parameters = program(text)
    population = MODEL.population(run(parameters, site, [tree()], 1, 2))
    assert population.columns["mass_kg"].tolist() == [9.0, 10.0]
    assert population.columns["note"].tolist() == [9.0, 9.0]
    again = MODEL.resume(parameters, site, [tree()], 1, population)
    assert same(MODEL.step(again), run(parameters, site, [tree()], 1, 3))


def test_seeds_beyond_the_edge_return_on_a_torus_and_are_lost_on_a_bounded_site(tree):
    text = "axiom: { T(99,50,1,0)?E(1) }\nT(x,y,r,sp)?E(c) : x > 90 --> T(x,y,r,sp)?E(1)%T(x+3,y-60,1,0)?E(1)"
    both = [
        MODEL.population(run(program(text, periodic=periodic), Site((100.0, 100.0)), [tree()], 1, 1))
        for periodic in (True, False)
    ]
    assert both[0].position_m[:, :2].tolist() == [[99.0, 50.0], [2.0, 90.0]]
    assert both[1].position_m[:, :2].tolist() == [[99.0, 50.0]]


@pytest.mark.parametrize("name", ["aikman_watkinson", "firbank_watkinson", "leps_kindlmann"])
def test_even_aged_stands_of_the_other_environments(tree, name):
    """Crowded plants thin out and stay smaller than R on the way; a lone plant does not die."""
    parameters = MODEL.Parameters(program=name, environment=name, parameters={"initial_plants_per_ha": 10_000.0})
    counts = [len(p) for p in simulate(MODEL, parameters, Site((40.0, 40.0)), [tree()], 2, steps=100)]
    assert all(b <= a for a, b in itertools.pairwise(counts))
    assert counts[-1] < 0.95 * counts[0]
    lone = MODEL.Parameters(program=name, environment=name, parameters={"initial_plants_per_ha": 1.0})
    *_, last = simulate(MODEL, lone, Site((100.0, 100.0)), [tree(growth_m_per_yr=0.3)], 2, steps=300)
    assert len(last) == 1
    assert last.radius_m[0] == pytest.approx(2.0, rel=0.05)


def test_an_environment_with_its_own_keys():
    keys = {"model": "leps_kindlmann", "tolerance": -1}
    with pytest.raises(ValidationError, match="greater than 0"):
        MODEL.Parameters(environment=keys)
    with pytest.raises(ValidationError, match="domination"):
        MODEL.Parameters(environment="none")


def test_shipped_programs_say_what_they_are():
    from forestgen.recipe.assets import find_asset, list_assets

    for name in list_assets("lsystems"):
        path: Path = find_asset("lsystems", name)
        assert path.suffix == ".sys" or path.read_text().startswith("// ")


def test_a_parameter_named_word_does_not_disturb_resuming(tree, site):
    text = "axiom: { T(1,1,1,0,3)?E(1), T(9,9,1,0,2)?E(1) }\nT(x,y,r,sp,word)?E(c) --> T(x,y,r,sp,word)?E(1)"
    text += "%T(x+1,y+1,r,sp,word+1)?E(1)"
    population = MODEL.population(run(program(text), site, [tree()], 1, 2))
    again = MODEL.resume(program(text), site, [tree()], 1, population)
    assert same(again, run(program(text), site, [tree()], 1, 2))
    assert same(MODEL.step(again), run(program(text), site, [tree()], 1, 3))


def test_words_of_commas_resume(tree, site):
    text = "axiom: { X, T(1,1,1,0)?E(1) }\nX --> X\nX --> Y,Z(-0.5)\nT(x,y,r,sp) --> T(x,y,r,sp)"
    text = text.replace("X --> X\n", "")
    population = MODEL.population(run(program(text), site, [tree()], 1, 2))
    again = MODEL.resume(program(text), site, [tree()], 1, population)
    assert same(again, run(program(text), site, [tree()], 1, 2))


def test_the_limit_of_plants_is_exact(tree, site):
    assert len(MODEL.population(MODEL.init(cohort(10_000, most_plants=2400), site, [tree()], 1))) == 2400
    with raises_error(ResourceError, place="self_thinning.lsys"):
        MODEL.init(cohort(10_000, most_plants=2399), site, [tree()], 1)


@pytest.mark.parametrize("doubled", ["A --> AA", "A --> A%A"])
def test_words_beside_the_plants_that_double_are_refused_soon(tree, site, doubled):
    text = f"axiom: {{ A, T(1, 1, 0.5, 0)?E(1) }}\n{doubled}\nT(x, y, r, sp) --> T(x, y, r, sp)\n"
    with raises_error(ResourceError, place="own.lsys"):
        run(program(text), site, [tree()], 1, 300)


@pytest.mark.parametrize("step_yr", [0.25, 0.5, 1.0])
@pytest.mark.parametrize(("need", "radius_m"), [(100.0, 0.5), (0.0, 2.0)], ids=["shade", "old age"])
def test_under_light_as_many_survive_two_years_whatever_the_step_is(step_yr, need, radius_m, tree):
    """Species give survival over half a year: 0.8 in the shade, 0.9 of the old."""
    of = tree(max_radius_m=2.0, shade_tolerance=0.8, old_age_survival=0.9)
    light = MODEL.Parameters(program="crown_light", step_yr=step_yr, parameters={"need_of_light": need})
    state = state_of((of,), np.full(4000, radius_m), np.ones(4000), light)
    for _ in range(round(2.0 / step_yr)):
        state = MODEL.step(state)
    expected = (0.8 if need else 0.9) ** 4
    assert abs(len(MODEL.population(state)) - 4000 * expected) < 4.0 * np.sqrt(4000 * expected * (1.0 - expected))


@pytest.mark.parametrize("step_yr", [0.125, 0.25, 0.5, 1.0])
def test_under_light_growth_in_two_years_spreads_alike_whatever_the_step_is(step_yr, tree):
    """Half-years differ by a uniform factor of 0.5 to 1.5, of variance 0.5^2 / 3; four of them are independent."""
    of = tree(max_radius_m=1000.0, growth_m_per_yr=0.1)
    clear = {"model": "crown_light", "extinction": 1e-9}
    state = state_of(
        (of,),
        np.full(4000, 0.1),
        np.ones(4000),
        MODEL.Parameters(program="crown_light", step_yr=step_yr, environment=clear),
    )
    for _ in range(round(2.0 / step_yr)):
        state = MODEL.step(state)
    grown = MODEL.population(state).radius_m - 0.1
    assert grown.mean() == pytest.approx(0.2, rel=0.01)
    assert grown.std() / grown.mean() == pytest.approx(0.5 / np.sqrt(3 * 4), rel=0.05)
