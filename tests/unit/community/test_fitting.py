"""Fits of deformation kernels: the likelihood against the model itself, the counts, and stands that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist, pdist

from forestgen.community.fitting.fit import ROUNDS, Matcher, Round, climb, fit_stand, match_founders, refine
from forestgen.community.fitting.likelihood import (
    KernelShapes,
    default_reach_m,
    founder_shapes,
    kernel_shapes,
    likeliest,
    roughness_penalty,
    score,
)
from forestgen.community.fitting.report import recipe_text, species_sources
from forestgen.community.fitting.stand import (
    STANDS,
    MeasuredStand,
    Nursery,
    cross_k,
    envelopes,
    functions_for,
    measured_stand,
    rounding_m,
    summaries_for,
)
from forestgen.community.placement.field import DensityField
from forestgen.community.placement.kernels import KernelSection, KernelTable, table
from forestgen.community.point_patterns import Window, ripley_k
from forestgen.community.point_statistics import read_points
from forestgen.core.randomness import child_rng

DATA = Path(__file__).parent / "data"


def stand_of(position_m, size_m, species=None, names=("a",), **more) -> MeasuredStand:
    species = np.zeros(len(position_m), dtype=np.int64) if species is None else species
    return MeasuredStand(position_m, species, names, size_m, more.pop("radius_m", None), **more)


def two_species(rng, n=24, size_m=(12.0, 8.0)) -> MeasuredStand:
    return stand_of(rng.random((n, 2)) * size_m, size_m, rng.permutation(np.arange(n) % 2), ("a", "b"))


def metres(curve) -> KernelTable:
    return table(KernelSection.model_validate({"curve": curve, "distance": "metres"}))


def score_of(stand: MeasuredStand, shapes: KernelShapes, log_kappa, grid):
    return score(stand.position_m, stand.species, shapes, shapes.core_m, log_kappa, stand.size_m, grid)


# --- likelihood


def test_the_likelihood_is_that_of_the_models_own_fields():
    """A product of each plant's density in the field that those before it have deformed, by `DensityField` itself."""
    rng = np.random.default_rng(1)
    stand, grid = two_species(rng), (32, 48)
    shapes = kernel_shapes(stand, 2.0)
    log_kappa = rng.normal(0.0, 0.4, shapes.free)

    def exact(kernel):  # as the likelihood reads it: exponentials between knots, no rounding of control points
        at = np.linspace(0.0, 2.0, 1025)
        values = np.exp(np.interp(at, shapes.knots_m[kernel], np.append(log_kappa[kernel], 0.0)))
        return KernelTable(np.where(at < shapes.core_m[kernel], 0.0, values), 2.0, in_radii=False)

    kernels = [[exact(k) for k in row] for row in shapes.kernel_of]
    fields = [DensityField(np.ones(grid), stand.size_m, periodic=False) for _ in stand.names]
    expected = 0.0
    for k in range(stand.n):
        mine = stand.species[k]
        for j in range(k):
            distance = math.dist(stand.position_m[j], stand.position_m[k])
            expected += math.log(float(kernels[mine][stand.species[j]](np.array(distance), 1.0)))
        expected -= math.log(fields[mine].total / (grid[0] * grid[1]))
        for i, field in enumerate(fields):
            field.deform(stand.position_m[k : k + 1], np.ones(1), kernels[i][mine])
    assert score_of(stand, shapes, log_kappa, grid).log_likelihood == pytest.approx(expected, abs=2e-3)


def test_its_gradient_is_that_of_differences_for_more_plants_than_sums_are_mended_after():
    rng = np.random.default_rng(2)
    stand = two_species(rng, n=90)
    shapes = kernel_shapes(stand, 2.0)
    log_kappa = rng.normal(0.0, 0.3, shapes.free)
    found = score_of(stand, shapes, log_kappa, (24, 36)).gradient
    for at in [(0, 0), (0, 13), (1, 5), (2, 9)]:
        step = np.zeros(shapes.free)
        step[at] = 1e-5
        above, below = (score_of(stand, shapes, log_kappa + s * step, (24, 36)).log_likelihood for s in (1, -1))
        assert found[at] == pytest.approx((above - below) / 2e-5, abs=1e-5)


