"""The climate of a region: what is normal in each month, and how that changes over the years (Makowski 2023, 4.5.2)."""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Self

from pydantic import Field, model_validator

from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.fields import NonNegative, Number, Section, Text, violation

MONTHS_PER_YR = 12
DAYS_PER_MONTH = 365.25 / 12
MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_Twelve = Field(min_length=MONTHS_PER_YR, max_length=MONTHS_PER_YR)
_Warmth = Annotated[Number, Field(ge=-60, le=60)]
_Rain = Annotated[NonNegative, Field(le=5000)]


@dataclass(frozen=True)
class MonthlyClimate:
    """Normals of twelve months, January first."""

    temperature_c: tuple[float, ...]  # (12,) mean, at z = 0
    precipitation_mm: tuple[float, ...]  # (12,) sum

    @property
    def precipitation_mm_per_yr(self) -> float:
        return math.fsum(self.precipitation_mm)

    @property
    def mean_temperature_c(self) -> float:
        return math.fsum(self.temperature_c) / MONTHS_PER_YR


def first_step_after(time_yr: float, step_yr: float) -> int:
    """The first step that ends after a time."""
    return math.floor(time_yr / step_yr * (1 + 1e-9)) + 1


class ClimateChange(Section):
    """From one year to another the climate changes evenly, and then stays so."""

    from_yr: NonNegative = Field(le=1e6, description="When it begins, years.")
    to_yr: NonNegative = Field(le=1e6, description="When it is complete, years.")
    precipitation: NonNegative = Field(1.0, le=100, description="Factor on the rain of every month.")
    temperature_k: Number = Field(0.0, ge=-30, le=30, description="What every month becomes warmer, K.")
    vapour: NonNegative = Field(
        1.0, le=100, description="Factor on the vapour that the region brings in; needs weather, whose clouds go by it."
    )

    @model_validator(mode="after")
    def _forwards(self) -> Self:
        if self.to_yr < self.from_yr:
            raise violation(f"from_yr = {self.from_yr:g} or more", got=f"{self.to_yr:g}", at=("to_yr",))
        return self

    def step(self, step_yr: float) -> int:
        """The first step at whose end it has begun."""
        return first_step_after(self.from_yr, step_yr)

    def share_at(self, time_yr: float) -> float:
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


def month_at(normals: MonthlyClimate, changes: Sequence[ClimateChange], month: int) -> Month:
    """Month number `month` since the beginning, which was a January; changes are those at its middle."""
    time_yr = (month + 0.5) / MONTHS_PER_YR
    warmer, wetter, damper = 0.0, 1.0, 1.0
    for one in changes:
        share = one.share_at(time_yr)
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
    """The climate of a place by its name, in any case; RecipeError if there is no such place."""
    by_name = {name.casefold(): one for name, one in places().items()}
    found = by_name.get(place.casefold())
    if found is None:
        near = difflib.get_close_matches(place.casefold(), by_name, n=1)
        problem = "no monthly climate of this place comes with forestgen"
        hint = f"did you mean {near[0].title()!r}?" if near else "give temperature_c and precipitation_mm by month"
        raise RecipeError(problem, where="community.climate.place", expected=", ".join(places()), got=place, hint=hint)
    return found


class Climate(Section):
    """What is normal in each month, January first, at z = 0."""

    place: Text | None = Field(
        None, description="A place whose monthly normals come with forestgen: San Diego, Juneau."
    )
    temperature_c: Annotated[tuple[_Warmth, ...], _Twelve] | None = Field(
        None, description="Mean temperature of twelve months, deg C."
    )
    precipitation_mm: Annotated[tuple[_Rain, ...], _Twelve] | None = Field(
        None, description="Precipitation of twelve months, mm."
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        given = [name for name in ("temperature_c", "precipitation_mm") if getattr(self, name) is not None]
        if self.place is None and len(given) < 2:
            missing = "precipitation_mm" if "temperature_c" in given else "temperature_c"
            raise violation("a place, or temperature_c and precipitation_mm", problem="half a climate", at=(missing,))
        if self.place is not None:
            try:
                climate_of(self.place)
            except RecipeError as error:
                raise violation(
                    error.expected or "a place", problem=error.problem, got=self.place, hint=error.hint, at=("place",)
                ) from error
        return self

    def normals(self) -> MonthlyClimate:
        """The twelve months; numbers that are given take the place's places."""
        place = MonthlyClimate((), ()) if self.place is None else climate_of(self.place)
        return MonthlyClimate(
            self.temperature_c or place.temperature_c, self.precipitation_mm or place.precipitation_mm
        )
