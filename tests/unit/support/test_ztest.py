"""The test that golden renders rest on: how often it cries wolf, and what it can see."""

from __future__ import annotations

import numpy as np
import pytest

from support.ztest import NoisyImage, sidak, welch, welch_blocks

SLICES = 8


def noisy(mean: np.ndarray, spread: float, rng: np.random.Generator, skewed: bool = False) -> NoisyImage:
    """Mean of eight slices around `mean` and the variance that they show; `skewed` as few light paths are."""
    shape = (SLICES, *mean.shape)
    noise = rng.gamma(4.0, 0.5, shape) - 2.0 if skewed else rng.standard_normal(shape)
    slices = mean + spread * noise
    return NoisyImage(slices.mean(axis=0), slices.var(axis=0, ddof=1) / SLICES)


def test_sidak_is_exact_for_independent_tests():
    rng = np.random.default_rng(0)
    tests = 500
    wrong = (rng.random((20_000, tests)) < sidak(0.05, tests)).any(axis=1).mean()
    assert abs(wrong - 0.05) < 0.005
    assert sidak(0.01, 10**9) == pytest.approx(1.005e-11, rel=1e-3)


@pytest.mark.parametrize("test", [welch, welch_blocks])
def test_equal_images_are_rejected_as_often_as_stated(test):
    """Family-wise, 5% of 1000 pairs. Welch's approximation errs to the safe side."""
    rng = np.random.default_rng(1)
    mean = rng.random((16, 24, 1)) + 0.5
    wrong = sum(not test(noisy(mean, 0.2, rng), noisy(mean, 0.2, rng), 0.05).equal for _ in range(1000))
    assert 15 <= wrong <= 80


@pytest.mark.parametrize("test", [welch, welch_blocks])
def test_single_p_values_are_uniform(test):
    rng = np.random.default_rng(2)
    mean = np.zeros((160, 160, 3))
    p = test(noisy(mean, 1.0, rng), noisy(mean, 1.0, rng), 0.05).p_value.ravel()
    for level in (0.5, 0.1, 0.01):
        share = (p < level).mean()
        assert abs(share - level) < 4 * np.sqrt(level * (1 - level) / len(p)) + 0.05 * level


def test_skewed_noise_does_not_cry_wolf():
    rng = np.random.default_rng(3)
    mean = np.ones((32, 48, 3))
    wrong = sum(
        not (welch(a, b, 0.01).equal and welch_blocks(a, b, 0.01).equal)
        for a, b in ((noisy(mean, 0.3, rng, True), noisy(mean, 0.3, rng, True)) for _ in range(100))
    )
    assert wrong <= 8


def test_a_faint_plant_moves_its_block_though_no_pixel_tells():
    rng = np.random.default_rng(4)
    mean = np.ones((32, 48, 3))
    darker = mean.copy()
    darker[8:14, 8:14] *= 0.85  # 6 x 6 pixels that are 15% darker, at 10% noise a slice
    pixels = blocks = 0
    for _ in range(50):
        a, b = noisy(mean, 0.1, rng), noisy(darker, 0.1, rng)
        pixels += not welch(a, b, 0.01).equal
        blocks += not welch_blocks(a, b, 0.01).equal
    assert blocks == 50
    assert pixels < 50


def test_one_wrong_pixel_is_found_and_named():
    rng = np.random.default_rng(5)
    mean = np.ones((20, 30, 3))
    broken = mean.copy()
    broken[7, 11] = 3.0
    result = welch(noisy(mean, 0.05, rng), noisy(broken, 0.05, rng), 0.01)
    assert result.rejected.any(axis=2).nonzero() == (np.array([7]), np.array([11]))


def test_values_without_noise_must_be_equal():
    flat = NoisyImage(np.ones((4, 4, 1)), np.zeros((4, 4, 1)))
    other = np.ones((4, 4, 1))
    other[2, 1] += 1e-6
    assert welch(flat, flat, 0.01).equal
    assert welch_blocks(flat, flat, 0.01).equal
    assert not welch(flat, NoisyImage(other, np.zeros((4, 4, 1))), 0.01).equal


def test_nan_is_refused():
    flat = NoisyImage(np.ones((2, 2, 1)), np.ones((2, 2, 1)))
    with pytest.raises(ValueError, match="not finite in 1 places"):
        welch(flat, NoisyImage(np.array([[[1.0], [np.nan]], [[1.0], [1.0]]]), flat.variance), 0.01)
    with pytest.raises(ValueError, match="differ in shape"):
        welch(flat, NoisyImage(np.ones((2, 3, 1)), np.ones((2, 3, 1))), 0.01)


def test_blocks_at_the_rim_are_means_of_what_is_there():
    image = NoisyImage(np.arange(15.0).reshape(3, 5, 1), np.ones((3, 5, 1)))
    zero = NoisyImage(np.zeros((3, 5, 1)), np.zeros((3, 5, 1)))
    result = welch_blocks(image, zero, 0.01, block=2)
    assert result.statistic.shape == (2, 3, 1)
    assert result.statistic[1, 2, 0] == pytest.approx(14.0)  # one pixel, variance 1
    assert result.statistic[0, 0, 0] == pytest.approx((0 + 1 + 5 + 6) / 4 / np.sqrt(1 / 4))
