"""Measures of growing stands, on made-up stands whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.point_patterns import Window
from support.stand_measures import (
    belt,
    clustering,
    fit_logistic,
    fit_power_law,
    leaders,
    shares_in_bands,
    thinning_line,
)

YEARS = np.arange(0.0, 241.0, 2.0)
WINDOW = Window(0.0, 60.0, 0.0, 60.0)
RADII = np.linspace(0.5, 6.0, 12)


def thomas(rng: np.random.Generator, sigma_m: float, parents: int = 36, children: int = 10) -> np.ndarray:
    """Clusters of children about random parents, on a torus."""
    at = np.repeat(rng.random((parents, 2)) * 60, children, axis=0)
    return np.mod(at + rng.normal(0, sigma_m, at.shape), 60.0)


def test_the_papers_logistic_curve_comes_back():
    # L, k and x0 of Makowski 2023, Figure 18b.
    fit = fit_logistic(YEARS, 3000 / (1 + np.exp(-0.0625 * (YEARS - 120))))
    assert fit.limit == pytest.approx(3000, rel=1e-6)
    assert fit.rate_per_yr == pytest.approx(0.0625, rel=1e-6)
    assert fit.middle_yr == pytest.approx(120, rel=1e-6)
    assert fit.r_squared == pytest.approx(1)
    np.testing.assert_allclose(fit.at(np.array([120.0, 1e6])), [1500, 3000], rtol=1e-6)


def test_noise_lowers_r_squared_by_its_variance():
    y = 100 / (1 + np.exp(-0.08 * (YEARS - 110)))
    noise = np.random.default_rng(0).normal(0, 12.0, len(y))
    fit = fit_logistic(YEARS, y + noise)
    expected = 1 - np.var(noise) / np.var(y + noise)
    assert fit.r_squared == pytest.approx(expected, abs=0.02)
    assert fit.limit == pytest.approx(100, rel=0.1)


def test_a_course_that_rises_and_falls_is_not_logistic():
    fit = fit_logistic(YEARS, np.exp(-(((YEARS - 80) / 30) ** 2)))
    assert fit is None or fit.r_squared < 0.7


def test_nothing_to_fit_gives_none():
    assert fit_logistic(YEARS, np.full(len(YEARS), 3.0)) is None
    assert fit_logistic(YEARS[:3], YEARS[:3]) is None


def test_a_power_law_comes_back_whichever_variable_errs():
    rng = np.random.default_rng(1)
    true = rng.normal(-2.0, 0.8, 4000)
    noise = 0.3
    x, y = true + noise * rng.normal(size=4000), np.log(20.0) + 2 / 3 * true + noise * 2 / 3 * rng.normal(size=4000)
    law = fit_power_law(np.exp(x), np.exp(y))
    assert law.exponent == pytest.approx(2 / 3, abs=4 * law.error)
    assert law.error < 0.01
    # Ordinary regression of the same points is too flat, by the share of x's variance that is error.
    assert np.polyfit(x, y, 1)[0] < 0.9 * 2 / 3
    # The axis has no direction: exchanging x and y gives the inverse.
    assert fit_power_law(np.exp(y), np.exp(x)).exponent == pytest.approx(1 / law.exponent)


def test_an_exact_power_law_has_no_error_and_zeros_are_left_out():
    x = np.array([0.0, 1.0, 2.0, 5.0, 9.0, 3.0])
    y = np.array([4.0, 7.0, 7 * 2**2.25, 7 * 5**2.25, 7 * 9**2.25, 0.0])
    law = fit_power_law(x, y)
    assert law.n == 4
    assert (law.exponent, law.factor, law.r_squared) == pytest.approx((2.25, 7.0, 1.0))
    assert law.error == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(law.at(np.array([5.0])), [7 * 5**2.25])
    assert fit_power_law(x[:4], y[:4]) is None


@pytest.mark.parametrize("slope", [-1.5, -1.2])
def test_the_thinning_line_is_that_of_the_stretch_that_thins(slope):
    # 40 years without a death, a turn, then the line; at last old plants die without growing.
    growing = np.full(40, 5000.0)
    line = np.geomspace(4000, 300, 80)
    mass = np.concatenate([np.geomspace(1e-3, 0.2, 40), 2e3 * (line / 300) ** slope, np.full(30, 1500.0)])
    density = np.concatenate([growing, line, np.linspace(290, 50, 30)])
    got = thinning_line(density, mass)
    assert got.law.exponent == pytest.approx(slope, abs=1e-6)
    assert density[got.first] <= 5000 / 3 < density[got.first - 1]
    assert got.last == 119


def test_the_thinning_line_begins_where_the_canopy_is_said_to_close():
    # Before, plants grow without meeting; the line is shorter than what density alone would need.
    density = np.concatenate([np.full(20, 2000.0), np.geomspace(1900, 1000, 40)])
    mass = np.concatenate([np.geomspace(1, 40, 20), 2e6 * np.geomspace(1900, 1000, 40) ** -1.5])
    assert thinning_line(density, mass) is None
    got = thinning_line(density, mass, closed=20)
    assert got.law.exponent == pytest.approx(-1.5, abs=1e-6)
    assert (got.first, got.last) == (20, 59)
    assert thinning_line(np.zeros(9), np.full(9, np.nan), closed=3) is None


def test_years_without_a_death_do_not_bend_the_thinning_line():
    # Stairs: the density stands still for years while plants grow up to the line, and falls at once.
    steps = np.geomspace(3000, 200, 30)
    density = np.concatenate([[9000.0], np.repeat(steps, 5)])
    mass = np.concatenate([[1e-3], (np.repeat(steps, 5) ** -1.5) * np.tile([0.80, 0.85, 0.9, 0.95, 1.0], 30) * 1e5])
    got = thinning_line(density, mass)
    assert got.law.exponent == pytest.approx(-1.5, abs=1e-6)


def test_a_stand_that_does_not_thin_has_no_line():
    assert thinning_line(np.full(50, 100.0), np.arange(1.0, 51.0)) is None


def test_leaders_follow_each_other():
    t = np.arange(300.0)
    amount = np.stack([np.exp(-(((t - c) / 60) ** 2)) for c in (30, 130, 260)], axis=1)
    reigns = leaders(amount)
    assert [one.species for one in reigns] == [0, 1, 2]
    assert (reigns[0].first, reigns[-1].last) == (0, 299)
    assert reigns[0].last + 1 == reigns[1].first == 81  # half way between 30 and 130


def test_a_short_reign_is_passed_over_and_nothing_has_no_leader():
    lead = np.array([0, 0, 0, 1, 0, 0, 2, 2, 2])
    amount = np.eye(3)[lead]
    assert [(one.species, one.first, one.last) for one in leaders(amount, shortest=2)] == [(0, 0, 5), (2, 6, 8)]
    assert len(leaders(amount)) == 4
    assert leaders(np.zeros((5, 3))) == ()


def test_clustering_falls_with_the_radius_of_the_clusters():
    rng = np.random.default_rng(2)
    found = [
        clustering(thomas(rng, sigma), WINDOW, RADII, rng, near_m=1.5, correction="periodic", simulations=39)
        for sigma in (0.8, 2.0, 30.0)
    ]
    near = [one.near for one in found]
    assert near[0] > 1.5 * near[1] > 1.5 * near[2]
    assert found[0].clustered
    assert found[1].clustered
    # Thomas' process: g(r) = 1 + exp(-r²/4σ²) / (4 π σ² κ), κ parents per area.
    g = 1 + np.exp(-(RADII**2) / (4 * 2.0**2)) / (4 * np.pi * 2.0**2 * 36 / 3600)
    np.testing.assert_allclose(found[1].g[2:], g[2:], rtol=0.3)


def test_random_points_leave_the_envelope_in_one_case_of_twenty():
    rng = np.random.default_rng(3)
    left = 0
    for _ in range(80):
        one = clustering(rng.random((60, 2)) * 60, WINDOW, RADII, rng, correction="periodic", simulations=39)
        left += one.clustered or one.spaced
    assert left <= 11  # of 80 at 5%: 4 are expected, more than 11 in one run of a thousand


def test_a_lattice_is_spaced():
    at = (np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2) + 0.5) * 3.0
    found = clustering(at, WINDOW, RADII, np.random.default_rng(4), correction="periodic", simulations=39)
    assert found.spaced
    assert found.near < 1
    assert found.g[0] == 0


def test_a_belt_holds_eight_tenths_of_the_weight():
    place = np.linspace(0, 1000, 10_001)
    found = belt(place, np.ones(10_001))
    assert (found.low, found.middle, found.high) == pytest.approx((100, 500, 900), abs=0.1)
    heavy_above = belt(place, (place > 800).astype(float))
    assert heavy_above.low == pytest.approx(820, abs=0.2)
    assert belt(place, np.zeros(10_001)) is None


def test_bands_lose_no_weight():
    rng = np.random.default_rng(5)
    place, species, weight = rng.uniform(0, 10, 500), rng.integers(0, 3, 500), rng.random(500)
    place[0] = 10.0
    sums = shares_in_bands(place, species, weight, np.array([0.0, 2.0, 7.0, 10.0]), 3)
    assert sums.shape == (3, 3)
    np.testing.assert_allclose(sums.sum(axis=0), np.bincount(species, weights=weight))
    assert sums[1, 2] == pytest.approx(weight[(place >= 2) & (place < 7) & (species == 2)].sum())
