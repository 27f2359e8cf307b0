"""Indices from nearest distances: published values, limits, invariances, and errors that mean what they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from forestgen.community.point_patterns import (
    Window,
    clark_evans,
    clark_evans_donnelly,
    hopkins,
    hopkins_skellam,
    measure_distances,
    pattern_tree,
)
from forestgen.community.point_statistics import read_points

DATA = Path(__file__).parent / "data"
UNIT = Window(0.0, 1.0, 0.0, 1.0)


def rng(seed=0):
    return np.random.default_rng(seed)


def nearest_distances(points_m, window, *, periodic=False):
    tree, moved = pattern_tree(points_m, window, periodic)
    return tree.query(moved, k=2)[0][:, 1]


@pytest.mark.parametrize(
    ("name", "n", "naive", "donnelly"),
    [
        ("redwood", 62, 0.618650, 0.584991),
        ("cells", 42, 1.671680, 1.560426),
        ("japanesepines", 65, 1.064002, 1.007507),
    ],
)
def test_clark_evans_as_spatstat_gives_it(name, n, naive, donnelly):
    table = read_points(DATA / f"{name}.csv")
    nearest = nearest_distances(table.points_m, table.window)
    assert len(nearest) == n
    assert clark_evans(nearest, table.window).value == pytest.approx(naive, abs=5.1e-7)
    assert clark_evans_donnelly(nearest, table.window).value == pytest.approx(donnelly, abs=5.1e-7)


# spatstat's values are means of some draws of random points; so many draws make up their last digits.
@pytest.mark.parametrize(("name", "spatstat", "draws"), [("redwood", 0.186, 500), ("cells", 3.24, 100)])
def test_hopkins_skellam_as_spatstat_gives_it(name, spatstat, draws):
    table = read_points(DATA / f"{name}.csv")
    found = hopkins_skellam(measure_distances(table.points_m, table.window, rng()))
    tree, n = cKDTree(table.points_m), len(table.points_m)
    random = table.window.corner_m + rng(1).random((4000, n, 2))
    a2 = np.mean(tree.query(random.reshape(-1, 2))[0].reshape(4000, n) ** 2, axis=1)
    one_draw = np.mean(nearest_distances(table.points_m, table.window) ** 2) / a2
    assert found.value == pytest.approx(one_draw.mean(), abs=4 * one_draw.std() / np.sqrt(4000))
    assert found.value == pytest.approx(spatstat, abs=2 * one_draw.std() / np.sqrt(draws))


def test_the_points_of_the_window_hardly_scatter():
    table = read_points(DATA / "redwood.csv")
    values = [hopkins_skellam(measure_distances(table.points_m, table.window, rng(k))).value for k in range(10)]
    assert np.std(values) < 0.002 * np.mean(values)


def test_each_index_tells_clusters_from_cells():
    for name, sign in (("redwood", 1), ("cells", -1)):
        table = read_points(DATA / f"{name}.csv")
        distances = measure_distances(table.points_m, table.window, rng())
        h, a = hopkins(distances), hopkins_skellam(distances)
        r = clark_evans_donnelly(distances.from_points_m, table.window)
        assert sign * (h.value - 1) > 3 * h.error
        assert sign * (1 - a.value) > 3 * a.error
        assert sign * (1 - r.value) > 3 * r.error


@pytest.mark.parametrize("n", [60, 400])
def test_random_points_have_indices_of_one_and_errors_that_match_their_scatter(n):
    window, seeds = Window(-3.0, 7.0, 2.0, 6.0), 300
    found = []
    for seed in range(seeds):
        stream = rng(seed)
        points = window.corner_m + stream.random((n, 2)) * window.size_m
        distances = measure_distances(points, window, stream, samples=2000)
        donnelly = clark_evans_donnelly(distances.from_points_m, window)
        found.append((hopkins(distances), hopkins_skellam(distances), donnelly))
    values, errors = np.moveaxis(np.array(found), 2, 0)
    scatter = values.std(axis=0)
    # Hopkins-Skellam is a ratio of squares: its mean lies above 1 by terms of 1/n.
    for index, bias in ((0, 0.0), (1, 4 / n), (2, 0.0)):
        assert values[:, index].mean() == pytest.approx(1.0, abs=4 * scatter[index] / np.sqrt(seeds) + bias)
        # The scatter of 300 values is itself known to 4%; the jackknife is a little low for few points.
        assert np.median(errors[:, index]) == pytest.approx(scatter[index], rel=0.2)


def test_the_error_of_clusters_counts_clusters_not_points():
    values, errors = [], []
    for seed in range(100):
        stream = rng(seed)
        parents = stream.random((40, 2))
        points = np.mod(np.repeat(parents, 15, axis=0) + stream.normal(0, 0.02, (600, 2)), 1.0)
        value, error = hopkins(measure_distances(points, UNIT, stream, samples=2000))
        values.append(value)
        errors.append(error)
    assert np.mean(values) > 2
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.3)


def test_periodic_edges_take_the_bias_of_edges_away():
    naive, periodic = [], []
    for seed in range(300):
        points = rng(seed).random((50, 2))
        naive.append(clark_evans(nearest_distances(points, UNIT), UNIT).value)
        periodic.append(clark_evans(nearest_distances(points, UNIT, periodic=True), UNIT).value)
    assert np.mean(naive) > 1.05
    assert np.mean(periodic) == pytest.approx(1.0, abs=4 * np.std(periodic) / np.sqrt(300))


def test_a_lattice_on_a_torus_is_exact():
    k = np.arange(20) + 0.5
    lattice = np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2)
    window = Window(0.0, 20.0, 0.0, 20.0)
    nearest = nearest_distances(lattice, window, periodic=True)
    assert clark_evans(nearest, window).value == pytest.approx(2.0)
    distances = measure_distances(lattice, window, rng())  # no edge matters: each cell has its point
    # Mean distance from a point of a unit square to its middle, over the lattice's spacing of 1.
    assert hopkins(distances).value == pytest.approx((np.sqrt(2) + np.log(1 + np.sqrt(2))) / 6, rel=0.005)
    # Mean square: 1/6; so many points leave the mean of reciprocals as it is but for a term of 1/n.
    assert hopkins_skellam(distances).value == pytest.approx(6.0, rel=0.01)


@given(
    seed=st.integers(0, 2**32 - 1),
    factor=st.floats(1e-3, 1e3),
    shift=st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
)
@settings(max_examples=25, deadline=None)
def test_indices_have_no_unit_and_no_place(seed, factor, shift):
    points = rng(seed).random((50, 2)) * (2.0, 1.0)
    here = Window(0.0, 2.0, 0.0, 1.0)
    moved = points * factor + np.array(shift) * factor
    x, y = np.array(shift) * factor
    there = Window(x, x + 2 * factor, y, y + factor)
    one = measure_distances(points, here, rng(), samples=500)
    other = measure_distances(moved, there, rng(), samples=500)
    assert hopkins(other) == pytest.approx(hopkins(one), rel=1e-6)
    assert hopkins_skellam(other) == pytest.approx(hopkins_skellam(one), rel=1e-6)
    assert clark_evans_donnelly(other.from_points_m, there) == pytest.approx(
        clark_evans_donnelly(one.from_points_m, here), rel=1e-6
    )


def test_the_same_stream_gives_the_same_numbers():
    points = rng().random((100, 2))
    one, other = (hopkins(measure_distances(points, UNIT, rng(5))) for _ in range(2))
    assert one == other


def test_few_points_have_a_value_and_no_error():
    value, error = hopkins(measure_distances(np.array([[0.2, 0.5], [0.8, 0.5]]), UNIT, rng()))
    assert 0 < value < 1
    assert np.isnan(error)


def test_twins_everywhere_make_hopkins_infinite():
    twins = np.repeat(rng().random((30, 2)), 2, axis=0)
    value, error = hopkins(measure_distances(twins, UNIT, rng()))
    assert value == np.inf
    assert np.isnan(error)
    assert hopkins_skellam(measure_distances(twins, UNIT, rng())).value == 0.0


@pytest.mark.parametrize("bounds", [(1, 0, 0, 1), (0, 1, 2, 2), (0, np.nan, 0, 1), (0, np.inf, 0, 1)])
def test_windows_that_are_none(bounds):
    with pytest.raises(ValueError, match="a window must have finite"):
        Window(*bounds)


def test_the_edge_belongs_to_the_window():
    inside = UNIT.outside(np.array([[0.0, 1.0], [1.0, 1.0], [1.1, 0.5], [0.5, -0.1]]))
    assert inside.tolist() == [False, False, True, True]
