"""Lattices, discs and halftones: distances, one a cell, dots of grey."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import chisquare

from forestgen.community.models import halftone, height_field, jittered_grid, poisson_disc
from forestgen.community.models.halftone import diffuse, first_errors
from forestgen.community.point_patterns import Window, hopkins, measure_distances
from forestgen.community.population import Site

SITE = Site((30.0, 20.0))


def place(module, tree, count, seed=1, site=SITE, **parameters):
    chosen = module.MODEL.Parameters(**{"plants": {"tree": {"count": count}}, **parameters})
    return module.MODEL.population(module.MODEL.init(chosen, site, [tree()], seed))


def nearest(population, size_m, periodic):
    at = population.position_m[:, :2]
    return cKDTree(at, boxsize=size_m if periodic else None).query(at, k=2)[0][:, 1]


@pytest.mark.parametrize("jitter", [0.0, 0.5, 1.0])
def test_a_plant_in_each_cell(jitter, tree):
    """600 plants have cells of a square metre, each of them one plant, within its part of the cell."""
    at = place(jittered_grid, tree, 600, jitter=jitter).position_m[:, :2]
    cell = np.floor(at).astype(int)
    assert len({tuple(one) for one in cell.tolist()}) == 600
    offset = at - cell - 0.5
    assert np.abs(offset).max() <= jitter / 2 + 1e-9
    if jitter:
        assert chisquare(np.histogram(offset, 10, (-jitter / 2, jitter / 2))[0]).pvalue > 0.001


def test_cells_are_taken_in_proportion_to_the_density(tree):
    """A quarter of the site has four times the density of the rest: it is full, and a quarter of the others are."""
    plants = {"tree": {"count": 105, "map": {"rows": [[1, 4, 1, 1]], "smooth": False}}}
    found = np.zeros(4)
    for seed in range(20):
        x = place(jittered_grid, tree, 0, seed, plants=plants, jitter=1.0).position_m[:, 0]
        found += np.histogram(x, 4, (0, 30))[0]
    assert found / 20 == pytest.approx([15, 60, 15, 15], abs=4 * math.sqrt(15 * 0.75 / 20))
    finer = place(jittered_grid, tree, 0, plants=plants, jitter=0.0).position_m
    assert len(np.unique(np.round(finer[:, 1], 6))) > 10  # rows of a lattice that has 240 cells, not 105


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("given", [None, 0.4, 0.95])
def test_no_tree_nearer_than_the_distance(periodic, given, tree):
    found = place(height_field, tree, 600, periodic=periodic, min_distance_m=given, jitter=1.0)
    assert len(found) == 600
    assert nearest(found, SITE.size_m, periodic).min() >= (0.5 if given is None else given) - 1e-12


def test_trees_that_have_no_room_are_told(tree):
    found = place(height_field, tree, 600, min_distance_m=2.0)
    assert len(found) == 150
    assert found.notes[0].startswith("150 of 600 plants of tree were placed: ")
    assert nearest(found, SITE.size_m, True).min() >= 2.0


def test_moving_trees_use_their_cells(tree):
    """Jitter without a distance is uniform in the cell; with one, most trees have still left their vertices."""
    free = place(height_field, tree, 600, jitter=1.0, min_distance_m=0).position_m[:, :2] % 1.0
    assert chisquare(np.histogram(free, 10, (0, 1))[0]).pvalue > 0.001
    kept = place(height_field, tree, 600, jitter=1.0, min_distance_m=0.8).position_m[:, :2] % 1.0
    assert np.mean(np.abs(kept - 0.5).max(axis=1) > 1e-6) > 0.7


def test_the_ground_says_the_species_and_not_the_number(tree):
    """Densities 3 : 1 in the west and 1 : 3 in the east: even numbers of trees, and species at those odds."""
    plants = {
        "tree": {"count": 300, "map": {"rows": [[3, 1]], "smooth": False}},
        "b": {"count": 300, "map": {"rows": [[1, 3]], "smooth": False}},
    }
    west = np.zeros(2)
    model = height_field.MODEL
    for seed in range(10):
        parameters = model.Parameters(plants=plants)
        found = model.population(model.init(parameters, SITE, [tree(), tree(name="b")], seed))
        half = found.position_m[:, 0] < 15
        assert int(half.sum()) == 300
        west += np.bincount(found.species[half], minlength=2)
        assert np.bincount(found.species).tolist() == [300, 300]
    assert west / 10 == pytest.approx([225, 75], abs=4 * math.sqrt(300 * 0.25 * 0.75 / 10))


@pytest.mark.parametrize("periodic", [True, False])
def test_discs_do_not_meet_and_fill_the_site(periodic, tree):
    """Distance as given; and no point of the site is much farther than it from all of a full pattern."""
    rng = np.random.default_rng(3)
    for seed in range(3):
        points = poisson_disc.pattern((30.0, 20.0), 1.3, periodic, np.random.default_rng(seed))
        tree_of = cKDTree(points, boxsize=(30.0, 20.0) if periodic else None)
        assert tree_of.query(points, k=2)[0][:, 1].min() >= 1.3
        gap = tree_of.query(rng.random((20_000, 2)) * (30, 20))[0]
        assert np.mean(gap > 1.3) < 0.03


@pytest.mark.parametrize("periodic", [True, False])
def test_the_distance_found_is_the_greatest_or_nearly(periodic, tree):
    """All plants stand, and apart: 0.7 of the distance of as many in a triangular lattice, which none exceeds."""
    found = place(poisson_disc, tree, 200, periodic=periodic)
    assert len(found) == 200
    assert found.notes == ()
    assert nearest(found, SITE.size_m, periodic).min() > 0.68 * math.sqrt(2 / math.sqrt(3) * 600 / 200)


def test_a_given_distance_holds_fewer_or_more(tree):
    few = place(poisson_disc, tree, 500, distance_m=2.0)
    assert 80 < len(few) < 110
    assert few.notes[0].startswith(f"{len(few)} of 500 plants of tree were placed: no more fit at 2 m")
    assert nearest(few, SITE.size_m, True).min() >= 2.0
    everywhere = np.zeros((2, 3))
    for seed in range(6):  # a part of a full pattern, and not the blot around its first point
        at = place(poisson_disc, tree, 30, seed, distance_m=1.5).position_m
        everywhere += np.histogram2d(at[:, 1], at[:, 0], (2, 3), ((0, 20), (0, 30)))[0]
    assert chisquare(everywhere.ravel()).pvalue > 0.001


def plain_diffusion(expected, start, serpentine):
    """Error diffusion as the page says it, with lists."""
    rows, cols = expected.shape
    error = [list(start)] + [[0.0] * cols for _ in range(rows)]
    dots = np.zeros((rows, cols), int)
    for i in range(rows):
        order = range(cols - 1, -1, -1) if serpentine and i % 2 else range(cols)
        ahead = -1 if serpentine and i % 2 else 1
        for j in order:
            value = expected[i, j] + error[i][j]
            if expected[i, j] > 0:
                part = expected[i, j] % 1.0
                low = min(max(0.56 * min(part, 1 - part) ** (1 / 3), 0.05), 0.5)
                threshold = low if part < 0.5 else 1 - low
                dots[i, j] = max(0, math.floor(value - threshold) + 1)
            to = {(0, ahead): 7, (1, -ahead): 3, (1, 0): 5, (1, ahead): 1}
            to = {(a, b): w for (a, b), w in to.items() if 0 <= j + b < cols}
            for (a, b), w in to.items():
                error[i + a][j + b] += w * (value - dots[i, j]) / sum(to.values())
    return dots


@pytest.mark.parametrize("serpentine", [True, False])
def test_dots_as_by_hand(serpentine):
    rng = np.random.default_rng(4)
    for shape in ((1, 1), (1, 7), (9, 1), (12, 15)):
        for most in (0.2, 1.5, 4.0):
            expected = rng.random(shape) * most * (rng.random(shape) > 0.2)
            start = 0.5 * rng.random(shape[1]) - 0.25
            assert (
                diffuse(expected, start, serpentine).tolist() == plain_diffusion(expected, start, serpentine).tolist()
            )


@pytest.mark.parametrize("each", [0.02, 0.1, 0.3, 0.7, 1.0, 2.6])
@pytest.mark.parametrize("serpentine", [True, False])
def test_the_first_rows_have_as_many_dots_as_the_last(each, serpentine):
    """Floyd and Steinberg's threshold leaves the first rows empty: here eighths of the raster have their numbers."""
    rng, found = np.random.default_rng(5), np.zeros(8)
    for _ in range(20):
        raster = np.full((64, 96), each)
        dots = diffuse(raster, first_errors(raster, rng), serpentine)
        found += dots.reshape(8, -1).sum(axis=1) / 20
    expected = each * 64 * 96 / 8
    assert found == pytest.approx(np.full(8, expected), abs=max(0.07 * expected, 3))


