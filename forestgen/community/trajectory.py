"""A community in time, as numbers: what is kept of a snapshot, and statistics of sizes.

Sizes: the log-normal size hierarchy, and the self-thinning line (Lane 2002, sections 2.2 and 2.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr
from scipy.stats import linregress

from forestgen.community.point_patterns import (
    Estimate,
    Window,
    clark_evans_donnelly,
    hopkins,
    hopkins_index,
    measure_distances,
)
from forestgen.community.population import (
    Floats,
    Population,
    Site,
    Status,
    count_by_species,
    cover_by_species,
    plant_mass,
    shares,
    stems_by_species,
)
from forestgen.core.randomness import child_rng

ALL = "all"  # of the plants, beside each species
_SAMPLES = 2_500  # points of the window for Hopkins' index: its error is that of the plants all the same
_FEWEST_TO_FIT = 8  # below, Stephens' approximation of the p-value does not hold
_FEWEST_ON_LINE = 5
_ON_LINE = 1 / 3  # of the greatest density: by then a trajectory has turned into the line


@dataclass(frozen=True)
class Moment:
    """What there is of each species at one step: (S,) arrays in the order of the species; dead plants do not count."""

    step: int
    time_yr: float
    counts: NDArray[np.int64]
    cover: Floats  # share of the site
    mass_sum: Floats  # in the unit of `plant_mass`
    square_sum_m2: Floats  # of radii


def moment(population: Population, site: Site) -> Moment:
    """The numbers of a snapshot."""
    alive = population.status != Status.DEAD
    kinds, n = population.species[alive], len(population.species_names)
    mass, _ = plant_mass(population)
    return Moment(
        step=population.step,
        time_yr=population.time_yr,
        counts=np.bincount(kinds, minlength=n),
        cover=np.array(list(cover_by_species(population, site.area_m2).values())),
        mass_sum=np.bincount(kinds, weights=mass[alive], minlength=n).astype(np.float64),
        square_sum_m2=np.bincount(kinds, weights=population.radius_m[alive] ** 2, minlength=n).astype(np.float64),
    )


@dataclass(frozen=True)
class Trajectory:
    """Moments in the order of time, as arrays of T rows and S columns, a species each."""

    species_names: tuple[str, ...]
    area_m2: float
    mass_unit: str
    time_yr: Floats  # (T,)
    counts: NDArray[np.int64]  # (T, S)
    cover: Floats  # (T, S) share of the site
    mass_sum: Floats  # (T, S)
    square_sum_m2: Floats  # (T, S)

    @classmethod
    def of(cls, moments: Sequence[Moment], species_names: tuple[str, ...], site: Site, mass_unit: str) -> Trajectory:
        """Moments, at least one of them, side by side."""
        if not moments:
            raise ValueError("a trajectory needs at least one moment")
        columns = {
            name: np.array([getattr(one, name) for one in moments])
            for name in ("time_yr", "counts", "cover", "mass_sum", "square_sum_m2")
        }
        return cls(species_names, site.area_m2, mass_unit, **columns)

    @property
    def density_per_ha(self) -> Floats:
        """(T,) plants of all species per hectare."""
        return np.asarray(self.counts.sum(axis=1) / self.area_m2 * 1e4)

    @property
    def mean_mass(self) -> Floats:
        """(T,) mean mass of a plant; nan where none lives."""
        return np.asarray(self.mass_sum.sum(axis=1) / self._plants)

    @property
    def quadratic_mean_diameter_m(self) -> Floats:
        """(T,) of the plants' circles, metres; nan where there is none."""
        return np.asarray(2 * np.sqrt(self.square_sum_m2.sum(axis=1) / self._plants))

    @property
    def _plants(self) -> Floats:
        """(T,) plants of all species; nan where there is none."""
        plants = self.counts.sum(axis=1)
        return np.where(plants > 0, plants, math.nan)

    def is_even_aged(self) -> bool:
        """Whether plants only ever get fewer, as those of one sowing do."""
        return bool(np.all(np.diff(self.counts.sum(axis=1)) <= 0))


def thinning_slope(trajectory: Trajectory) -> Slope | None:
    """Slope of log mean mass on log density of an even-aged community that thins itself; None for any other."""
    if not trajectory.is_even_aged():
        return None
    return self_thinning_slope(trajectory.density_per_ha, trajectory.mean_mass)


def describe_thinning(trajectory: Trajectory, slope: Slope) -> dict[str, Any]:
    """The self-thinning line of `thinning_slope`, and Reineke's of the same years, as plain numbers."""
    window = slope.first, slope.last
    reineke = reineke_slope(trajectory.density_per_ha, trajectory.quadratic_mean_diameter_m, window=window)
    return {
        "slope_log_mean_mass_on_log_density": _estimate(Estimate(slope.value, slope.error)),
        "slope_log_density_on_log_diameter": _estimate(Estimate(reineke.value, reineke.error)) if reineke else None,
        "from_time_yr": float(trajectory.time_yr[slope.first]),
        "to_time_yr": float(trajectory.time_yr[slope.last]),
    }


