"""The climate of a region: what is normal in each month, and how that changes over the years (seeds 002, 4.5.2)."""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.assets import scenes_dir

MONTHS_PER_YR = 12
DAYS_PER_MONTH = 365.25 / 12
MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MonthlyClimate:
    """Normals of twelve months, January first."""

    temperature_c: tuple[float, ...]  # (12,) mean, at z = 0
    precipitation_mm: tuple[float, ...]  # (12,) sum

    def __post_init__(self) -> None:
        for name, least in (("temperature_c", -math.inf), ("precipitation_mm", 0.0)):
            values = getattr(self, name)
            if len(values) != MONTHS_PER_YR or not all(math.isfinite(one) and one >= least for one in values):
                raise ValueError(f"{name}: expected twelve finite numbers, got {values!r}")

    @property
    def precipitation_mm_per_yr(self) -> float:
        return math.fsum(self.precipitation_mm)

    @property
    def mean_temperature_c(self) -> float:
        return math.fsum(self.temperature_c) / MONTHS_PER_YR


@dataclass(frozen=True)
class Turn:
    """From one year to another the climate changes evenly, then stays so: rain, vapour by factors, warmth by a sum."""

    from_yr: float
    to_yr: float
    precipitation: float = 1.0
    temperature_k: float = 0.0
    vapour: float = 1.0

    def done(self, time_yr: float) -> float:
        """Share of the change that has come, 0 to 1."""
        if time_yr >= self.to_yr:
            return 1.0
        return 0.0 if time_yr <= self.from_yr else (time_yr - self.from_yr) / (self.to_yr - self.from_yr)


@dataclass(frozen=True)
class Month:
    """The climate of one month."""

    temperature_c: float
    rain_mm_per_day: float
    vapour: float = 1.0  # that the region brings in, over what is normal


def month_at(normals: MonthlyClimate, turns: Sequence[Turn], month: int) -> Month:
    """Month number `month` since the beginning, which was a January; changes are those at its middle."""
    time_yr = (month + 0.5) / MONTHS_PER_YR
    warmer, wetter, damper = 0.0, 1.0, 1.0
    for one in turns:
        share = one.done(time_yr)
        warmer += share * one.temperature_k
        wetter *= 1.0 + share * (one.precipitation - 1.0)
        damper *= 1.0 + share * (one.vapour - 1.0)
    index = month % MONTHS_PER_YR
    rain = normals.precipitation_mm[index] * wetter / DAYS_PER_MONTH
    return Month(normals.temperature_c[index] + warmer, rain, damper)


@cache
def places() -> dict[str, MonthlyClimate]:
    """The monthly climates that come with forestgen, by the place's name."""
    path = scenes_dir() / "climate" / "months.csv"
    rows = [
        line
        for line in read_text(path, "climate normals", most_bytes=1_000_000, error=AssetError).splitlines()
        if line and not line.startswith("#")
    ]
    found = {}
    for row in csv.DictReader(rows):
        values = {
            key: tuple(float(row[f"{key}_{month}"]) for month in MONTHS)
            for key in ("temperature_c", "precipitation_mm")
        }
        found[row["name"]] = MonthlyClimate(**values)
    return found


def climate_of(place: str) -> MonthlyClimate:
    """The climate of a place by its name, whatever the case.

    Raises
    ------
    RecipeError : no such place.
    """
    by_name = {name.casefold(): one for name, one in places().items()}
    found = by_name.get(place.casefold())
    if found is None:
        near = difflib.get_close_matches(place.casefold(), by_name, n=1)
        raise RecipeError(
            "no monthly climate of this place comes with forestgen",
            where="community.climate.place",
            expected=", ".join(places()),
            got=place,
            hint=f"did you mean {near[0].title()!r}?" if near else "give temperature_c and precipitation_mm by month",
        )
    return found
