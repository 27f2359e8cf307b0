"""Measures of a stand that grows: the logistic curve, power laws between sizes, succession, clustering, belts.

They answer what growing forests are known for, whatever model grew them:

- biomass of an even-aged stand follows a logistic curve (`fit_logistic`);
- mean mass and density follow the self-thinning line (`thinning_line`), height and leaf mass follow diameter by power
  laws (`fit_power_law`). Both variables of such a law vary and neither is given, so the line is the reduced major axis:
  its slope is that of y on x over the coefficient of correlation. Ordinary regression would bend it towards 0;
- one species takes over from another (`leaders`);
- plants stand closer to each other than at random, or not (`clustering`);
- species keep to belts along a gradient (`belt`).

References
----------
Verhulst 1838, Corr. Math. Phys. 10 (logistic growth). Warton et al. 2006, Biol. Rev. 81 (lines through logarithms).
Myllymäki et al. 2017, J. R. Stat. Soc. B 79 (global envelopes). Makowski 2023, section 2.8 (the measurements).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.point_patterns import Correction, Window, pair_correlation
from forestgen.community.trajectory import thinning_window

_FEWEST = 4  # points for three parameters
_FITS = 20_000  # evaluations of the logistic curve at most
_SIMULATIONS = 199
_LEVEL = 0.05


@dataclass(frozen=True)
class Logistic:
    """y(t) = limit / (1 + exp(-rate (t - middle)))."""

    limit: float  # in the unit of y
    rate_per_yr: float
    middle_yr: float  # when half the limit is reached and growth is fastest
    r_squared: float  # share of the variance about the mean that the curve explains

    def at(self, time_yr: NDArray[np.float64]) -> NDArray[np.float64]:
        return _logistic(time_yr, self.limit, self.rate_per_yr, self.middle_yr)


def _logistic(time: NDArray[np.float64], limit: float, rate: float, middle: float) -> NDArray[np.float64]:
    return np.asarray(limit / (1 + np.exp(np.clip(-rate * (time - middle), -700, 700))))


def fit_logistic(time_yr: NDArray[np.float64], value: NDArray[np.float64]) -> Logistic | None:
    """The logistic curve of least squares through a course that rises; None where there is none to fit.

    Parameters
    ----------
    time_yr, value : (T,) in the order of time.
    """
    from scipy.optimize import curve_fit

    time, y = np.asarray(time_yr, dtype=np.float64), np.asarray(value, dtype=np.float64)
    if len(y) < _FEWEST or not (np.ptp(y) > 0 and np.ptp(time) > 0) or not np.all(np.isfinite(y)):
        return None
    top, span = float(y.max()), float(np.ptp(time))
    half = float(time[int(np.argmax(y >= top / 2))])
    try:
        (limit, rate, middle), _ = curve_fit(
            _logistic,
            time,
            y / top,
            p0=(1.0, 8.0 / span, half),
            bounds=((1e-3, 1e-3 / span, time[0] - span), (1e3, 1e3 / span, time[-1] + 10 * span)),
            x_scale=(1.0, 8.0 / span, span),
            max_nfev=_FITS,
        )
    except RuntimeError:  # it did not converge: no logistic curve is near
        return None
    left = y / top - _logistic(time, limit, rate, middle)
    r_squared = 1 - float(left @ left) / float(np.sum((y / top - np.mean(y / top)) ** 2))
    return Logistic(float(limit) * top, float(rate), float(middle), r_squared)


@dataclass(frozen=True)
class PowerLaw:
    """y = factor x^exponent, a line through logarithms by the reduced major axis."""

    exponent: float
    error: float  # standard error of the exponent, as if the points were independent
    factor: float
    r_squared: float  # of the logarithms
    n: int

    def at(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.factor * np.asarray(x) ** self.exponent)


def fit_power_law(x: NDArray[np.float64], y: NDArray[np.float64]) -> PowerLaw | None:
    """The power law between two positive sizes; points where one is 0 are left out. None for fewer than 4 others."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    log_x, log_y = np.log(x[good]), np.log(y[good])
    n = len(log_x)
    if n < _FEWEST or not (np.ptp(log_x) > 0 and np.ptp(log_y) > 0):
        return None
    r = float(np.corrcoef(log_x, log_y)[0, 1])
    exponent = math.copysign(float(np.std(log_y) / np.std(log_x)), r)
    error = abs(exponent) * math.sqrt(max(0.0, 1 - r * r) / (n - 2))
    factor = math.exp(float(np.mean(log_y)) - exponent * float(np.mean(log_x)))
    return PowerLaw(exponent, error, factor, r * r, n)


