"""Days of air over the forest: what clouds and warmth its ground makes (Makowski 2023, 4.5.4, 4.5.7).

Some days stand for a month. Of each, some hours are simulated over the site's own ground: its heights, the vapour
that it gave in the month before, and the region's heat and vapour (E and E_M), drawn for the day. The same day is
simulated over level ground that gives everywhere what the region's climate takes for granted. The ratio of the two
columns of cloud and rain tells, by place, how much of the region's normal rain falls there:

    R = R_month ((1 - s) Q_region + s Q)
    Q        = water condensed over the place / the same over the region's ground
    Q_region = water condensed over the region's ground / the same with the region's normal vapour; 1 but for a change

s, `local_share`, is the share of rain whose clouds the place itself makes. So a month in which the forest does what is
usual has its normal rain; a cleared place, whose ground gives less vapour, has less. Q and Q_region refer to the
region's normal vapour: where a change of the climate takes vapour from region and place alike, there is less rain. In
their means over the site, both are at most 3. The temperature of the lowest air over that of the region's ground,
colder with elevation at the usual rate, is the place's own warmth: Foehn. Each year has the same drawn days.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.conditions import Layers, wind_towards
from forestgen.atmosphere.fluid.air import Air, at_rest
from forestgen.atmosphere.fluid.parameters import Physics, Surface
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.sounding import LATENT_HEAT_J_PER_KG, Sounding
from forestgen.community.ecoclimate.parameters import MONTHS_PER_YR, Month, WeatherSection
from forestgen.community.soil_water import Floats, Ground
from forestgen.core.randomness import child_rng
from forestgen.core.threads import parallel_map

MOST = 3.0
_MARK_S = 300.0  # between two looks at the clouds
_NOISE_K = 0.1
_RELAXATION_S = 1800.0
_LEAST_KG_PER_M2 = 1e-3  # of condensed water: days with less over the region's ground have no clouds to compare
_FLAT = 0.5  # of a cell's height: lower hills are no terrain to the air
_LAPSE_ABOVE_K_PER_KM = 4.0  # cooling upwards above the inversion


class AreaRegridder:
    """Maps between the cells of a ground and of the air around it, by areas in common: means stay as they are.

    The ground lies in the middle of the air's box.
    """

    def __init__(self, ground: Ground, air: AirGrid) -> None:
        # Along y and x, shares of area: of an air cell (rows) that a ground cell (columns) takes; the same of a ground
        # whose outermost cells reach to the edges of the box; of a ground cell (rows) that an air cell takes.
        self.to_air, self.beyond, self.to_ground = list[Floats](), list[Floats](), list[Floats]()
        for axis in (1, 0):
            length, box = ground.size_m[axis], air.size_m[axis]
            edges = 0.5 * (box - length) + np.linspace(0.0, length, ground.shape[1 - axis] + 1)
            of_air = np.linspace(0.0, box, air.cells[axis] + 1)
            common = _overlap(of_air, edges)
            self.to_air.append(common / air.cell_m[axis])
            self.beyond.append(_overlap(of_air, np.concatenate([[0.0], edges[1:-1], [box]])) / air.cell_m[axis])
            self.to_ground.append(common.T / ground.cell_m[axis])

    def for_air(self, values: Floats) -> NDArray[np.float32]:
        """(Y, X) means over the air's cells of a (rows, cols) map; around the ground it is as in its mean."""
        down, across = self.to_air
        covered = np.outer(down.sum(axis=1), across.sum(axis=1))
        inside = _product(down, values, across)
        return np.asarray(inside + (1.0 - covered) * values.mean(), dtype=np.float32)

    def heights_for_air(self, height_m: Floats) -> Floats:
        """(Y, X) of a (rows, cols) map of heights; around the ground they are those of its edge: no cliffs."""
        down, across = self.beyond
        return _product(down, height_m, across)

    def for_ground(self, values: NDArray[np.floating]) -> Floats:
        """(rows, cols) means over the ground's cells of a (Y, X) map of the air."""
        down, across = self.to_ground
        return _product(down, np.asarray(values, dtype=np.float64), across)


def _overlap(ours: Floats, theirs: Floats) -> Floats:
    """(N, M) length that intervals between edges (N + 1,) and (M + 1,) have in common."""
    low = np.maximum(ours[:-1, None], theirs[None, :-1])
    high = np.minimum(ours[1:, None], theirs[None, 1:])
    return np.asarray(np.maximum(high - low, 0.0))


def _product(down: Floats, values: Floats, across: Floats) -> Floats:
    """`down @ values @ across.T`; no BLAS, since the last digits of its sums depend on its threads."""
    return np.asarray(np.einsum("ac,bc->ab", np.einsum("ab,bc->ac", down, values), across))


