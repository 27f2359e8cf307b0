"""A community in time, as numbers: what is left of a snapshot that need not be kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.community.point_patterns import (
    Distances,
    Estimate,
    Window,
    clark_evans_donnelly,
    hopkins,
    measure_distances,
)
from forestgen.community.population import Population, Status
from forestgen.community.size_statistics import Slope, fit_log_normal, reineke_slope, self_thinning_slope
from forestgen.community.statistics import count_by_species, cover_by_species, plant_mass, shares, stems_by_species
from forestgen.core.randomness import child_rng

ALL = "all"  # of the plants, beside each species
_SAMPLES = 2_500  # points of the window for Hopkins' index: its error is that of the plants all the same


@dataclass(frozen=True)
class Moment:
    """What there is of each species at one step: (S,) arrays in the order of the species."""

    step: int
    time_yr: float
    counts: NDArray[np.int64]
    cover: NDArray[np.float64]  # share of the site
    mass_sum: NDArray[np.float64]  # in the unit of `plant_mass`
    square_sum_m2: NDArray[np.float64]  # of radii


def moment(population: Population, site: Site) -> Moment:
    """The numbers of a snapshot; dead plants do not count."""
    alive = population.status != Status.DEAD
    kinds, n = population.species[alive], len(population.species_names)
    mass, _ = plant_mass(population)
    return Moment(
        step=population.step,
        time_yr=population.time_yr,
        counts=np.bincount(kinds, minlength=n),
        cover=np.array(list(cover_by_species(population, site).values())),
        mass_sum=np.bincount(kinds, weights=mass[alive], minlength=n).astype(np.float64),
        square_sum_m2=np.bincount(kinds, weights=population.radius_m[alive] ** 2, minlength=n).astype(np.float64),
    )


@dataclass(frozen=True)
class Trajectory:
    """Moments in the order of time, as arrays of T rows and S columns, a species each."""

    species_names: tuple[str, ...]
    area_m2: float
    mass_unit: str
    time_yr: NDArray[np.float64]  # (T,)
    counts: NDArray[np.int64]  # (T, S)
    cover: NDArray[np.float64]  # (T, S) share of the site
    mass_sum: NDArray[np.float64]  # (T, S)
    square_sum_m2: NDArray[np.float64]  # (T, S)

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
    def density_per_ha(self) -> NDArray[np.float64]:
        """(T,) plants of all species per hectare."""
        return np.asarray(self.counts.sum(axis=1) / self.area_m2 * 1e4)

    @property
    def mean_mass(self) -> NDArray[np.float64]:
        """(T,) mean mass of a plant; nan where none lives."""
        return _over(self.mass_sum.sum(axis=1), self.counts.sum(axis=1))

    @property
    def quadratic_mean_diameter_m(self) -> NDArray[np.float64]:
        """(T,) of the plants' circles, metres; nan where there is none."""
        return np.asarray(2 * np.sqrt(_over(self.square_sum_m2.sum(axis=1), self.counts.sum(axis=1))))

    def is_even_aged(self) -> bool:
        """Whether plants only ever get fewer, as those of one sowing do."""
        return bool(np.all(np.diff(self.counts.sum(axis=1)) <= 0))


def _over(sums: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    means = np.full(len(sums), math.nan)
    np.divide(sums, counts, out=means, where=counts > 0)
    return means


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
    return {
        "step": population.step,
        "time_yr": population.time_yr,
        "n": n,
        "density_per_m2": n / site.area_m2,
        "counts": counts,
        "shares": shares(counts),
        "stems_over_1_3_m": stems,
        "stems_over_1_3_m_per_ha": {name: number / site.area_m2 * 1e4 for name, number in stems.items()},
        "cover": cover_by_species(population, site),
        "mean_mass": float(mass[alive].mean()) if n else None,
        "hopkins": {name: one[0] for name, one in patterns.items()},
        "clark_evans_donnelly": {name: one[1] for name, one in patterns.items()},
        "mass_log_normal": {name: _log_normal(mass[pick]) for name, pick in groups.items()},
    }


def _pattern(
    population: Population, pick: NDArray[np.bool_], site: Site, seed: int, name: str
) -> tuple[dict[str, float | None] | None, dict[str, float | None] | None]:
    """Hopkins' index and Clark and Evans'; None for fewer than two plants."""
    points_m = population.position_m[pick, :2]
    if len(points_m) < 2:
        return None, None
    distances, window = _distances(points_m, site, seed, population.step, name)
    return _estimate(hopkins(distances)), _estimate(clark_evans_donnelly(distances.from_points_m, window))


def _distances(points_m: NDArray[np.float64], site: Site, seed: int, step: int, name: str) -> tuple[Distances, Window]:
    window = Window(0.0, site.size_m[0], 0.0, site.size_m[1])
    rng = child_rng(seed, "statistics", step, name)
    return measure_distances(points_m, window, rng, samples=_SAMPLES), window


def told_hopkins(points_m: NDArray[np.float64], site: Site, seed: int) -> float:
    """Hopkins' index of (N, 2) plants as `describe_step` tells it of all plants of step 0; nan for fewer than two."""
    return hopkins(_distances(points_m, site, seed, 0, ALL)[0]).value if len(points_m) > 1 else math.nan


def _estimate(one: Estimate) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in one._asdict().items()}


def _log_normal(mass: NDArray[np.float64]) -> Mapping[str, Any] | None:
    positive = mass[(mass > 0) & np.isfinite(mass)]
    fit = fit_log_normal(positive)
    return asdict(fit) if fit else None
