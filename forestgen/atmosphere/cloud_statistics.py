"""Numbers that tell what kind of clouds a state of the air holds.

A cell is cloudy where its droplets' mass ratio is at least `CLOUDY`. A column's base is the bottom of its lowest cloudy
cell, its top the top of its highest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forestgen.atmosphere.weather import Weather

CLOUDY = 1e-5  # kg/kg
_LOW_PERCENT, _HIGH_PERCENT = 10.0, 99.0
_WATER_KG_PER_M3 = 1000.0


@dataclass(frozen=True)
class CloudStatistics:
    """Of one snapshot. Heights are above the datum; None where there is no cloud."""

    time_s: float
    cover: float  # share of columns with a cloudy cell
    base_m: float | None  # that a tenth of the cloudy columns' bases lie below
    top_m: float | None  # that a hundredth of the cloudy columns' tops lie above
    mean_base_m: float | None  # over cloudy columns
    mean_top_m: float | None
    cloud_kg_per_m2: float  # liquid water path of droplets, over all columns: mm
    rain_kg_per_m2: float  # the same of falling drops
    fallen_kg_per_m2: float  # rain on the ground since the beginning, mean: mm
    optical_depth: float  # of droplets straight up, mean over cloudy columns, at the radius given
    updraught_m_per_s: float  # largest upward speed


def cloud_statistics(weather: Weather, *, droplet_radius_um: float = 10.0) -> CloudStatistics:
    """Base, top, cover and water of the clouds in a snapshot."""
    cloudy = weather.cloud >= CLOUDY
    columns = cloudy.any(axis=0)
    low_m, side_m = weather.grid.low_m[2], weather.grid.cell_m[2]
    base: list[float | None] = [None, None]
    top: list[float | None] = [None, None]
    if columns.any():
        first = np.argmax(cloudy, axis=0)[columns]
        last = len(cloudy) - np.argmax(cloudy[::-1], axis=0)[columns]
        base = [low_m + side_m * float(one) for one in (np.percentile(first, _LOW_PERCENT), first.mean())]
        top = [low_m + side_m * float(one) for one in (np.percentile(last, _HIGH_PERCENT), last.mean())]
    path = weather.cloud_water_kg_per_m3.sum(axis=0, dtype=np.float64) * side_m
    depth = 1.5 * path / (_WATER_KG_PER_M3 * droplet_radius_um * 1e-6)
    return CloudStatistics(
        time_s=weather.time_s,
        cover=float(columns.mean()),
        base_m=base[0],
        top_m=top[0],
        mean_base_m=base[1],
        mean_top_m=top[1],
        cloud_kg_per_m2=float(path.mean()),
        rain_kg_per_m2=float(weather.rain_water_kg_per_m3.sum(axis=0, dtype=np.float64).mean() * side_m),
        fallen_kg_per_m2=float(weather.fallen_kg_per_m2.mean()),
        optical_depth=float(depth[columns].mean()) if columns.any() else 0.0,
        updraught_m_per_s=float(weather.up_m_per_s.max()),
    )