def test_its_gradient_is_nought_on_average_over_stands_that_the_model_places():
    """True of no other density than the one that `place` draws from; another kernel's stands show it at once."""
    rng = np.random.default_rng(3)
    stand = stand_of(rng.random((20, 2)) * 6, (6.0, 6.0))
    shapes = replace(kernel_shapes(stand, 1.5), core_m=np.zeros(1))
    log_kappa = np.linspace(-1.5, 0.8, shapes.free[1])[None]
    nursery = Nursery(stand, 48)

    def gradients(kernels):
        new = [nursery.grow(kernels, 7, k) for k in range(60)]
        return np.array(
            [
                score_of(
                    replace(stand, position_m=one.placed_m, species=one.species), shapes, log_kappa, (48, 48)
                ).gradient
                for one in new
            ]
        )[:, 0, 3:]  # fmt: skip - hardly any plants stand closer than the third knot

    own = gradients(shapes.tables(log_kappa))
    assert np.abs(own.mean(axis=0) / own.std(axis=0) * math.sqrt(len(own))).max() < 3.5
    neutral = gradients(shapes.tables(0 * log_kappa))
    assert np.abs(neutral.mean(axis=0) / neutral.std(axis=0) * math.sqrt(len(neutral))).max() > 5


def test_so_is_that_of_founders_and_those_that_follow_them():
    """The derivative by which founders' kernels are fitted; taken the other way round, it is not."""
    rng = np.random.default_rng(3)
    stand = stand_of(rng.random((24, 2)) * 6, (6.0, 6.0))
    shapes = founder_shapes(replace(kernel_shapes(stand, 1.5), core_m=np.zeros(1)))
    log_kappa = np.zeros(shapes.free)
    log_kappa[0], log_kappa[1, :8], log_kappa[2] = -1.0, 2.0, -0.3
    nursery = Nursery(stand, 48, founders=8)
    new = [nursery.grow(shapes.tables(log_kappa), 7, k) for k in range(60)]
    assert all(one.kind.tolist() == [0] * 8 + [1] * 16 for one in new)

    def z(turned):
        grads = [
            score_of(replace(stand, position_m=one.placed_m[turned], species=one.kind), shapes, log_kappa, (48, 48))
            for one in new
        ]
        values = np.array([one.gradient for one in grads])[:, :, 3:]
        return np.abs(values.mean(axis=0) / values.std(axis=0) * math.sqrt(len(values))).max(axis=1)

    assert z(np.arange(24)).max() < 3.7
    assert z(np.arange(24)[::-1]).max() > 8


def test_the_likeliest_kernel_of_random_plants_is_nearly_neutral_and_of_a_lattice_is_not(monkeypatch):
    monkeypatch.setattr("forestgen.community.fitting.likelihood._PLANTS_IN_ALL", 800)
    rng = np.random.default_rng(4)
    even = stand_of(rng.random((100, 2)) * 10, (10.0, 10.0))
    shapes = kernel_shapes(even, 1.5)
    kappa = np.exp(likeliest(even, shapes, np.random.default_rng(0))[0])
    assert np.all((kappa[4:] > 0.6) & (kappa[4:] < 1.6))
    lattice = np.stack(np.meshgrid(np.arange(10), np.arange(10)), axis=-1).reshape(-1, 2) + 0.5
    stand = stand_of(lattice + rng.normal(0, 0.1, lattice.shape), (10.0, 10.0))
    shapes = kernel_shapes(stand, 1.5)
    kappa = np.exp(likeliest(stand, shapes, np.random.default_rng(0))[0])
    assert shapes.core_m[0] > 0.4
    assert kappa[shapes.knots_m[0, :-1] < 0.7].max(initial=0.0) < 0.5 < kappa.max()


def test_the_penalty_is_nought_for_a_neutral_kernel_only():
    shapes = kernel_shapes(stand_of(np.random.default_rng(0).random((30, 2)), (1.0, 1.0)), None)
    penalty = roughness_penalty(shapes)
    assert np.linalg.eigvalsh(penalty).min() > 0


# --- what is counted