@dataclass(frozen=True)
class ThinningLine:
    """Mean mass against density on the stretch of a trajectory that thins itself."""

    law: PowerLaw  # mean mass = factor density^exponent; -3/2 is Yoda's
    first: int  # index of the stretch's first point
    last: int


def thinning_line(
    density: NDArray[np.float64], mean_mass: NDArray[np.float64], *, closed: int | None = None
) -> ThinningLine | None:
    """The self-thinning line of a trajectory in time; None without one.

    Years in which no plant died would count the same density many times, with masses above each other: of each run of
    equal densities only the last year, the point nearest to the line's upper bound, is taken.

    Parameters
    ----------
    density, mean_mass : (T,) in the order of time.
    closed : index from which on the canopy is closed, where that is known: the line begins there and ends at the
        greatest mean mass. None: the stretch of `thinning_window`, which tells it by the density alone.

    References
    ----------
    Yoda et al. 1963, J. Biol. Osaka City Univ. 14. Weller 1987, Ecol. Monogr. 57 (why not ordinary regression).
    Westoby 1984, Adv. Ecol. Res. 14 (the line is that of stands of constant leaf area).
    """
    density, mean_mass = np.asarray(density, dtype=np.float64), np.asarray(mean_mass, dtype=np.float64)
    window = thinning_window(density, mean_mass) if closed is None else _from(closed, mean_mass)
    if window is None:
        return None
    first, last = window
    rows = np.arange(first, last + 1)
    rows = rows[np.append(density[rows[1:]] != density[rows[:-1]], True)]
    law = fit_power_law(density[rows], mean_mass[rows])
    return ThinningLine(law, first, last) if law else None


def _from(first: int, mean_mass: NDArray[np.float64]) -> tuple[int, int] | None:
    """First and last index of a stretch that ends at the greatest mean mass; None where no plant is left."""
    if not np.isfinite(mean_mass[first:]).any():
        return None
    return first, first + int(np.nanargmax(mean_mass[first:]))


@dataclass(frozen=True)
class Reign:
    """A stretch of time in which one species has more than any other."""

    species: int
    first: int  # index of its first moment
    last: int


def leaders(amount: NDArray[np.float64], *, shortest: int = 1) -> tuple[Reign, ...]:
    """Who leads when, in the order of time.

    Parameters
    ----------
    amount : (T, S) of each species at each moment, such as leaf area; moments where all are 0 have no leader.
    shortest : stretches of fewer moments are passed over, and the reigns about them join if they are one species'.
    """
    amount = np.asarray(amount, dtype=np.float64)
    lead = np.where(amount.max(axis=1, initial=0.0) > 0, amount.argmax(axis=1), -1)
    edges = np.flatnonzero(np.diff(lead)) + 1
    reigns: list[Reign] = []
    for rows in np.split(np.arange(len(lead)), edges):
        if len(rows) < shortest or lead[rows[0]] < 0:
            continue
        if reigns and reigns[-1].species == lead[rows[0]]:
            reigns[-1] = Reign(reigns[-1].species, reigns[-1].first, int(rows[-1]))
        else:
            reigns.append(Reign(int(lead[rows[0]]), int(rows[0]), int(rows[-1])))
    return tuple(reigns)