@dataclass(frozen=True)
class BoundaryConditions:
    """What the ground of a month gives to the air, and how it lies."""

    ground: Ground
    height_m: Floats  # (rows, cols)
    vapour_mm_per_day: Floats  # (rows, cols) transpired and evaporated
    light: Floats  # (rows, cols) share of the light that comes down to the ground
    lapse_rate_k_per_km: float  # usual change of temperature with elevation, below 0
    wind_from_deg: float  # where the wind comes from, clockwise from north
    seed: int  # of the days' random numbers


@dataclass(frozen=True)
class MonthOfAir:
    """What a month's days of air did, means over them."""

    wetness: Floats  # (rows, cols) Q
    region: float  # Q_region
    warmth_k: Floats  # (rows, cols) of the lowest air, over what is usual at its elevation
    condensed_kg_per_m2: float  # mean over the site
    water_error: float  # largest share of a day's water in the air that was lost or made of nothing


@dataclass(frozen=True)
class Day:
    """The air of one day, and what the region's ground gives to it."""

    sounding: Sounding
    heat_w_per_m2: float
    vapour_kg_per_m2_s: float
    seed: int
    name: tuple[int, int]  # month of the year and day


@dataclass(frozen=True)
class Case:
    """All that the hours of a day over a ground begin with, but for how many they are."""

    grid: AirGrid
    day: Day
    surface: Surface


@dataclass(frozen=True)
class Hours:
    """What the hours of a day left."""

    condensed_kg_per_m2: Floats  # (Y, X) of cloud, rain and what has fallen: mean over the hours
    warmth_k: Floats  # (Y, X) of the lowest air of each column, over air at rest on the ground of the box
    lowest_m: Floats  # (Y, X) how much higher that air is than the box's lowest
    water_error: float
    weather: Weather  # at the end


def month_of_air(section: WeatherSection, month: Month, number: int, bounds: BoundaryConditions) -> MonthOfAir:
    """The air of month `number` since the beginning."""
    grid = grid_of(section, bounds.ground)
    maps = AreaRegridder(bounds.ground, grid)
    of_year, indices = number % MONTHS_PER_YR, range(section.days_per_month)
    usual = partial(_usual, section, grid, of_year=of_year, wind_from_deg=bounds.wind_from_deg, seed=bounds.seed)
    normal = replace(month, vapour=1.0)

    def over_the_site(index: int) -> Hours:
        case = case_of(section, month, number, bounds, index)
        return hours_of(section, case.grid, case.day, case.surface)

    # A step of so little air has too short loops for several cores: every day has one.
    jobs = [over_the_site, lambda index: usual(normal, index=index)]
    if month.vapour != 1.0:
        jobs.append(lambda index: usual(month, index=index))
    days: list[Any] = parallel_map([partial(job, index) for index in indices for job in jobs])
    looks: list[tuple[Floats, Floats, float, float]] = []
    for index in indices:
        here, (usual_kg, usual_k), *changed = days[len(jobs) * index : len(jobs) * (index + 1)]
        now_kg, now_k = changed[0] if changed else (usual_kg, usual_k)
        ours = maps.for_ground(here.condensed_kg_per_m2)
        warmth = here.warmth_k - now_k - bounds.lapse_rate_k_per_km / 1000.0 * here.lowest_m
        clouds = usual_kg > _LEAST_KG_PER_M2
        # The site's mean is bounded: a cap by cell would take from the peaks and give to none.
        ratio = ours / max(usual_kg, ours.mean() / MOST) if clouds else np.ones_like(ours)
        region = min(now_kg / usual_kg, MOST) if clouds else 1.0
        looks.append((ratio, maps.for_ground(warmth), region, float(ours.mean())))
    wetness, warmth, region, condensed = (np.mean(one, axis=0) for one in zip(*looks, strict=True))
    error = max(days[len(jobs) * index].water_error for index in indices)
    return MonthOfAir(wetness, float(region), warmth, float(condensed), error)


def case_of(section: WeatherSection, month: Month, number: int, bounds: BoundaryConditions, index: int) -> Case:
    """Day `index` of month `number` since the beginning, over the site's own ground."""
    grid = grid_of(section, bounds.ground)
    maps = AreaRegridder(bounds.ground, grid)
    height = maps.heights_for_air(bounds.height_m)
    terrain = height - height.min() if np.ptp(height) > _FLAT * grid.cell_m[2] else None
    shaded = 1.0 - section.shade_heat_share * (1.0 - maps.for_air(bounds.light).astype(np.float64))
    vapour = maps.for_air(bounds.vapour_mm_per_day).astype(np.float64) / (3600.0 * section.daylight_h)
    day = day_of(section, month, number % MONTHS_PER_YR, index, bounds.wind_from_deg, bounds.seed)
    heat, damp = day.heat_w_per_m2 * shaded, day.vapour_kg_per_m2_s + vapour
    return Case(grid, day, Surface(heat.astype(np.float32), damp.astype(np.float32), terrain))