def test_counts_against_all_distances():
    stand = two_species(np.random.default_rng(5), n=40)
    summaries = summaries_for(stand, 2.0)
    found = summaries.of(stand.position_m, stand.species)
    a, b = stand.of(0), stand.of(1)
    radii = summaries.pair_radii_m
    within = [np.array([np.sum(d <= r) for r in radii]) for d in (pdist(a), cdist(a, b).ravel(), pdist(b))]
    pairs = [np.sqrt(np.append(one, np.diff(one[4::5], prepend=0))) for one in within]
    own = [cdist(one, one) + np.diag(np.full(len(one), np.inf)) for one in (a, b)]
    near = [one.min(axis=1) for one in (own[0], cdist(a, b), cdist(b, a), own[1])]
    shares = [np.array([np.mean(d <= r) for r in summaries.near_radii_m[k]]) for k, d in enumerate(near)]
    assert np.allclose(found, np.concatenate([*pairs, *shares]))
    assert len(found) == len(summaries.worth)


def test_k_is_ripleys_and_of_two_species_that_of_their_mixture():
    stand = two_species(np.random.default_rng(6), n=60)
    window, radii = Window(0.0, 12.0, 0.0, 8.0), np.linspace(0.2, 2.0, 10)
    trees = [cKDTree(one) for one in (stand.position_m, stand.of(0), stand.of(1))]
    whole = cross_k(trees[0], trees[0], radii, stand.size_m)
    assert np.allclose(whole, ripley_k(stand.position_m, window, radii, "translation"))
    # n (n - 1) K is the sum over pairs of species of n_i n_j K_ij (n_i (n_i - 1) K_ii)
    parts = [30 * 29 * cross_k(t, t, radii, stand.size_m) for t in trees[1:]]
    across = 2 * 30 * 30 * cross_k(trees[1], trees[2], radii, stand.size_m)
    assert np.allclose(sum(parts) + across, 60 * 59 * whole)


@pytest.mark.parametrize(("name", "step"), [("redwood", 0.02), ("japanesepines", 0.01), ("cells", 0.0)])
def test_rounded_coordinates_are_noticed(name, step):
    points = read_points(DATA / f"{name}.csv").points_m
    assert rounding_m(points, 1 / math.sqrt(len(points))) == step


def test_new_stands_are_rounded_as_the_stand_was_in_the_files_own_coordinates():
    points = np.array([[0.5, 0.5], [1.24, 3.77], [0.01, 3.99]])
    stand = stand_of(points, (4.0, 4.0), corner_m=(0.1, -2.0), step_m=0.5)
    assert np.allclose(stand.as_measured(points), [[0.4, 0.5], [1.4, 4.0], [0.0, 4.0]])
    blurred = np.array([stand.blurred(np.random.default_rng(k)) for k in range(200)])
    assert np.abs(blurred - points).max() <= 0.25
    assert blurred.min() >= 0


# --- kernels


def test_kernels_are_symmetric_where_no_size_gives_an_order():
    rng = np.random.default_rng(7)
    stand = two_species(rng)
    shapes = kernel_shapes(stand, None)
    assert np.array_equal(shapes.kernel_of, shapes.kernel_of.T)
    assert shapes.free[0] == 3
    assert shapes.reach_m == default_reach_m(stand) == 2.0
    sized = replace(stand, radius_m=np.linspace(2.0, 1.0, stand.n))
    assert sorted(kernel_shapes(sized, None).kernel_of.ravel().tolist()) == [0, 1, 2, 3]


def test_a_hard_core_is_found_in_the_cells_and_written_down():
    stand, _ = measured_stand(read_points(DATA / "cells.csv"), "cells")
    shapes = kernel_shapes(stand, None)
    least = pdist(stand.position_m).min()
    assert 0.97 * least < shapes.core_m[0] < least
    kernel = shapes.tables(np.full(shapes.free, math.log(2.0)))[0][0]
    inside = kernel(np.array([0.0, 0.5 * least, 0.94 * least]), 1.0)
    assert inside.tolist() == [0.0, 0.0, 0.0]
    assert kernel(np.array([0.12, 0.2]), 1.0) == pytest.approx([2.0, 2.0], rel=1e-3)
    assert kernel(np.array([0.26]), 1.0) == 1.0


def test_control_points_follow_the_exponentials_between_the_knots():
    shapes = kernel_shapes(stand_of(np.random.default_rng(0).random((30, 2)), (1.0, 1.0)), None)
    log_kappa = np.random.default_rng(1).normal(0.0, 0.5, shapes.free)
    kernel = shapes.tables(log_kappa)[0][0]
    at = np.linspace(0.02, 0.249, 300)
    exact = np.exp(np.interp(at, shapes.knots_m[0], np.append(log_kappa[0], 0.0)))
    assert kernel(at, 1.0) == pytest.approx(exact, rel=0.05)


