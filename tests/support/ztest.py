"""Do two noisy images show the same thing? Welch's t-test with a Šidák correction, per pixel and per block of pixels.

A pixel's variance is itself an estimate, from a few independent slices of samples, so the statistic follows Student's
distribution and not the normal one, whose tails would cry wolf (8 slices: |t| > 5 is 200 times as frequent). The
correction makes the *family* of all tests reject a true null with probability `significance`:
alpha_1 = 1 - (1 - alpha)^(1/N).

Single pixels have little power after the correction. Means of 8 x 8 blocks have more: 64 times less variance, and
7 x 64 degrees of freedom, so what removes a small plant moves a block by many standard errors.

References
----------
Welch 1947, "The generalization of 'Student's' problem when several different population variances are involved".
Satterthwaite 1946, eq. 17, degrees of freedom of a sum of variance estimates.
Šidák 1967, "Rectangular confidence regions for the means of multivariate normal distributions".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BLOCK_PX = 8


@dataclass(frozen=True)
class NoisyImage:
    """An estimate of an image."""

    mean: NDArray[np.float64]  # (H, W, C)
    variance: NDArray[np.float64]  # (H, W, C) of the mean
    slices: int = 8  # independent estimates behind each variance


@dataclass(frozen=True)
class Comparison:
    """Outcome for one family of tests (all pixels, or all blocks)."""

    p_value: NDArray[np.float64]  # (h, w, C) of each test alone
    threshold: float  # p-values below it reject
    statistic: NDArray[np.float64]  # (h, w, C) difference over its standard error

    @property
    def rejected(self) -> NDArray[np.bool_]:
        """(h, w, C) the tests that reject."""
        return self.p_value < self.threshold

    @property
    def equal(self) -> bool:
        return not self.rejected.any()


def sidak(significance: float, tests: int) -> float:
    """Significance of each of `tests` independent tests whose family has `significance`."""
    return float(-np.expm1(np.log1p(-significance) / tests))


def welch(a: NoisyImage, b: NoisyImage, significance: float) -> Comparison:
    """Test each value of `a` against `b`; two-sided. Where neither has variance, values must be equal."""
    return _welch(a.mean, a.variance, _dof(a), b.mean, b.variance, _dof(b), significance)


def welch_blocks(a: NoisyImage, b: NoisyImage, significance: float, block: int = BLOCK_PX) -> Comparison:
    """The same for means over blocks of `block` x `block` pixels; blocks at the right and lower rim may be smaller.

    Pixels are taken as independent: a box filter shares no sample between them.
    """
    return _welch(*_blocks(a, block), *_blocks(b, block), significance)


def _dof(image: NoisyImage) -> NDArray[np.float64]:
    return np.full(image.mean.shape, image.slices - 1.0)


def _sum_blocks(values: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    rows, columns = np.arange(0, values.shape[0], block), np.arange(0, values.shape[1], block)
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1))


def _blocks(image: NoisyImage, block: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean, variance and degrees of freedom of each block."""
    count = _sum_blocks(np.ones_like(image.mean), block)
    total = _sum_blocks(image.variance, block)
    fourth = _sum_blocks(image.variance**2, block) / (image.slices - 1)
    freedom = np.divide(total**2, fourth, out=np.full_like(total, np.inf), where=fourth > 0)
    return _sum_blocks(image.mean, block) / count, total / count**2, freedom


def _welch(
    mean_a: NDArray[np.float64],
    variance_a: NDArray[np.float64],
    freedom_a: NDArray[np.float64],
    mean_b: NDArray[np.float64],
    variance_b: NDArray[np.float64],
    freedom_b: NDArray[np.float64],
    significance: float,
) -> Comparison:
    from scipy.stats import t as student

    if mean_a.shape != mean_b.shape:
        raise ValueError(f"images differ in shape: {mean_a.shape} and {mean_b.shape}")
    for name, array in (("mean", mean_a), ("mean", mean_b), ("variance", variance_a), ("variance", variance_b)):
        if not np.isfinite(array).all():
            raise ValueError(f"a {name} is not finite in {int((~np.isfinite(array)).sum())} places")
    total = variance_a + variance_b
    noisy = total > 0
    difference = mean_a - mean_b
    statistic = np.divide(difference, np.sqrt(total), out=np.zeros_like(difference), where=noisy)
    statistic[~noisy & (difference != 0)] = np.inf
    spread = variance_a**2 / freedom_a + variance_b**2 / freedom_b
    freedom = np.divide(total**2, spread, out=np.full_like(total, 1e9), where=spread > 0)
    p_value = np.where(noisy, 2 * student.sf(np.abs(statistic), freedom), np.where(difference == 0, 1.0, 0.0))
    return Comparison(p_value, sidak(significance, p_value.size), statistic)
