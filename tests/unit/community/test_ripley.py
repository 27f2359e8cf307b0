"""Ripley's K and the pair correlation: published values, oracles, limits, invariances."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.community import point_patterns
from forestgen.community.point_patterns import (
    Window,
    besag_l,
    count_pairs,
    greatest_radius,
    pair_correlation,
    ripley_bound,
    ripley_k,
)
from forestgen.community.point_statistics import read_points

DATA = Path(__file__).parent / "data"
UNIT = Window(0.0, 1.0, 0.0, 1.0)
CORRECTIONS = ("isotropic", "translation", "periodic")


@pytest.mark.parametrize(
    ("name", "correction", "spatstat", "digit"),
    [
        ("redwood", "isotropic", 0.066721886, 1e-9),
        ("redwood", "translation", 0.072104016, 1e-9),
        ("cells", "isotropic", 0.0011614402, 1e-10),
        ("cells", "translation", 0.0013038536, 1e-10),
    ],
)
def test_k_as_spatstat_gives_it(name, correction, spatstat, digit):
    table = read_points(DATA / f"{name}.csv")
    k = ripley_k(table.points_m, table.window, np.array([0.1]), correction)
    assert k[0] == pytest.approx(spatstat, abs=0.51 * digit, rel=0)


def share_inside(centre, radius, window):
    """Share of a circle in the window, by walking around it."""
    angle = (np.arange(20_000) + 0.5) * (2 * np.pi / 20_000)
    on_circle = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return 1 - window.outside(on_circle).mean()


def all_pairs(points, window, correction):
    """Distances and weights of all ordered pairs, the slow and plain way."""
    size = np.array(window.size_m)
    for i, here in enumerate(points):
        for j, there in enumerate(points):
            if i == j:
                continue
            step = np.abs(there - here)
            if correction == "periodic":
                yield math.hypot(*np.minimum(step, size - step)), 1.0
            elif correction == "translation":
                yield math.hypot(*step), window.area_m2 / math.prod(size - step)
            else:
                d = math.hypot(*step)
                yield d, 1 / max(share_inside(here, d, window), 0.01)


@pytest.mark.parametrize("correction", CORRECTIONS)
@pytest.mark.parametrize("window", [Window(0.0, 1.0, 0.0, 1.0), Window(-4.0, -1.0, 10.0, 11.5)])
def test_k_and_g_are_sums_over_all_pairs(correction, window):
    points = window.corner_m + np.random.default_rng(3).random((25, 2)) * window.size_m
    # A point in a corner and one on an edge: where circles are cut most.
    points[0], points[1] = window.corner_m, (0.4 * window.x0 + 0.6 * window.x1, window.y0)
    most = greatest_radius(window, correction)
    radii = np.array([0.7, 0.1, 0.4, 0.999]) * most
    distance, weight = np.array(list(all_pairs(points, window, correction))).T
    scale = window.area_m2 / (25 * 24)
    expected = [scale * weight[distance <= r].sum() for r in radii]
    assert ripley_k(points, window, radii, correction) == pytest.approx(expected, rel=2e-4)

    h, inner = 0.1 * most, np.array([0.2, 0.5, 0.8]) * most
    u = (inner[:, None] - distance) / h
    kernel = np.where(np.abs(u) < 1, 0.75 / h * (1 - u * u), 0.0)
    g = (kernel * weight / distance).sum(axis=1) * scale / (2 * math.pi)
    found = pair_correlation(points, window, inner, correction, bandwidth_m=h)
    assert found == pytest.approx(g, rel=2e-4, abs=1e-9)


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_random_points_have_the_area_of_a_circle(correction):
    window = Window(0.0, 2.0, 0.0, 1.0)
    most = greatest_radius(window, correction)
    radii = np.array([0.05, 0.2, most])
    k = [
        ripley_k(np.random.default_rng(seed).random((80, 2)) * (2.0, 1.0), window, radii, correction)
        for seed in range(300)
    ]
    error = np.std(k, axis=0) / np.sqrt(300)
    assert np.all(np.abs(np.mean(k, axis=0) - np.pi * radii**2) < 4 * error)


def test_nineteen_random_patterns_in_twenty_stay_within_ripleys_bound():
    radii = np.linspace(0.01, 0.25, 25)
    over = 0
    for seed in range(200):
        k = ripley_k(np.random.default_rng(seed).random((150, 2)), UNIT, radii, "isotropic")
        over += np.max(np.abs(besag_l(k) - radii)) > ripley_bound(150, UNIT)
    assert 2 <= over <= 25  # of 200; it is an approximation


def test_the_pair_correlation_of_clusters_is_thomas():
    # A Thomas process: g = 1 + exp(-r² / 4σ²) / (4 π σ² κ), κ parents per area.
    sigma, parents, radii = 0.02, 50, np.array([0.02, 0.05, 0.1])
    g = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        centres = rng.random((rng.poisson(parents), 2))
        children = np.repeat(centres, rng.poisson(10, len(centres)), axis=0)
        points = np.mod(children + rng.normal(0, sigma, children.shape), 1.0)
        g.append(pair_correlation(points, UNIT, radii, "periodic"))
    expected = 1 + np.exp(-(radii**2) / (4 * sigma**2)) / (4 * np.pi * sigma**2 * parents)
    assert np.mean(g, axis=0) == pytest.approx(expected, rel=0.08)


@given(
    seed=st.integers(0, 2**32 - 1),
    factor=st.floats(1e-3, 1e3),
    correction=st.sampled_from(CORRECTIONS),
)
@settings(max_examples=25, deadline=None)
def test_k_scales_as_an_area_and_has_no_place(seed, factor, correction):
    points = np.random.default_rng(seed).random((30, 2))
    radii = np.array([0.1, 0.3])
    there = Window(5 * factor, 6 * factor, -3 * factor, -2 * factor)
    moved = (points + np.array([5.0, -3.0])) * factor
    one = ripley_k(points, UNIT, radii, correction)
    # A pair whose distance is a radius to the last bit could fall on either side.
    assert ripley_k(moved, there, radii * factor, correction) == pytest.approx(one * factor**2, rel=1e-6)
    g = pair_correlation(points, UNIT, radii, correction)
    assert pair_correlation(moved, there, radii * factor, correction) == pytest.approx(g, rel=1e-5)


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_k_grows_and_ignores_the_order_of_points_and_radii(correction):
    points = np.random.default_rng(1).random((60, 2))
    radii = np.linspace(0, greatest_radius(UNIT, correction), 30)
    k = ripley_k(points, UNIT, radii, correction)
    assert k[0] == 0
    assert np.all(np.diff(k) >= 0)
    again = ripley_k(points[::-1], UNIT, radii[::-1], correction)
    assert again[::-1] == pytest.approx(k)


def test_portions_of_pairs_add_up(monkeypatch):
    points = np.random.default_rng(1).random((200, 2))
    radii = np.array([0.05, 0.2])
    whole = {one: ripley_k(points, UNIT, radii, one) for one in CORRECTIONS}
    monkeypatch.setattr(point_patterns, "_PAIRS_AT_ONCE", 50)
    for one in CORRECTIONS:
        assert ripley_k(points, UNIT, radii, one) == pytest.approx(whole[one])


def test_twins_are_pairs():
    twins = np.array([[0.5, 0.5], [0.5, 0.5]])
    for one in CORRECTIONS:
        assert ripley_k(twins, UNIT, np.array([0.0, 0.1]), one) == pytest.approx([1.0, 1.0])
    assert count_pairs(twins, 0.1) == 2
    assert count_pairs(np.array([[0.0, 0.0], [0.3, 0.0], [0.35, 0.0]]), 0.31) == 4


@pytest.mark.slow
def test_a_hundred_thousand_points():
    points = np.random.default_rng(2).random((100_000, 2))
    k = ripley_k(points, UNIT, np.array([0.005, 0.01]), "isotropic")
    assert besag_l(k) == pytest.approx([0.005, 0.01], abs=ripley_bound(100_000, UNIT))


@pytest.mark.parametrize(
    ("points", "radii", "match"),
    [
        (np.zeros((1, 2)), [0.1], "2 points"),
        (np.array([[0.5, 0.5], [2.0, 0.5]]), [0.1], "in the window"),
        (np.array([[0.5, 0.5], [0.2, 0.5]]), [-0.1], "radii_m"),
        (np.array([[0.5, 0.5], [0.2, 0.5]]), [0.8], "radii_m"),
        (np.array([[0.5, 0.5], [0.2, 0.5]]), [math.nan], "radii_m"),
    ],
)
def test_what_has_no_k(points, radii, match):
    with pytest.raises(ValueError, match=match):
        ripley_k(points, UNIT, np.array(radii), "isotropic")
    with pytest.raises(ValueError, match=match):
        pair_correlation(points, UNIT, np.array(radii), "isotropic")


def test_a_bandwidth_is_positive():
    with pytest.raises(ValueError, match="bandwidth_m"):
        pair_correlation(np.random.default_rng(0).random((9, 2)), UNIT, np.array([0.1]), "periodic", bandwidth_m=0.0)