# --- founders


@pytest.fixture(scope="module")
def founded():
    """Sixty plants: twelve that keep apart, and those that are drawn to them."""
    blank = stand_of(np.zeros((60, 2)), (10.0, 10.0))
    apart, drawn = metres([[0, 0], [1.5, 0], [1.51, 1]]), metres([[0, 300], [0.5, 300], [0.8, 1]])
    return Nursery(blank, 96, founders=12).grow([[apart, drawn], [drawn, metres([[0, 1], [1, 1]])]], 0, 0)


def test_founders_come_first_and_keep_apart_and_the_others_stand_with_them(founded):
    founders, others = founded.placed_m[:12], founded.placed_m[12:]
    assert pdist(founders).min() > 1.4
    assert np.mean(cdist(others, founders).min(axis=1) < 0.9) > 0.9
    assert set(founded.species) == {0}  # what is measured knows of no founders
    assert founded.kind.tolist() == [0] * 12 + [1] * 48


def test_one_more_new_stand_is_tested_as_the_measured_one():
    stand, _ = measured_stand(read_points(DATA / "redwood.csv"), "redwood")
    nursery, shapes = Nursery(stand, 64), kernel_shapes(stand, None)
    kernels = shapes.tables(np.zeros(shapes.free))
    more = nursery.grow(kernels, 3, STANDS)
    as_measured = envelopes(nursery, kernels, 3)
    turned = envelopes(replace(nursery, stand=replace(stand, position_m=more.measured_m)), kernels, 3)
    same = turned[0]  # K's radii hang on the window alone
    assert np.allclose(same.stand, as_measured[0].own)
    assert np.array_equal(same.left, as_measured[0].own_left)


def test_founders_are_kept_only_where_they_halve_the_loss(founded, monkeypatch):
    monkeypatch.setattr("forestgen.community.fitting.fit._PLANTS_OF_A_FOUNDER", (4.5,))
    monkeypatch.setattr("forestgen.community.fitting.likelihood._PLANTS_IN_ALL", 400)
    rounds = (Round(1.0, 5, 2.0), Round(1.0, 4, 1.0))
    monkeypatch.setattr("forestgen.community.fitting.fit.ROUNDS", rounds)
    stand = stand_of(founded.placed_m, (10.0, 10.0))
    shapes = kernel_shapes(stand, None)
    matcher = Matcher(Nursery(stand, 64), shapes, summaries_for(stand, shapes.reach_m), 25, 1)
    start = likeliest(stand, shapes, np.random.default_rng(0))
    one = refine(matcher, climb(matcher, start, rounds[0], lambda _: None), lambda _: None)
    found = match_founders(matcher, one, lambda _: None)
    assert found is not None
    of_founders, matched = found
    assert of_founders.nursery.founders == 13
    assert matched.loss <= 0.5 * one.loss
    kappa = np.exp(matched.log_kappa)  # among founders, of them on followers, among followers
    near = shapes.knots_m[0, :-1] < 0.5
    assert kappa[0, near].max() < 0.6
    assert kappa[1, near].min() > 8
    assert 0.4 < kappa[2].min() < kappa[2].max() < 2.5
    monkeypatch.setattr("forestgen.community.fitting.fit.ROUNDS", (Round(0.2, 1, 2.0), Round(0.2, 1, 1.0)))
    assert match_founders(matcher, replace(one, rough_loss=1.0), lambda _: None) is None
    content = replace(one, rough_loss=math.inf, loss=1.0)
    assert match_founders(matcher, content, lambda _: None) is None


# --- the whole


@pytest.fixture(scope="module")
def small_fit():
    stand, _ = measured_stand(read_points(DATA / "cells.csv"), "cells")
    return fit_stand(stand, seed=3, stands=40)


def test_a_fit_brings_new_stands_nearer(small_fit):
    stand, shapes = small_fit.stand, small_fit.shapes
    matcher = Matcher(small_fit.nursery, shapes, summaries_for(stand, shapes.reach_m), 40, 3)
    matcher.begin(ROUNDS[0])
    start = likeliest(stand, shapes, child_rng(3, "fit", "orders"))
    assert small_fit.matched.loss < 0.7 * matcher.look(start.ravel()).loss
    near = small_fit.matched.differences
    assert np.abs(near).max() < 2.2
    assert np.mean(np.abs(near)) < 0.7


