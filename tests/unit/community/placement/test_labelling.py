"""One pattern for all species: who gets which place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.community.placement.densities import PlacementParameters
from forestgen.community.placement.labelling import assign, choose, inclusion, label, lattice, lattice_shape
from forestgen.community.placement.model import PlantingTargets, stays_apart

seeds = st.integers(0, 2**32)


@given(st.lists(st.sampled_from([0.0, 1e-9, 0.3, 1.0, 2.0, 50.0]), min_size=1, max_size=40), st.integers(0, 45), seeds)
def test_as_many_different_places_as_asked_or_as_there_are(weight, n, seed):
    weight = np.array(weight)
    chosen = choose(weight, n, np.random.default_rng(seed))
    assert len(chosen) == len(set(chosen.tolist())) == min(n, np.count_nonzero(weight))
    assert np.all(weight[chosen] > 0)
    assert inclusion(weight, n).sum() == pytest.approx(len(chosen))


def test_each_place_is_chosen_with_its_probability():
    """Weights 1 to 6 and a large one, which is always in: 3 of the rest in proportion to their weights."""
    weight, rng, runs = np.array([1.0, 2, 3, 4, 5, 6, 100]), np.random.default_rng(1), 6000
    found = np.zeros(7)
    for _ in range(runs):
        found[choose(weight, 4, rng)] += 1
    expected = np.append(3 * weight[:6] / 21, 1.0)
    assert inclusion(weight, 4) == pytest.approx(expected)
    assert np.all(np.abs(found / runs - expected) <= 4 * np.sqrt(expected * (1 - expected) / runs))


def test_equal_weights_are_a_random_subset():
    """All 20 triples of 6 equally often: chi-square of 19 degrees of freedom below its 99.9 percentile."""
    rng, runs = np.random.default_rng(2), 6000
    number: dict[tuple[int, ...], int] = {}
    for _ in range(runs):
        triple = tuple(sorted(choose(np.ones(6), 3, rng).tolist()))
        number[triple] = number.get(triple, 0) + 1
    assert len(number) == 20
    assert sum((n - runs / 20) ** 2 / (runs / 20) for n in number.values()) < 43.8


@settings(deadline=None)
@given(st.integers(1, 5), st.integers(0, 60), seeds)
def test_species_have_their_numbers_and_only_places_that_suit_them(species, n, seed):
    rng = np.random.default_rng(seed)
    weight = rng.random((species, n)) * (rng.random((species, n)) < 0.7)
    # Numbers that can be had: each place's label drawn among those that suit it.
    possible = [int(rng.choice(np.flatnonzero(column))) for column in weight.T if column.any()]
    counts = np.bincount(np.array(possible, dtype=np.int64), minlength=species)
    labels = label(weight, counts, rng)
    assert np.bincount(labels[labels >= 0], minlength=species).tolist() == counts.tolist()
    assert all(weight[one, place] > 0 for place, one in enumerate(labels) if one >= 0)
    assert np.all((labels >= 0) == weight.any(axis=0))


def test_labels_have_the_odds_of_the_weights():
    """Odds between species at a place are those of the weights, times a factor that is the same everywhere."""
    weight = np.repeat(np.array([[3.0, 1.0, 1.0], [1.0, 1.0, 4.0]]), 400, axis=1)
    rng, found = np.random.default_rng(3), np.zeros((2, 3))
    for _ in range(60):
        labels = label(weight, np.array([500, 700]), rng)
        for one in range(2):
            found[one] += (labels == one).reshape(3, 400).sum(axis=1)
    odds = found[0] / found[1]
    assert odds / odds[1] == pytest.approx([3.0, 1.0, 0.25], rel=0.08)
    assert found.sum(axis=1).tolist() == [30_000, 42_000]


def test_a_surplus_goes_by_way_of_a_species_between():
    """Places suit a and b, or b and c. Whatever is drawn first, c can only get places from b, and b from a."""
    weight = np.zeros((3, 60))
    weight[:2, :40] = [[1e6], [1e-6]]  # nearly surely a
    weight[1:, 40:] = [[1e6], [1e-6]]  # nearly surely b
    labels = label(weight, np.array([10, 30, 20]), np.random.default_rng(4))
    assert np.bincount(labels).tolist() == [10, 30, 20]
    assert set(labels[40:].tolist()) == {2}


def test_places_that_nobody_may_take_stay_empty():
    weight = np.array([[1.0] * 10, [0.0] * 8 + [1.0] * 2])
    labels = label(weight, np.array([4, 6]), np.random.default_rng(5))
    assert np.sum(labels == 0) == 4
    assert np.sum(labels == 1) == 2
    assert np.sum(labels == -1) == 4


def test_the_largest_plants_have_the_places_that_there_are():
    wanted = PlantingTargets(np.array([1, 0, 1, 1, 0], np.uint16), np.array([5.0, 4, 3, 2, 1]), np.ones(5))
    at = np.arange(6.0).reshape(3, 2)
    places = assign(wanted, at, np.array([1, 0, 1]), np.random.default_rng(6))
    assert np.isnan(places[[3, 4]]).all()
    assert places[1].tolist() == [2.0, 3.0]
    assert sorted(places[[0, 2], 0].tolist()) == [0.0, 4.0]


@given(st.integers(1, 3000), st.floats(0.02, 50))
def test_a_lattice_has_enough_cells_and_hardly_more(n, ratio):
    rows, cols = lattice_shape(n, (ratio, 1.0))
    assert n <= rows * cols < n + max(rows, cols)


@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from([0.5, 1.0, 3.0]))
def test_a_lattice_of_squares_is_found(rows, cols, cell):
    assert lattice_shape(rows * cols, (cols * cell, rows * cell)) == (rows, cols)


@pytest.mark.parametrize("jitter", [0.0, 0.3, 1.0])
def test_boxes_hold_the_density_within_them(jitter, site, tree):
    """Against a map of five columns, 12 m each, counted by hand: the density is 0 to 4 from west to east."""
    plants = {"tree": {"count": 1, "map": {"rows": [[0, 1, 2, 3, 4]], "smooth": False}}}
    grid = lattice(PlacementParameters(plants=plants), site, [tree()], (2, 8), jitter)
    expected = []
    for middle in np.arange(3.75, 60, 7.5):
        x = middle + jitter * np.linspace(-3.75, 3.75, 20_001)[1:-1]
        expected.append((x // 12).mean())
    weight = grid.weight[0].reshape(2, 8)
    assert weight[0] == pytest.approx(weight[1])
    assert weight[0] / weight[0].mean() == pytest.approx(expected / np.mean(expected), rel=0.02, abs=0.02)


@pytest.mark.parametrize("jitter", [0.0, 0.4, 1.0])
def test_places_in_boxes_follow_the_density(jitter, site, tree):
    """Of a cell of 7.5 m whose western part, 4.5 m, has the density 1, and its eastern part 2."""
    plants = {"tree": {"count": 1, "map": {"rows": [[0, 1, 2, 3, 4]], "smooth": False}}}
    grid = lattice(PlacementParameters(plants=plants), site, [tree()], (5, 8), jitter)
    n, rng = 1000, np.random.default_rng(7)
    at = grid.draw(np.full(n, 8 + 3), np.zeros(n, np.int64), rng.random((n, 3)))
    assert np.all(np.abs(at - (26.25, 12)) <= np.array([3.75, 4]) * jitter + 1e-9)
    west = np.clip(24 - (26.25 - 3.75 * jitter), 0, 7.5)
    east = 2 * (7.5 * jitter - west) / max(west + 2 * (7.5 * jitter - west), 1e-9)
    if jitter:
        assert np.mean(at[:, 0] > 24) == pytest.approx(east, abs=4 * np.sqrt(east * (1 - east) / n) + 0.01)


def test_who_stays_apart_is_the_greedy_choice():
    rng = np.random.default_rng(8)
    for periodic in (False, True):
        points, size = rng.random((300, 2)) * (8, 5), np.array([8.0, 5.0])
        stay: list[np.ndarray] = []
        for point in points:
            step = np.abs(np.array(stay).reshape(-1, 2) - point)
            if periodic:
                step = np.minimum(step, size - step)
            if not np.any(np.hypot(*step.T) < 0.4):
                stay.append(point)
        keep = stays_apart(points, 0.4, (8.0, 5.0), periodic=periodic)
        assert points[keep].tolist() == np.array(stay).tolist()