@lru_cache(maxsize=400)
def _usual(
    section: WeatherSection, grid: AirGrid, month: Month, of_year: int, index: int, wind_from_deg: float, seed: int
) -> tuple[float, float]:
    """Of a day over the region's ground, means: condensed water, kg/m2, and the lowest air's warmth, K."""
    day = day_of(section, month, of_year, index, wind_from_deg, seed)
    own = section.usual_evaporation * month.rain_mm_per_day / (3600.0 * section.daylight_h)
    heat = day.heat_w_per_m2 * (1.0 - section.shade_heat_share * section.usual_shade)
    across = grid.shape[1:]
    surface = Surface(np.full(across, heat, np.float32), np.full(across, day.vapour_kg_per_m2_s + own, np.float32))
    hours = hours_of(section, grid, day, surface)
    return float(hours.condensed_kg_per_m2.mean()), float(hours.warmth_k.mean())


def grid_of(section: WeatherSection, ground: Ground) -> AirGrid:
    """The box of air, whose middle is the site's: even numbers of cells, of at least `cell_m`."""
    extent = [max(one, side) for one, side in zip(section.sides_m, ground.size_m, strict=True)]
    across = [max(8, 2 * int(side / section.cell_m / 2)) for side in extent]
    up = max(8, 2 * round(section.height_m / section.cell_height_m / 2))
    sides = extent[0] / across[0], extent[1] / across[1], section.height_m / up
    low = tuple(0.5 * (side - box) for side, box in zip(ground.size_m, extent, strict=True))
    return AirGrid((across[0], across[1], up), sides, (low[0], low[1], 0.0))


def day_of(section: WeatherSection, month: Month, of_year: int, index: int, wind_from_deg: float, seed: int) -> Day:
    """A day of a month, with normally distributed heat and vapour from the region (Algorithm 1, line 3)."""
    heat, vapour = child_rng(seed, "air", of_year, index).normal(size=2)
    brought = _of_month(section.vapour_w_per_m2, of_year)
    layers = Layers(
        month.temperature_c, section.mixed_layer_m, section.lapse_rate_k_per_km, section.inversion_m,
        section.inversion_jump_k, _LAPSE_ABOVE_K_PER_KM, section.relative_humidity, section.relative_humidity_aloft,
        0.6 * section.relative_humidity_aloft,
    )  # fmt: skip
    return Day(
        layers.sounding(section.height_m, wind_towards(section.wind_m_per_s, wind_from_deg)),
        _of_month(section.heat_w_per_m2, of_year) * max(0.0, 1.0 + section.spread * heat),
        brought * month.vapour * max(0.0, 1.0 + section.spread * vapour) / LATENT_HEAT_J_PER_KG,
        seed,
        (of_year, index),
    )


def _of_month(values: float | tuple[float, ...], of_year: int) -> float:
    return values[of_year] if isinstance(values, tuple) else values


def hours_of(section: WeatherSection, grid: AirGrid, day: Day, surface: Surface) -> Hours:
    """The hours of a day over a ground."""
    air = Air(grid, day.sounding, surface, Physics(wind_relaxation_s=_RELAXATION_S))
    unrest = child_rng(day.seed, "air", "unrest", *day.name)
    weather = at_rest(grid, day.sounding, surface, rng=unrest, noise_k=_NOISE_K)
    before_kg, area_m2 = weather.total_water_kg, grid.cell_m[0] * grid.cell_m[1]
    end_s, looks = 3600.0 * section.hours, max(1, round(3600.0 * section.hours / _MARK_S))
    rest_k = air.background.potential_temperature_k[0] * weather.temperature_ratio[0]
    condensed, warmth = np.zeros(grid.shape[1:]), np.zeros(grid.shape[1:])
    for look in range(1, looks + 1):
        weather = air.run(weather, end_s * look / looks)
        water = (weather.cloud + weather.rain) * weather.density_kg_per_m3.astype(np.float32)[:, None, None]
        column = water.sum(axis=0, dtype=np.float64) * grid.cell_m[2] + weather.fallen_kg_per_m2
        condensed += column / looks
        warmth += (_of_lowest(weather)[0] - rest_k) / looks
    received_kg = area_m2 * float(surface.vapour_kg_per_m2_s.sum(dtype=np.float64)) * end_s
    error = abs(weather.total_water_kg - before_kg - received_kg) / before_kg
    return Hours(condensed, warmth, _of_lowest(weather)[1], error, weather)


def _of_lowest(weather: Weather) -> tuple[Floats, Floats]:
    """(Y, X) temperature of the lowest air of each column, K, and how much higher it is than the box's lowest, m."""
    rows, cols = weather.grid.shape[1:]
    layer = np.zeros((rows, cols), np.int64) if weather.solid is None else weather.solid.sum(axis=0)
    layer = np.minimum(layer, weather.grid.cells[2] - 1)
    theta: NDArray[np.floating] = np.take_along_axis(weather.potential_temperature_k, layer[None], axis=0)[0]
    return theta.astype(np.float64) * weather.temperature_ratio[layer], layer * weather.grid.cell_m[2]
