"""Sizes: the log-normal fit and its test, and the slopes of thinning."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from forestgen.community.trajectory import (
    fit_log_normal,
    reineke_slope,
    self_thinning_slope,
    thinning_window,
)


def test_a_log_normal_sample_gives_its_parameters_back():
    size = np.random.default_rng(0).lognormal(-2.0, 0.7, 50_000)
    fit = fit_log_normal(size)
    assert fit.n == 50_000
    assert fit.mu == pytest.approx(-2.0, abs=4 * 0.7 / np.sqrt(50_000))
    assert fit.sigma == pytest.approx(0.7, rel=4 / np.sqrt(100_000))


def test_the_statistic_is_scipys_adjusted():
    size = np.random.default_rng(1).gamma(2.0, size=80)
    with warnings.catch_warnings():  # scipy announces that critical values will be p-values
        warnings.simplefilter("ignore", FutureWarning)
        theirs = stats.anderson(np.log(size), dist="norm")
    ours = fit_log_normal(size)
    assert ours.anderson_darling == pytest.approx(theirs.statistic * (1 + 0.75 / 80 + 2.25 / 80**2))


@pytest.mark.parametrize("n", [10, 50, 500])
def test_p_values_of_log_normal_samples_are_uniform(n):
    rng = np.random.default_rng(2)
    p = np.array([fit_log_normal(rng.lognormal(3.0, 0.4, n)).p_value for _ in range(1500)])
    # Stephens' formula is good to a percent or two.
    for level in (0.01, 0.05, 0.1, 0.25, 0.5, 0.75):
        assert np.mean(p < level) == pytest.approx(level, abs=0.02 + 4 * np.sqrt(level * (1 - level) / 1500) * 0.5)


@pytest.mark.parametrize("sample", [lambda rng: rng.random(500), lambda rng: rng.exponential(size=500)])
def test_other_laws_are_told_apart(sample):
    assert fit_log_normal(sample(np.random.default_rng(3))).p_value < 1e-4


def test_p_never_leaves_its_range():
    far = np.concatenate([np.full(5000, 1.0), np.full(5000, 1e9)])
    assert fit_log_normal(far).p_value == 0.0
    rng = np.random.default_rng(4)
    p = [fit_log_normal(rng.lognormal(size=8)).p_value for _ in range(500)]
    assert 0 <= min(p) <= max(p) <= 1


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
@settings(max_examples=30, deadline=None)
def test_a_unit_moves_mu_and_nothing_else(seed, factor):
    size = np.random.default_rng(seed).gamma(1.5, size=40)
    one, other = fit_log_normal(size), fit_log_normal(size * factor)
    assert other.mu == pytest.approx(one.mu + np.log(factor), abs=1e-9)
    assert other.sigma == pytest.approx(one.sigma)
    assert other.p_value == pytest.approx(one.p_value, abs=1e-6)


def test_what_cannot_be_fitted():
    assert fit_log_normal(np.ones(7)) is None
    assert fit_log_normal(np.full(100, 2.5)) is None
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="positive and finite"):
            fit_log_normal(np.append(np.ones(20), bad))


def trajectory(slope=-1.5, steps=60):
    """Growth without deaths, thinning along a line, then mature plants that die without growing."""
    density = np.concatenate([np.full(10, 1.0), np.geomspace(1.0, 0.05, steps), np.geomspace(0.05, 0.001, 20)[1:]])
    mass = np.concatenate([np.geomspace(1e-6, 1e-3, 10), 1e-3 * np.geomspace(1.0, 0.05, steps) ** slope])
    return density, np.append(mass, np.full(19, mass[-1]))


@pytest.mark.parametrize("slope", [-1.5, -1.33, -2.0])
def test_the_slope_of_a_line_between_growth_and_old_age(slope):
    density, mass = trajectory(slope)
    found = self_thinning_slope(density, mass)
    assert found.value == pytest.approx(slope)
    assert found.error == pytest.approx(0, abs=1e-6)
    assert density[found.first] <= 1 / 3 < density[found.first - 1]
    assert density[found.last] == pytest.approx(0.05)


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_slopes_have_no_unit(a, b):
    density, mass = trajectory()
    assert self_thinning_slope(density * a, mass * b).value == pytest.approx(-1.5)


def test_reineke_of_circles_that_fill_the_ground():
    density, mass = trajectory()
    diameter = np.cbrt(mass)  # of one shape, mass ~ N^-3/2: area ~ N^-1
    assert reineke_slope(density, diameter).value == pytest.approx(-2.0)
    assert self_thinning_slope(density, mass).value * reineke_slope(density, diameter).value == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("density", "mass"),
    [
        ([], []),
        ([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]),
        ([1.0, 0.9, 0.8, 0.7], [1.0, 2.0, 3.0, 4.0]),
        ([0.0] * 9, [np.nan] * 9),
        ([1.0, 0.3, 0.0, 0.0], [1.0, 2.0, np.nan, np.nan]),
    ],
)
def test_without_a_decline_there_is_no_line(density, mass):
    assert thinning_window(np.array(density), np.array(mass)) is None
    assert self_thinning_slope(np.array(density), np.array(mass)) is None


def test_a_stand_that_dies_out_is_fitted_while_it_lives():
    density, mass = trajectory()
    dead = np.concatenate([density, np.zeros(5)]), np.concatenate([mass, np.full(5, np.nan)])
    assert self_thinning_slope(*dead) == self_thinning_slope(density, mass)
