"""The model that grows with deformation kernels: its parts against brute force, its whole against what is known."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from forestgen.community.competition.domination import dominated
from forestgen.community.disturbance import Planting
from forestgen.community.kernel_interactions import Interactions, Rivals, establishment, invitation, quality
from forestgen.community.model import simulate
from forestgen.community.models.kernel_growth import MODEL, survivors
from forestgen.community.placement.kernels import NEUTRAL, KernelSection, KernelTable, table
from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Site, SpeciesEcology, Status, cover_by_species
from forestgen.community.trajectory import self_thinning_slope

CONE = {"curve": [[0, 0], [1.5, 1]]}
CORE = {"curve": [[0, 0], [1, 0], [1.0001, 1]]}
BOTH = {"curve": [[0, 0], [0.5, 0], [0.8, 4], [2, 0.5], [3, 1]]}  # above 1 and below


def kernel(**section) -> KernelTable:
    return table(KernelSection(**section))


def population(n, size_m, seed, kinds=2) -> Rivals:
    """Plants of all sizes, some alike, some off the site."""
    rng = np.random.default_rng(seed)
    x_m = rng.random((n, 2)) * size_m
    x_m[: n // 50] += np.multiply(size_m, 0.9)
    r_m = rng.lognormal(-1.0, 1.0, n)
    r_m[::7] = r_m[0]
    ids = np.arange(1, n + 1, dtype=np.uint32)
    return Rivals(x_m, r_m, rng.integers(0, kinds, n).astype(np.uint16), ids, size_m, periodic=True)


def distances(a_m, b_m, size_m, periodic):
    """(A, B) metres, on a torus to the nearest image."""
    d = a_m[:, None, :] - b_m[None, :, :]
    if periodic:
        d -= np.round(d / size_m) * size_m
    return np.hypot(d[..., 0], d[..., 1])


def each_kernel(x_m, sp, rivals, kernels):
    """(M, N) κ of each plant at each place, plainly."""
    apart = distances(x_m, rivals.x_m, rivals.size_m, rivals.periodic)
    made = np.empty(apart.shape)
    for n, j in enumerate(rivals.sp):
        for i in np.unique(sp):
            made[sp == i, n] = kernels[i][j](apart[sp == i, n], rivals.r_m[n])
    return made


MATRIX = [
    [kernel(**CONE), kernel(curve=[[0, 0], [0.3, 0], [0.6, 3], [3, 1]])],
    [kernel(curve=[[0, 0.2], [1.5, 1]], distance="metres"), NEUTRAL],
]


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize(("n", "size_m"), [(300, (20.0, 10.0)), (40, (2.0, 3.0)), (1, (5.0, 5.0))])
def test_products_are_those_of_all_pairs(n, size_m, periodic):
    rivals = replace(population(n, size_m, 1), periodic=periodic)
    every = each_kernel(rivals.x_m, rivals.sp, rivals, MATRIX)
    r_m, ids = rivals.r_m, rivals.plant_id
    above = (r_m[None, :] > r_m[:, None]) | ((r_m[None, :] == r_m[:, None]) & (ids[None, :] < ids[:, None]))
    kernels = Interactions.of(MATRIX)
    wanted = np.minimum(np.where(above, every, 1.0).prod(axis=1), 1.0)
    np.testing.assert_allclose(quality(rivals, kernels), wanted, rtol=1e-12, atol=1e-14)
    got = establishment(rivals.x_m, rivals.sp, rivals, kernels)
    np.testing.assert_allclose(got, np.minimum(every, 1.0).prod(axis=1), rtol=1e-12, atol=1e-14)
    if n == 300:
        assert np.sum((wanted > 0) & (wanted < 1)) > 50
        assert np.sum(np.minimum(every, 1.0).prod(axis=1) == 0) > 20


@pytest.mark.parametrize("periodic", [True, False])
def test_invitation_is_the_product_at_the_middles_of_cells(periodic):
    rivals = replace(population(60, (6.0, 4.0), 2), periodic=periodic)
    rows, cols = shape = 14, 17
    x, y = np.meshgrid((np.arange(cols) + 0.5) * 6 / cols, (np.arange(rows) + 0.5) * 4 / rows)
    middles = np.stack([x, y], -1).reshape(-1, 2)
    every = each_kernel(middles, np.zeros(rows * cols, np.int64), rivals, MATRIX)
    got = invitation(rivals, Interactions.of(MATRIX), 0, shape)
    # The table's logarithms are interpolated; only where κ crosses 1 that is less than exact.
    np.testing.assert_allclose(got.ravel(), np.log(np.maximum(every, 1.0)).sum(axis=1), atol=0.03)
    assert got.max() > 2


def test_a_hard_core_of_two_radii_is_domination_among_plants_of_nearly_one_size():
    rng = np.random.default_rng(3)
    x_m, r_m = rng.random((4000, 2)) * (60, 40), 0.3 + 1e-9 * rng.random(4000)
    ids = np.arange(1, 4001, dtype=np.uint32)
    # The table is linear between samples: κ leaves 0 in the last of 1024, at 1.998 radii at least.
    core = KernelTable(np.append(np.zeros(1024), 1.0), 2.0, in_radii=True)
    q = quality(Rivals(x_m, r_m, np.zeros(4000, np.uint16), ids, (60.0, 40.0), True), Interactions.of([[core]]))
    beaten = dominated(x_m, r_m, ids, (60.0, 40.0), periodic=True)
    assert np.all(q[~beaten] == 1)
    between = (q > 0) & (q < 1)
    assert between.mean() < 0.01
    assert np.all(q[beaten & ~between] == 0)
    assert 0.4 < beaten.mean() < 0.9


def test_life_is_lanes_at_its_ends_and_between_them_a_mixture(tree):
    one = tree(shade_tolerance=0.6, old_age_survival=0.9)
    parameters = MODEL.Parameters(growth_exponent=2, step_yr=0.5)
    n = 6
    state = MODEL.plant(
        MODEL.init(parameters, Site((50.0, 50.0)), [one], 0),
        Planting(np.zeros(n, np.uint16), np.arange(n)[:, None] * [8.0, 8.0], np.array([1, 1, 1, 2, 2, 2.0])),
    )
    state = replace(state, plants=replace(state.plants, quality=np.array([0, 0.5, 1] * 2, float)))
    chance = [0.6, 0.8, 1.0, 0.6, 0.75, 0.9]
    assert survivors(state, np.array(chance) - 1e-9).plant_id.tolist() == [1, 2, 3, 4, 5, 6]
    assert survivors(state, np.array(chance)).plant_id.tolist() == []
    assert survivors(state, np.zeros(n)).r_m.tolist() == [1.0, 1.0 + 0.05 * 0.25, 1.05, 2.0, 2.0, 2.0]


@pytest.fixture
def nurses(tree) -> tuple[MODEL.Parameters, Site, list[SpeciesEcology]]:
    """Eight immortal plants that bar, thin and invite seedlings of another species, on ground with a map."""
    still = {"growth_m_per_yr": 0.0, "shade_tolerance": 1.0, "old_age_survival": 1.0}
    species = [
        tree(name="a", seedlings_per_ha_per_yr=0.0, **still), tree(name="b", seedlings_per_ha_per_yr=5e4, **still)
    ]  # fmt: skip
    parameters = MODEL.Parameters(
        kernels={"a": {"b": BOTH}}, ground={"b": {"map": [[1, 0.2], [0, 2]]}}, most_inviting=8, step_yr=1, cells=96
    )
    return parameters, Site((12.0, 8.0)), species


def test_seedlings_follow_the_deformed_density(nurses):
    """Chi-square of their places over 25 seeds, and their number."""
    parameters, site, species = nurses
    rng = np.random.default_rng(4)
    adults = Planting(np.zeros(8, np.uint16), rng.random((8, 2)) * site.size_m, rng.uniform(0.4, 1.5, 8))
    state = MODEL.plant(MODEL.init(parameters, site, species, 0), adults)
    found = [MODEL.step(replace(state, seed=seed)).plants.x_m[8:] for seed in range(25)]

    fine = 4  # places along a cell's side
    base = np.kron(state.ground.density[1], np.ones((fine, fine)))
    rows, cols = base.shape
    x, y = np.meshgrid((np.arange(cols) + 0.5) * 12 / cols, (np.arange(rows) + 0.5) * 8 / rows)
    apart = distances(np.stack([x, y], -1).reshape(-1, 2), adults.position_m, site.size_m, True)
    each = np.stack([kernel(**BOTH)(apart[:, k], r) for k, r in enumerate(adults.radius_m)])
    inviting = base * np.minimum(np.maximum(each, 1).prod(axis=0), 8).reshape(base.shape)
    field = inviting * np.minimum(each, 1).prod(axis=0).reshape(base.shape)
    assert np.maximum(each, 1).prod(axis=0).max() > 8

    seeds = 5e4 * site.area_ha * state.ground.mean[1] * len(found)
    wanted = seeds * field.sum() / inviting.sum()
    places = np.concatenate(found)
    assert abs(len(places) - wanted) < 4 * math.sqrt(wanted)
    counts, _, _ = np.histogram2d(places[:, 1], places[:, 0], bins=(16, 24), range=((0, 8), (0, 12)))
    shares = field.reshape(16, rows // 16, 24, cols // 24).sum(axis=(1, 3)) / field.sum()
    enough = shares * len(places) >= 5
    observed = np.append(counts[enough], counts[~enough].sum())
    expected = np.append(shares[enough], shares[~enough].sum()) * len(places)
    assert stats.chisquare(observed, expected).pvalue > 0.001
    flat = base.reshape(16, rows // 16, 24, cols // 24).sum(axis=(1, 3)) / base.sum()
    some = flat * len(places) >= 5
    assert np.sum((counts[some] - flat[some] * len(places)) ** 2 / (flat[some] * len(places))) > 10 * some.sum()


def test_no_seedling_within_a_hard_core_and_none_where_the_ground_bars(tree):
    site = Site((20.0, 20.0))
    species = [tree(seedlings_per_ha_per_yr=20_000.0), tree(name="b", seedlings_per_ha_per_yr=20_000.0)]
    keep_out = [[0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]  # 5 m < x < 10 m, 10 m < y < 15 m
    parameters = MODEL.Parameters(kernels=CORE, keep_out=keep_out, ground={"b": {"map": [[0, 1]]}})
    before, arrived = None, 0
    for now in simulate(MODEL, parameters, site, species, 5, steps=25):
        if before is not None:
            new = ~np.isin(now.plant_id, before.plant_id)
            apart = distances(now.position_m[new, :2], now.position_m[~new, :2], site.size_m, True)
            assert np.all(
                apart > 0.999 * now.radius_m[~new]
            )  # κ is linear between 1025 samples: 0 up to the last but one
            arrived += int(new.sum())
            x, y = now.position_m[:, 0], now.position_m[:, 1]
            assert not np.any((x > 5) & (x < 10) & (y > 10) & (y < 15))
            assert x[now.species == 1].min() > 5  # the map is smooth between the middles of its two pixels
        before = now
    assert arrived > 2000


@pytest.mark.parametrize("ground", [{}, {"tree": {"map": [[0, 1], [1, 1]]}}])
def test_neutral_plants_are_immigration_and_death(tree, ground):
    """Mature from the first, each lives 1 / (1 - oldage) steps: a Poisson number of known mean."""
    one = tree(seedling_radius_m=4.0, old_age_survival=0.75, seedlings_per_ha_per_yr=500.0)
    site = Site((40.0, 20.0))
    parameters = MODEL.Parameters(kernels="neutral", ground=ground, step_yr=1, cells=32)
    mean = 500 * 0.08 * MODEL.init(parameters, site, [one], 0).ground.mean[0] / 0.25
    assert mean == pytest.approx(160 if not ground else 120, rel=0.15)
    counts = np.array([len(list(simulate(MODEL, parameters, site, [one], seed, steps=30))[-1]) for seed in range(40)])
    assert abs(counts.mean() - mean) < 3.5 * math.sqrt(mean / 40)
    assert 0.4 < counts.var(ddof=1) / mean < 1.9


def lane(name, growth, radius, seedling, rate, shade, old):
    return SpeciesEcology(name, growth, radius, shade, old, rate, seedling, 8.0, 0.9)


SUCCESSION = [  # those of recipes/reproductions/succession.yaml
    lane("fireweed", 0.02042, 0.95, 0.46, 384.6, 0.04, 0.0),
    lane("poplar", 0.05, 1.65, 0.7, 32.65, 0.5, 0.997),
    lane("spruce", 0.04106, 2.9, 0.95, 3.63, 0.9, 1.0),
]


def thinning(kernels, seed, **ecology):
    spruce = replace(lane("spruce", 0.04, 3.0, 0.1, 0.0, 0.0, 1.0), **ecology)
    parameters = MODEL.Parameters(kernels=kernels, initial_plants_per_ha=5000)
    history = list(simulate(MODEL, parameters, Site((100.0, 100.0)), [spruce], seed, steps=150))
    density = np.array([len(one) for one in history], float)
    fit = self_thinning_slope(density, np.array([np.mean(one.radius_m**3) for one in history]))
    return history, fit.value


def hopkins(population, site):
    return hopkins_index(population.position_m[:, :2], site.size_m, np.random.default_rng(0))


def test_a_cohort_thins_itself_along_the_line():
    history, slope = thinning("inhibition", 0)
    assert slope == pytest.approx(-1.5, abs=0.15)
    assert hopkins(history[10], Site((100.0, 100.0))) == pytest.approx(0.89, abs=0.05)  # nearly at random
    assert hopkins(history[95], Site((100.0, 100.0))) == pytest.approx(0.54, abs=0.05)  # and then apart


@pytest.mark.slow
@pytest.mark.parametrize("shade", [0.0, 0.5])
@pytest.mark.parametrize("kernels", ["inhibition", CONE, {"curve": [[0, 0], [2, 0], [2.01, 1]]}])
def test_self_thinning_whatever_the_inhibiting_kernel(kernels, shade):
    slopes = [thinning(kernels, seed, shade_tolerance=shade)[1] for seed in range(5)]
    print(kernels, shade, np.round(slopes, 3), np.mean(slopes).round(3))  # noqa: T201
    assert np.mean(slopes) == pytest.approx(-1.5, abs=0.12)


@pytest.mark.slow
def test_succession_of_lanes_species_by_a_cone():
    """Figure 4.5 and Table 7.1: plants 2688, 1593, 1409, 834 and H 0.6, 0.7, 0.7, 0.6 at steps 20, 150, 300, 1000."""
    site, steps = Site((105.0, 105.0)), (20, 150, 300, 1000)
    rows = []
    for seed in range(4):
        history = simulate(MODEL, MODEL.Parameters(kernels=CONE), site, SUCCESSION, seed, steps=1000)
        chosen = [one for one in history if one.step in steps]
        rows.append([[len(one), hopkins(one, site), *cover_by_species(one, site.area_m2).values()] for one in chosen])
    mean = np.mean(rows, axis=0)
    print(mean.round(3))  # noqa: T201
    assert mean[:, 2:].argmax(axis=1)[[0, 1, 3]].tolist() == [0, 1, 2]
    assert np.all(np.diff(mean[:, 2]) < 0)  # fireweed only loses
    assert np.all(np.diff(mean[:, 4]) > 0)  # spruce only gains
    np.testing.assert_allclose(mean[:, 0], [2688, 1593, 1409, 834], rtol=0.2)
    np.testing.assert_allclose(mean[:, 1], [0.6, 0.7, 0.7, 0.6], atol=0.15)


def test_inviting_kernels_make_clumps_and_inhibiting_ones_space():
    site, one = Site((40.0, 40.0)), lane("poplar", 0.04, 0.8, 0.2, 100.0, 0.0, 0.955)
    parent = {"curve": [[0, 0], [0.7, 0], [0.9, 5], [4, 1]]}

    def index(kernels):
        last = [
            list(simulate(MODEL, MODEL.Parameters(kernels=kernels), site, [one], seed, steps=120))[-1]
            for seed in range(3)
        ]
        assert min(map(len, last)) > 100
        return np.mean([hopkins(each, site) for each in last])

    h = {name: index(kernels) for name, kernels in (("parent", parent), ("neutral", "neutral"), ("cone", CONE))}
    print(h)  # noqa: T201
    assert h["parent"] > 1.4
    assert h["neutral"] == pytest.approx(1, abs=0.1)
    assert h["cone"] < 0.9


def test_the_strongest_kernel_makes_no_plants_and_overflows_nothing(tree):
    """Hundreds of overlapping invitations by a million; the rain bounds the number all the same."""
    site, one = Site((10.0, 10.0)), tree(seedlings_per_ha_per_yr=5000.0)
    parameters = MODEL.Parameters(kernels={"curve": 1e6, "reach": 15}, initial_plants_per_ha=20_000, cells=32)
    bound = MODEL.expected_plants(parameters, site, [one])
    counts = [[len(now) for now in simulate(MODEL, parameters, site, [one], seed, steps=20)] for seed in range(3)]
    assert counts[0][0] == 200
    assert np.mean(counts, axis=0).max() <= bound
    alone = MODEL.Parameters(kernels="neutral", initial_plants_per_ha=20_000, cells=32)
    neutral = [[len(now) for now in simulate(MODEL, alone, site, [one], seed, steps=20)] for seed in range(3)]
    assert np.mean(counts, axis=0)[-1] == pytest.approx(np.mean(neutral, axis=0)[-1], rel=0.1)


def test_a_crowd_lives_no_longer_than_its_bound(tree):
    """Steps that seedlings among each other live in the mean, against the model's own bound."""
    one = tree(shade_tolerance=0.7, seedlings_per_ha_per_yr=0.0)
    parameters = MODEL.Parameters(kernels=CONE, steps=1000, initial_plants_per_ha=40_000)
    site = Site((30.0, 30.0))
    lived = sum(len(now) for now in simulate(MODEL, parameters, site, [one], 0, steps=250))
    rain = tree(shade_tolerance=0.7, seedlings_per_ha_per_yr=1 / site.area_ha / parameters.step_yr)
    bound = MODEL.expected_plants(parameters, site, [rain]) - 3600  # of one seedling a step: the steps of a life
    assert 3 < lived / 3600 < bound < 200


