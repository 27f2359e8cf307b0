"""Sizes in a community: the log-normal size hierarchy, and the self-thinning line (Lane 2002, sections 2.2 and 2.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr
from scipy.stats import linregress

_FEWEST_TO_FIT = 8  # below, Stephens' approximation of the p-value does not hold
_FEWEST_ON_LINE = 5
_ON_LINE = 1 / 3  # of the greatest density: by then a trajectory has turned into the line


@dataclass(frozen=True)
class LogNormalFit:
    """ln(size) is about normal with mean `mu` and standard deviation `sigma`."""

    n: int
    mu: float  # of ln(size), size in its own unit
    sigma: float
    anderson_darling: float  # A*², adjusted for the estimated mu and sigma; below 0.752 fits at the 5% level
    p_value: float  # of sizes as far from log-normal as these, or farther, by chance


def fit_log_normal(size: NDArray[np.float64]) -> LogNormalFit | None:
    """Fit a log-normal distribution to positive sizes, and test it; None for fewer than 8 sizes, or all alike.

    The test is Anderson and Darling's, with Stephens' p-value for estimated parameters: Kolmogorov and Smirnov's own
    p-value would be far too large.

    References
    ----------
    Stephens 1986, in D'Agostino and Stephens, Goodness-of-Fit Techniques, table 4.9.
    """
    n = len(size)
    if n < _FEWEST_TO_FIT:
        return None
    if not np.all((size > 0) & np.isfinite(size)):
        raise ValueError("sizes must be positive and finite")
    logs = np.sort(np.log(size))
    mu, sigma = float(logs.mean()), float(logs.std(ddof=1))
    if sigma <= 1e-12 * max(1.0, abs(mu)):
        return None
    z = (logs - mu) / sigma
    odd = 2 * np.arange(1, n + 1) - 1
    a2 = -n - float(np.mean(odd * (log_ndtr(z) + log_ndtr(-z[::-1]))))
    adjusted = a2 * (1 + 0.75 / n + 2.25 / n**2)
    return LogNormalFit(n, mu, sigma, adjusted, _stephens_p(adjusted))


def _stephens_p(a: float) -> float:
    if a >= 0.6:
        # Past its least exponent the parabola would rise again: by then p is as good as nothing.
        return math.exp(1.2937 - 5.709 * a + 0.0186 * a * a) if a < 150 else 0.0
    if a >= 0.34:
        return math.exp(0.9177 - 4.279 * a - 1.38 * a * a)
    if a >= 0.2:
        return 1 - math.exp(-8.318 + 42.796 * a - 59.938 * a * a)
    return 1 - math.exp(-13.436 + 101.14 * a - 223.73 * a * a)


@dataclass(frozen=True)
class Slope:
    """A straight line through logarithms."""

    value: float
    error: float  # standard error, as if the points were independent
    intercept: float  # natural logarithm
    first: int  # index of the first point fitted
    last: int  # and of the last


def self_thinning_slope(
    density: NDArray[np.float64], mean_mass: NDArray[np.float64], *, window: tuple[int, int] | None = None
) -> Slope | None:
    """Slope of log mean mass on log density along a trajectory in time: -3/2 on the self-thinning line.

    Parameters
    ----------
    density : (T,) plants per area.
    mean_mass : (T,) mean mass of a plant.
    window : first and last index of the points to fit; by default those of `thinning_window`.

    Returns
    -------
    None without a decline, or where fewer than 5 points lie in the window.

    References
    ----------
    Yoda et al. 1963, J. Biol. Osaka City Univ. 14. Lane 2002, Figures 2.1 and 4.4.
    """
    return _log_slope(density, mean_mass, window or thinning_window(density, mean_mass))


def reineke_slope(
    density: NDArray[np.float64], mean_diameter: NDArray[np.float64], *, window: tuple[int, int] | None = None
) -> Slope | None:
    """Slope of log density on log quadratic mean diameter along a trajectory: -1.605 in Reineke's stands.

    The window is that of `self_thinning_slope`. Circles of one shape that fill a constant share of the ground give -2.

    References
    ----------
    Reineke 1933, J. Agric. Res. 46.
    """
    return _log_slope(mean_diameter, density, window or thinning_window(density, mean_diameter))


def thinning_window(density: NDArray[np.float64], mean_size: NDArray[np.float64]) -> tuple[int, int] | None:
    """First and last index of a trajectory's stretch along the self-thinning line; None where there is none.

    The stretch begins where a third of the greatest density is left: before, plants grow without meeting, and the
    trajectory turns towards the line. It ends where the mean size is greatest: mature plants grow no more, and die of
    age.
    """
    density, mean_size = np.asarray(density, dtype=np.float64), np.asarray(mean_size, dtype=np.float64)
    if not len(density):
        return None
    peak = int(np.argmax(density))
    thinned = np.flatnonzero((density[peak:] <= _ON_LINE * density[peak]) & (density[peak:] > 0))
    if not len(thinned):
        return None
    first = peak + int(thinned[0])
    alive = first + int(np.argmin(np.append(density[first:], 0.0) > 0))
    last = first + int(np.argmax(mean_size[first:alive]))
    return (first, last) if last - first + 1 >= _FEWEST_ON_LINE else None


def _log_slope(x: NDArray[np.float64], y: NDArray[np.float64], window: tuple[int, int] | None) -> Slope | None:
    if window is None:
        return None
    first, last = window
    log_x, log_y = np.log(x[first : last + 1]), np.log(y[first : last + 1])
    if len(log_x) < 3 or not np.ptp(log_x) > 0:
        return None
    line = linregress(log_x, log_y)
    return Slope(float(line.slope), float(line.stderr), float(line.intercept), first, last)