def describe_step(population: Population, site: Site, seed: int) -> dict[str, Any]:
    """All statistics of a snapshot as plain numbers, null where one is not defined; O(N log N).

    The same snapshot and seed give the same numbers.
    """
    counts, stems = count_by_species(population), stems_by_species(population)
    n = sum(counts.values())
    mass, _ = plant_mass(population)
    alive = population.status != Status.DEAD
    groups = {ALL: alive}
    groups.update({name: alive & (population.species == k) for k, name in enumerate(population.species_names)})
    patterns = {name: _pattern(population, pick, site, seed, name) for name, pick in groups.items()}
    logs = {name: fit_log_normal(mass[pick & (mass > 0) & np.isfinite(mass)]) for name, pick in groups.items()}
    return {
        "step": population.step,
        "time_yr": population.time_yr,
        "n": n,
        "density_per_m2": n / site.area_m2,
        "counts": counts,
        "shares": shares(counts),
        "stems_over_1_3_m": stems,
        "stems_over_1_3_m_per_ha": {name: number / site.area_m2 * 1e4 for name, number in stems.items()},
        "cover": cover_by_species(population, site.area_m2),
        "mean_mass": float(mass[alive].mean()) if n else None,
        "hopkins": {name: one[0] for name, one in patterns.items()},
        "clark_evans_donnelly": {name: one[1] for name, one in patterns.items()},
        "mass_log_normal": {name: asdict(fit) if fit else None for name, fit in logs.items()},
    }


def _pattern(
    population: Population, pick: NDArray[np.bool_], site: Site, seed: int, name: str
) -> tuple[dict[str, float | None] | None, dict[str, float | None] | None]:
    """Hopkins' index and Clark and Evans'; None for fewer than two plants."""
    points_m = population.position_m[pick, :2]
    if len(points_m) < 2:
        return None, None
    window, rng = Window(0.0, site.size_m[0], 0.0, site.size_m[1]), _points_of_window(seed, population.step, name)
    distances = measure_distances(points_m, window, rng, samples=_SAMPLES)
    return _estimate(hopkins(distances)), _estimate(clark_evans_donnelly(distances.from_points_m, window))


def _points_of_window(seed: int, step: int, name: str) -> np.random.Generator:
    return child_rng(seed, "statistics", step, name)


def reported_hopkins(points_m: Floats, site: Site, seed: int) -> float:
    """Hopkins' index of (N, 2) plants as `describe_step` reports it of all plants of step 0; nan for fewer than two."""
    return hopkins_index(points_m, site.size_m, _points_of_window(seed, 0, ALL), samples=_SAMPLES)


def _estimate(one: Estimate) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in one._asdict().items()}


@dataclass(frozen=True)
class LogNormalFit:
    """ln(size) is about normal with mean `mu` and standard deviation `sigma`."""

    n: int
    mu: float  # of ln(size), size in its own unit
    sigma: float
    anderson_darling: float  # A*², adjusted for the estimated mu and sigma; below 0.752 fits at the 5% level
    p_value: float  # of sizes as far from log-normal as these, or farther, by chance


def fit_log_normal(size: Floats) -> LogNormalFit | None:
    """Fit a log-normal distribution to positive sizes, and test it; None for fewer than 8 sizes, or all alike.

    The test is Anderson and Darling's, with Stephens' p-value for estimated parameters: Kolmogorov and Smirnov's own
    p-value would be far too large.

    Reference: Stephens 1986, in D'Agostino and Stephens, Goodness-of-Fit Techniques, table 4.9.
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


def self_thinning_slope(density: Floats, mean_mass: Floats) -> Slope | None:
    """Slope of log mean mass on log density, (T,) each along a trajectory in time: -3/2 on the self-thinning line.

    Fitted to the points of `thinning_window`. None without a decline, or where fewer than 5 points lie in the window.

    Reference: Yoda et al. 1963, J. Biol. Osaka City Univ. 14. Lane 2002, Figures 2.1 and 4.4.
    """
    return _log_slope(density, mean_mass, thinning_window(density, mean_mass))


def reineke_slope(density: Floats, mean_diameter: Floats, *, window: tuple[int, int] | None = None) -> Slope | None:
    """Slope of log density on log quadratic mean diameter along a trajectory: -1.605 in Reineke's stands.

    The window is that of `self_thinning_slope`. Circles of one shape that fill a constant share of the ground give -2.

    Reference: Reineke 1933, J. Agric. Res. 46.
    """
    return _log_slope(mean_diameter, density, window or thinning_window(density, mean_diameter))


def thinning_window(density: Floats, mean_size: Floats) -> tuple[int, int] | None:
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


def _log_slope(x: Floats, y: Floats, window: tuple[int, int] | None) -> Slope | None:
    if window is None:
        return None
    first, last = window
    log_x, log_y = np.log(x[first : last + 1]), np.log(y[first : last + 1])
    if len(log_x) < 3 or not np.ptp(log_x) > 0:
        return None
    line = linregress(log_x, log_y)
    return Slope(float(line.slope), float(line.stderr), float(line.intercept), first, last)