def test_resumes_with_a_matrix_and_ground(nurses, columns_equal):
    parameters, site, species = nurses
    parameters = parameters.model_copy(update={"initial_plants_per_ha": 2000.0})
    state = MODEL.init(parameters, site, species, 6)
    for _ in range(3):
        state = MODEL.step(state)
    again = MODEL.resume(parameters, site, species, 6, MODEL.population(state))
    assert columns_equal(state.plants, again.plants)
    assert columns_equal(MODEL.step(state).plants, MODEL.step(again).plants)
    shown = MODEL.population(state)
    np.testing.assert_array_equal(shown.status == Status.DOMINATED, shown.columns["quality"] < 0.5)


def test_the_felled_free_those_that_they_held_down(tree):
    state = MODEL.init(MODEL.Parameters(kernels=CONE), Site((20.0, 20.0)), [tree()], 0)
    state = MODEL.plant(state, Planting(np.zeros(2, np.uint16), np.array([[5.0, 5], [6, 5]]), np.array([2.0, 0.5])))
    assert state.plants.quality.tolist() == pytest.approx([1, 1 / 3])
    assert MODEL.remove(state, state.plants.plant_id[:1]).plants.quality.tolist() == [1]


def test_barred_ground_and_no_species(tree):
    site = Site((20.0, 20.0))
    barred = MODEL.Parameters(keep_out=[[1, 1], [1, 1]], initial_plants_per_ha=100)
    assert "bar the whole site" in MODEL.empty_reason(barred, site, [tree()])
    assert [len(now) for now in simulate(MODEL, barred, site, [tree()], 0, steps=2)] == [0, 0, 0]
    assert [len(now) for now in simulate(MODEL, MODEL.Parameters(), site, [], 0, steps=2)] == [0, 0, 0]


