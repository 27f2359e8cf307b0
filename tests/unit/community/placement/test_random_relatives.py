"""Uniform places, clusters and repulsion, against theory and brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import chisquare, kstest

from forestgen.community.models import deformation_kernel, strauss, thomas, uniform
from forestgen.community.point_patterns import Window, ripley_k
from forestgen.community.population import Site

SITE = Site((30.0, 20.0))
WINDOW = Window(0, 30, 0, 20)


def place(module, tree, count, seed=1, site=SITE, **parameters):
    chosen = module.MODEL.Parameters(**{"plants": {"tree": {"count": count}}, **parameters})
    return module.MODEL.population(module.MODEL.init(chosen, site, [tree()], seed))


def pairs(at, radius, size_m=SITE.size_m):
    return len(cKDTree(at, boxsize=size_m).query_pairs(radius))


def test_uniform_places_are_uniform(tree):
    at = place(uniform, tree, 4000).position_m
    assert kstest(at[:, 0] / 30, "uniform").pvalue > 0.001
    assert kstest(at[:, 1] / 20, "uniform").pvalue > 0.001
    assert chisquare(np.histogram2d(at[:, 0], at[:, 1], (15, 10))[0].ravel()).pvalue > 0.001
    near = pairs(at[:, :2], 0.5)
    expected = 4000**2 / 2 * math.pi * 0.5**2 / 600
    assert abs(near - expected) < 4 * math.sqrt(expected)


def test_uniform_is_the_neutral_kernel(tree):
    """Two programs, the same places."""
    plants = {"tree": {"count": 300, "map": [[1, 3], [0, 2]]}}
    one = place(uniform, tree, 0, plants=plants, cells=128)
    other = place(deformation_kernel, tree, 0, plants=plants, cells=128, kernels="neutral")
    assert one.position_m == pytest.approx(other.position_m, abs=1e-9)


@pytest.mark.parametrize("periodic", [True, False])
def test_k_of_clusters_is_the_theorys(periodic, tree):
    """Mean K of 40 patterns of 1000 plants, 100 clusters, against theory with 4 standard errors and 2% more."""
    radii, sigma, kappa, n = np.array([0.2, 0.4, 0.8, 1.6, 3.0]), 0.5, 100 / 600, 1000
    runs = np.array([
        ripley_k(
            place(thomas, tree, n, seed, periodic=periodic, sigma_m=sigma, cells=32).position_m[:, :2],
            WINDOW,
            radii,
            "periodic" if periodic else "translation",
        )
        for seed in range(40)
    ])  # fmt: skip
    theory = math.pi * radii**2 + (1 - np.exp(-(radii**2) / (4 * sigma**2))) / kappa
    error = runs.std(axis=0, ddof=1) / math.sqrt(len(runs))
    assert np.all(np.abs(runs.mean(axis=0) - theory) < 4 * error + 0.02 * theory)
    assert np.all(theory > math.pi * radii**2 + 4 * error)  # which tells it from random places


def test_clusters_reach_the_edge_of_a_bounded_site(tree):
    """Parents also stand beyond the edges: a strip of 1 m along them has its share of the plants."""
    share = 1 - 28 * 18 / 600
    found = []
    for seed in range(60):
        at = place(thomas, tree, 200, seed, periodic=False, sigma_m=1.0, cells=16, plants_per_cluster=3.0).position_m
        found.append(np.mean(np.minimum(at[:, :2], np.array(SITE.size_m) - at[:, :2]).min(axis=1) < 1))
    assert np.mean(found) == pytest.approx(share, abs=4 * np.std(found) / math.sqrt(60))


def test_clusters_on_a_map_keep_to_it_in_the_mean(tree):
    plants = {"tree": {"count": 400, "map": {"rows": [[1, 3, 0]], "smooth": False}}}
    found = np.array([
        np.histogram(place(thomas, tree, 0, seed, plants=plants, sigma_m=0.6, cells=48).position_m[:, 0], 3, (0, 30))[0]
        for seed in range(40)
    ])  # fmt: skip
    error = found.std(axis=0, ddof=1) / math.sqrt(40)
    assert found.sum(axis=1).tolist() == [400] * 40
    assert np.all(np.abs(found.mean(axis=0) - [100, 300, 0]) <= 4 * error)


@pytest.mark.parametrize("periodic", [True, False])
def test_clusters_of_few_plants_and_of_tiny_ground(periodic, tree):
    for count in (1, 2, 9):
        assert len(place(thomas, tree, count, periodic=periodic, plants_per_cluster=1000.0)) == count
    spot = np.zeros((64, 96))
    spot[5, 7] = 1
    plants = {"tree": {"count": 50, "map": {"rows": spot.tolist(), "smooth": False}}}
    found = place(thomas, tree, 0, plants=plants, periodic=periodic, cells=96)
    assert len(found) == 50
    at = found.position_m[:, :2] * 96 / 30
    assert np.all((at >= (7, 58)) & (at <= (8, 59)))  # row 5 from the north


def chain(gamma, radius, n, density, runs, site, periodic, seed):
    """States of a Markov chain of n plants, two sweeps apart: (runs, n, 2)."""
    rng = np.random.default_rng(seed)
    parameters = strauss.StraussParameters(gamma=gamma, sweeps=2, periodic=periodic)
    at = rng.random((n, 2)) * site.size_m
    states = []
    for _ in range(runs):
        strauss.relax(at, density, site, parameters, radius, rng)
        states.append(at.copy())
    return np.array(states)


def near_pairs(states, radius, size_m, periodic):
    """(runs,) pairs nearer than the radius, all looked at."""
    step = np.abs(states[:, :, None] - states[:, None])
    if periodic:
        step = np.minimum(step, np.array(size_m) - step)
    near = np.sum((step**2).sum(axis=-1) < radius**2, axis=(1, 2))
    return (near - states.shape[1]) // 2


@pytest.mark.parametrize("gamma", [0.0, 0.3, 1.0])
def test_two_plants_are_near_as_often_as_theory_says(gamma):
    """On a torus P(near) = γ p / (1 - p + γ p) with p = π r² / area."""
    site, radius, runs = Site((3.0, 2.0)), 0.7, 4000
    p = math.pi * radius**2 / 6
    expected = gamma * p / (1 - p + gamma * p)
    states = chain(gamma, radius, 2, np.ones((8, 12)), runs, site, True, 1)[50:]
    found = np.mean(near_pairs(states, radius, site.size_m, True))
    assert found == pytest.approx(expected, abs=6 * math.sqrt(expected * (1 - expected) / runs))


@pytest.mark.parametrize("periodic", [True, False])
def test_three_plants_against_weighted_random_triples(periodic):
    """Numbers of near pairs, and of plants on the denser half, of a chain and of triples weighted by γ^s."""
    site, radius, gamma, runs = Site((3.0, 2.0)), 0.8, 0.25, 5000
    density = np.ones((8, 12))
    density[:, 6:] = 3.0
    rng = np.random.default_rng(2)
    triples = rng.random((200_000, 3, 2)) * (1.5, 2.0)
    triples[..., 0] += 1.5 * (rng.random((200_000, 3)) < 0.75)
    near = near_pairs(triples, radius, site.size_m, periodic)
    weight = gamma**near
    expected = np.bincount(near, weights=weight, minlength=4) / weight.sum()
    states = chain(gamma, radius, 3, density, runs, site, periodic, 3)[50:]
    found = np.bincount(near_pairs(states, radius, site.size_m, periodic), minlength=4) / len(states)
    assert np.all(np.abs(found - expected) < 8 * np.sqrt(expected * (1 - expected) / runs) + 1e-3)
    east = float(np.sum(weight * (triples[..., 0] > 1.5).mean(axis=1)) / weight.sum())
    assert abs(east - 0.75) > 0.03  # repulsion pushes plants off the denser half
    assert np.mean(states[..., 0] > 1.5) == pytest.approx(east, abs=0.015)


def test_close_pairs_dwindle_with_gamma(tree):

    def close(gamma, seed):
        found = place(strauss, tree, 300, seed, gamma=gamma, sweeps=60, cells=16)
        return pairs(found.position_m[:, :2], math.sqrt(0.5))

    means = [np.mean([close(gamma, seed) for seed in range(6)]) for gamma in (1.0, 0.5, 0.2, 0.05, 0.0)]
    random = 300**2 / 2 * math.pi * 0.5 / 600
    assert means[0] == pytest.approx(random, abs=4 * math.sqrt(random / 6))
    assert np.all(np.diff(means) < 0)
    assert means[-1] == 0


@pytest.mark.parametrize("periodic", [True, False])
def test_a_hard_core_is_hard(periodic, tree):
    found = place(strauss, tree, 300, gamma=0.0, interaction_radius_m=0.9, periodic=periodic, cells=16)
    assert len(found) == 300
    at = found.position_m[:, :2]
    assert cKDTree(at, boxsize=SITE.size_m if periodic else None).query(at, k=2)[0][:, 1].min() >= 0.9


def test_a_hard_core_that_does_not_fit_says_so(tree):
    found = place(strauss, tree, 300, gamma=0.0, interaction_radius_m=2.0, sweeps=30, cells=16)
    assert 60 < len(found) < 150
    assert found.notes[0].startswith(f"{len(found)} of 300 plants of tree were placed: as a hard core")
    assert pairs(found.position_m[:, :2], 1.999) == 0


def test_the_cells_of_the_search_change_nothing():
    """The radius decides how many cells there are; pairs are counted alike in one and in many, edges joined or not."""
    rng = np.random.default_rng(6)
    for size in ((3.0, 2.0), (9.0, 1.0)):
        site = Site(size)
        for periodic in (True, False):
            for radius in (0.2, 0.5, 0.95, 4.0):
                at = rng.random((40, 2)) * size
                hard = strauss.StraussParameters(gamma=0.0, sweeps=1, periodic=periodic)
                before = near_pairs(at[None], radius, size, periodic)[0]
                strauss.relax(at, np.ones((4, 6)), site, hard, radius, rng)
                assert near_pairs(at[None], radius, size, periodic)[0] <= before