def test_local_numbers_follow_the_density_closely(tree):
    """Plants in the 24 blocks of 5 x 5 m, of which a gradient expects 3 to 47: a fifth of the Poisson variance."""
    plants = {"tree": {"count": 600, "map": {"rows": [[0, 1, 2, 3, 4, 5]]}}}
    runs = []
    for seed in range(20):
        at = place(halftone, tree, 0, seed, plants=plants).position_m
        runs.append(np.histogram2d(at[:, 1], at[:, 0], (4, 6), ((0, 20), (0, 30)))[0])
    mean, variance = np.mean(runs, axis=0), np.var(runs, axis=0, ddof=1)
    assert np.mean(variance / mean) < 0.2
    halves = mean.sum(axis=0).reshape(3, 2).sum(axis=1) / 600
    assert halves == pytest.approx([1 / 15, 1 / 3, 3 / 5], abs=0.02)


def test_dots_keep_apart(tree):
    """Fewer than a fifth of the close pairs of random places, and a Hopkins index of regular patterns."""
    found = place(halftone, tree, 600)
    pairs = len(cKDTree(found.position_m[:, :2]).query_pairs(0.4))
    assert pairs < 0.2 * (600**2 / 2 * math.pi * 0.4**2 / 600)
    distances = measure_distances(found.position_m[:, :2], Window(0, 30, 0, 20), np.random.default_rng(0))
    assert hopkins(distances).value < 0.6


def test_the_first_row_is_like_the_others(tree):
    """Where the scan begins and next to nothing is expected, random errors must not become plants at once."""
    plants = {"tree": {"count": 600, "map": [[0.05, 0.05], [1, 1], [0.05, 0.05]]}}
    y = place(halftone, tree, 0, plants=plants).position_m[:, 1]
    assert np.sum(y < 0.5) < 10
    assert np.sum(y < 3) == pytest.approx(600 * 3 * 0.05 / (20 * (0.05 + (2 / 3) * 0.475)), abs=12)


def test_dots_stand_in_their_pixels(tree):
    at = place(halftone, tree, 200, pixels=60, jitter=0.0).position_m[:, :2]
    assert np.allclose(at % 0.5, 0.25)
    moved = place(halftone, tree, 200, pixels=60, jitter=0.6).position_m[:, :2] % 0.5 - 0.25
    assert 0.13 < np.abs(moved).max() <= 0.15 + 1e-9