def test_the_mean_of_the_ground_is_that_of_its_own_density(tree):
    """It is kept by content: for estimates no density is made twice, and no field at all."""
    site, species = Site((20.0, 30.0)), [tree(), tree(name="b")]
    grounds = [
        {"tree": {"map": [[1, 0.2], [0.3, 1]]}},
        {"tree": {"map": [[1, 0.2], [0.3, 0.5]]}},
        {"tree": {"map": {"rows": [[1, 0.2], [0.3, 1]], "invert": True}}, "b": {"map": [[0, 1]]}},
    ]
    for keep_out in (None, [[1, 0], [0, 0]]):
        for ground in grounds:
            parameters = MODEL.Parameters(ground=ground, keep_out=keep_out, cells=64)
            for _ in range(2):
                found = MODEL.init(parameters, site, species, 0).ground
                means = [1.0 if one is None else one.mean() for one in found.density]
                np.testing.assert_allclose(found.mean, means, rtol=1e-12)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"kernels": {"hopkins": 2}}, "a community that grows"),
        ({"kernels": {"tree": {"b": {"curve": [[0, 0], [1, 1]], "balanced": True}}}}, "not balanced"),
        ({"kernels": {"curve": [[0, -1], [1, 1]]}}, "never negative"),
        ({"most_inviting": 0.5}, "greater than or equal to 1"),
        ({"cells": 8}, "greater than or equal to 16"),
        ({"ground": {"tree": {"mapp": [[1]]}}}, "mapp"),
        ({"initial_plants_per_ha": -1}, "greater than or equal to 0"),
    ],
)
def test_bad_parameters(keys, message):
    with pytest.raises(ValidationError, match=message):
        MODEL.Parameters(**keys)