def test_the_cells_lie_within_the_envelopes_and_not_within_those_of_random_stands(small_fit):
    assert small_fit.held("K") == 1
    neutral = small_fit.shapes.tables(np.zeros(small_fit.shapes.free))
    open_kernels = [[replace(neutral[0][0], values=np.ones(1025))]]
    random = envelopes(small_fit.nursery, open_kernels, 5)
    assert all(one.left.any() for one in random)


def test_the_same_stand_and_seed_give_the_same_recipe(small_fit):
    fits = [fit_stand(small_fit.stand, seed=seed, stands=6, founders=False) for seed in (3, 3, 4)]
    text = [recipe_text(one, {"poplar": "poplar"}, "cells.csv") for one in fits]
    assert text[0] == text[1]
    assert text[0].split("kernels")[-1] != text[2].split("kernels")[-1]


def test_species_of_the_library_keep_their_names():
    stand = two_species(np.random.default_rng(0))
    named = replace(stand, names=("spruce", "Fagus sylvatica, old"))
    assert species_sources(named, {"spruce", "poplar"}, "poplar") == {
        "spruce": "spruce", "Fagus-sylvatica-old": "poplar"
    }  # fmt: skip
    assert species_sources(replace(stand, names=("é", "ü")), {"poplar"}, "poplar") == {
        "species": "poplar", "species-2": "poplar"
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "nearest"), [("redwood", 16), ("cells", 10), ("japanesepines", 5)])
def test_reference_stands_lie_within_the_envelopes(name, nearest):
    """Pairs, and nearest neighbours about as often as those of a perfect model are (docs/fitting.md)."""
    stand, _ = measured_stand(read_points(DATA / f"{name}.csv"), name)
    fit = fit_stand(stand, checks=20)
    assert fit.held("K") >= 17
    assert fit.held("G") >= nearest
    assert not any(one.left.any() for one in fit.checks[0] if one.name == "K")
    assert (fit.nursery.founders > 0) == (name == "redwood")


@pytest.mark.slow
def test_a_known_kernel_is_found_again():
    """Not to the letter, for a stand of 150 plants tells only so much: by what it does to new stands."""
    known = metres([[0, 0], [0.6, 0.0], [0.8, 1.8], [1.4, 1.5], [2.2, 1]])
    blank = stand_of(np.zeros((150, 2)), (16.0, 16.0))
    nursery = Nursery(blank, 128)
    first = nursery.grow([[known]], 11, 0)
    stand = stand_of(first.placed_m, (16.0, 16.0))
    fit = fit_stand(stand)
    functions = functions_for(stand)
    effect = [
        np.array([functions.of(one.placed_m, one.species) for one in (nursery.grow(kernels, 12, k) for k in range(60))])
        for kernels in ([[known]], fit.kernels)
    ]
    gap = np.abs(effect[0].mean(axis=0) - effect[1].mean(axis=0)) / np.maximum(effect[0].std(axis=0), 1e-3)
    assert gap.max() < 2.5
    assert 0.5 < fit.shapes.core_m[0] < 0.75


@pytest.mark.slow
def test_attraction_and_repulsion_between_species_are_found():
    spruce, birch = metres([[0, 0], [1.5, 0], [3, 1]]), metres([[0, 0.3], [1, 2], [3, 1.6], [5, 1]])
    for across, sign in ((metres([[0, 0], [2, 0.1], [6, 1]]), -1), (metres([[0, 3], [3, 2.5], [5, 1]]), 1)):
        rng = np.random.default_rng(5)
        blank = stand_of(np.zeros((120, 2)), (50.0, 40.0), rng.permutation(np.arange(120) % 2), ("spruce", "birch"))
        new = Nursery(blank, 150).grow([[spruce, across], [across, birch]], 1, 0)
        stand = replace(blank, position_m=new.placed_m, species=new.species)
        fit = fit_stand(stand, stands=80)
        near = fit.kernels[0][1](np.linspace(1.0, 4.0, 61), 1.0)
        assert sign * math.log(near.mean()) > 0.3
        assert float(fit.kernels[0][0](np.array(1.0), 1.0)) < 0.3
        assert sum(one.left.any() for one in fit.checks[0]) <= 2