@dataclass(frozen=True)
class Clustering:
    """The pair correlation of a pattern against random patterns of as many points."""

    radii_m: NDArray[np.float64]  # (R,)
    g: NDArray[np.float64]  # (R,) 1 at random, above: neighbours at that distance are more frequent
    low: NDArray[np.float64]  # (R,) of the global envelope: a random pattern leaves it anywhere in one case of twenty
    high: NDArray[np.float64]  # (R,)
    near: float  # mean of g over the area nearer than `near_m`

    @property
    def clustered(self) -> bool:
        """Whether g rises above the envelope somewhere."""
        return bool(np.any(self.g > self.high))

    @property
    def spaced(self) -> bool:
        """Whether g falls below it somewhere."""
        return bool(np.any(self.g < self.low))


def clustering(
    points_m: NDArray[np.float64],
    window: Window,
    radii_m: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    near_m: float | None = None,
    correction: Correction = "translation",
    bandwidth_m: float | None = None,
    simulations: int = _SIMULATIONS,
) -> Clustering:
    """g(r) of points, with a global envelope of random patterns (studentised, of level 5%).

    Parameters
    ----------
    points_m : (N, 2) in the window, N at least 2.
    radii_m : (R,) metres, rising.
    near_m : how far `Clustering.near` looks; by default as far as the radii.
    bandwidth_m : half the width of the estimator's kernel; by default Stoyan's.
    simulations : random patterns; the envelope holds all but the 5% that leave their mean the farthest.
    """
    radii = np.asarray(radii_m, dtype=np.float64)
    g = pair_correlation(points_m, window, radii, correction, bandwidth_m=bandwidth_m)
    size, corner = np.array(window.size_m), np.array([window.x0, window.y0])
    random = np.array(
        [
            pair_correlation(
                corner + size * rng.random((len(points_m), 2)), window, radii, correction, bandwidth_m=bandwidth_m
            )
            for _ in range(simulations)
        ]
    )
    mean, spread = random.mean(axis=0), np.maximum(random.std(axis=0, ddof=1), 1e-12)
    farthest = np.sort(np.abs((random - mean) / spread).max(axis=1))
    reach = farthest[min(simulations - 1, math.ceil((1 - _LEVEL) * (simulations + 1)) - 1)]
    ring_m = np.where(radii <= (math.inf if near_m is None else near_m), radii, 0.0)
    near = float(np.sum(g * ring_m) / np.sum(ring_m))
    return Clustering(radii, g, mean - reach * spread, mean + reach * spread, near)


@dataclass(frozen=True)
class Belt:
    """Where along a gradient a species grows, weighted by its plants' sizes."""

    low: float  # a tenth of it grows below
    middle: float  # a half
    high: float  # nine tenths


def belt(place: NDArray[np.float64], weight: NDArray[np.float64]) -> Belt | None:
    """Weighted tenth, half and nine tenths of plants' places; None where nothing grows."""
    place, weight = np.asarray(place, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    if not np.sum(weight) > 0:
        return None
    order = np.argsort(place, kind="stable")
    below = np.cumsum(weight[order]) - 0.5 * weight[order]
    low, middle, high = np.interp(np.array([0.1, 0.5, 0.9]) * np.sum(weight), below, place[order])
    return Belt(float(low), float(middle), float(high))


def shares_in_bands(
    place: NDArray[np.float64],
    species: NDArray[np.integer],
    weight: NDArray[np.float64],
    edges: NDArray[np.float64],
    kinds: int,
) -> NDArray[np.float64]:
    """(B, kinds) sum of weights of each species between neighbouring edges of a gradient; the last edge belongs in."""
    band = np.searchsorted(edges, place, side="right") - 1
    band[place == edges[-1]] = len(edges) - 2
    good = (band >= 0) & (band < len(edges) - 1)
    flat = band[good] * kinds + np.asarray(species)[good].astype(np.int64)
    sums = np.bincount(flat, weights=np.asarray(weight, dtype=np.float64)[good], minlength=(len(edges) - 1) * kinds)
    return np.asarray(sums.reshape(-1, kinds), dtype=np.float64)