def test_every_species_that_is_named_is_told():
    parameters = MODEL.Parameters(kernels={"a": {"b": "inhibition"}, "c": "neutral"}, ground={"d": {}})
    assert set(parameters.named_species()) == {
        (("ground", "d"), "d"),
        (("kernels", "a"), "a"),
        (("kernels", "a", "b"), "b"),
        (("kernels", "c"), "c"),
    }


@pytest.mark.parametrize(
    ("kernels", "cells", "per_ha", "ground"),
    [(CONE, None, 20_000, {}), (BOTH, 600, 200, {"tree": {"map": [[0, 1], [1, 2]]}})],
)
def test_memory_is_bounded_by_its_estimate(tree, kernels, cells, per_ha, ground):
    site = Site((100.0, 100.0))
    one = tree(seedlings_per_ha_per_yr=2.0 * per_ha, shade_tolerance=1.0, old_age_survival=1.0)
    parameters = MODEL.Parameters(kernels=kernels, initial_plants_per_ha=per_ha, steps=1, cells=cells, ground=ground)
    list(simulate(MODEL, parameters, Site((10.0, 10.0)), [one], 0, steps=1))  # compiled and imported before
    tracemalloc.start()
    list(simulate(MODEL, parameters, site, [one], 0, steps=1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    estimate = MODEL.estimate_bytes(parameters, site, [one])
    print(peak, estimate)  # noqa: T201
    assert 0.15 * estimate < peak < estimate
