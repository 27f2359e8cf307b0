"""What a recipe says about an ecoclimate besides its forest: the region's climate, the soil, the air.

The climate is what is normal in each month, and how that changes over the years (Makowski 2023, 4.5.2).
"""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from forestgen.community.branch_modules.parameters import BranchModulesParameters, values_in_time
from forestgen.community.soil_water import SoilWaterParameters
from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.fields import Flag, Fraction, Name, NonNegative, Number, Positive, Section, Text, Whole, violation
from forestgen.recipe.sources import Keys

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
    text = read_text(path, "climate normals", most_bytes=1_000_000, error=AssetError)
    rows = [line for line in text.splitlines() if line and not line.startswith("#")]
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


MOST_CELLS = 4_000_000
_MOST_WATTS = 1000.0


def _one_or_twelve(value: Any) -> Any:
    """What is wrong with a list of months, reported at its place; the rest is the schema's."""
    if isinstance(value, list | tuple):
        if len(value) != MONTHS_PER_YR:
            raise violation("one number, or twelve with January first", got=f"{len(value)} of them")
        for index, one in enumerate(value):
            if isinstance(one, bool) or not isinstance(one, int | float) or not 0 <= one <= _MOST_WATTS:
                raise violation(f"numbers from 0 to {_MOST_WATTS:g}", got=f"{one} in {MONTHS[index]}")
    return value


_Watts = Annotated[NonNegative, Field(le=_MOST_WATTS)]
_Monthly = Annotated[_Watts | tuple[_Watts, ...], BeforeValidator(_one_or_twelve)]
_Side = Annotated[Positive, Field(ge=100, le=50_000)]


class WeatherSection(Section):
    """Some days of each month, whose air is simulated over the forest; of fair-weather cumulus by default."""

    days_per_month: Whole = Field(1, ge=1, le=31, description="Days that stand for a month.")
    hours: Positive = Field(2.0, le=24, description="How much of a day is simulated, hours.")
    every_months: Whole = Field(
        1,
        ge=1,
        le=1200,
        description="Of so many months the first is simulated, and the others have its rain and warmth by place.",
    )
    extent_m: _Side | tuple[_Side, _Side] = Field(
        4000.0,
        description="Side of the box of air, metres, or two, to the east and to the north; at least those of the site.",
    )
    height_m: Positive = Field(3000.0, ge=200, le=20_000, description="Height of the box, metres.")
    cell_m: Positive = Field(200.0, ge=5, le=1000, description="Width of its cells, metres.")
    cell_height_m: Positive = Field(75.0, ge=5, le=500, description="Their height, metres.")
    local_share: Fraction = Field(0.5, description="Share of the rain whose clouds the place itself makes.")
    heat_w_per_m2: _Monthly = Field(
        150.0, description="Heat from open ground [E], W/m2; or of twelve months, January first."
    )
    vapour_w_per_m2: _Monthly = Field(
        60.0, description="Vapour that the region brings in [E_M], as its latent heat, W/m2; or of twelve months."
    )
    spread: Fraction = Field(0.1, description="Standard deviation of both from day to day, by their mean.")
    daylight_h: Positive = Field(12.0, le=24, description="Hours of a day in which ground and plants give vapour.")
    shade_heat_share: Fraction = Field(
        0.0,
        description="Share of the heat that ground in complete shade keeps back; 0 as in the paper. At 0.3 clouds "
        "gather over warm clearings.",
    )
    usual_evaporation: Fraction = Field(
        0.6, description="Share of its rain that the region's ground gives back to the air, where rain is normal."
    )
    usual_shade: Fraction = Field(0.5, description="Share of the light that the region's plants take.")
    relative_humidity: Fraction = Field(0.62, description="Of the air at the ground.")
    relative_humidity_aloft: Fraction = Field(0.5, description="Of the air below the inversion.")
    mixed_layer_m: NonNegative = Field(1000.0, le=10_000, description="Depth of the air that is stirred through, m.")
    lapse_rate_k_per_km: Number = Field(
        6.8, ge=-20, le=9.7, description="Cooling upwards, from the mixed layer to the inversion, K/km."
    )
    inversion_m: Positive = Field(2250.0, le=20_000, description="Height of the inversion, metres.")
    inversion_jump_k: NonNegative = Field(4.0, le=30, description="Warming across it, K.")
    wind_m_per_s: NonNegative = Field(2.0, le=30, description="Speed of the wind, from the site's wind_from_deg.")

    @property
    def sides_m(self) -> tuple[float, float]:
        """Least sides of the box of air, to the east and to the north."""
        return self.extent_m if isinstance(self.extent_m, tuple) else (self.extent_m, self.extent_m)

    @model_validator(mode="after")
    def _not_too_large(self) -> Self:
        east, north = self.sides_m
        cells = east * north / self.cell_m**2 * self.height_m / self.cell_height_m
        if cells > MOST_CELLS:
            expected, hint = f"at most {MOST_CELLS:,} cells", "raise cell_m or cell_height_m, or lower extent_m"
            raise violation(expected, problem="too fine an air", got=f"{cells:,.0f}", hint=hint, at=("cell_m",))
        if min(east, north) < 8 * self.cell_m or self.height_m < 8 * self.cell_height_m:
            along = east / self.cell_m, north / self.cell_m, self.height_m / self.cell_height_m
            expected, got = "8 cells or more along each axis", " x ".join(f"{one:.3g}" for one in along)
            hint = "smaller cells, or a larger extent_m and height_m"
            raise violation(expected, problem="too coarse an air", got=got, hint=hint, at=("cell_m",))
        return self


#: Numbers of `SoilWaterParameters` by the kind of soil. Drylands' are its defaults (Rietkerk et al. 2002). A forest's
#: soil takes up in an hour what falls, holds water for months, and lets leaves of an area index of 5 have 4 mm a day.
KINDS: dict[str, dict[str, float]] = {
    "dryland": {},
    "forest": {
        "uptake_mm_m2_per_g_day": 0.012,
        "half_uptake_mm": 40.0,
        "infiltration_per_day": 24.0,
        "half_infiltration_g_per_m2": 50.0,
        "bare_infiltration": 0.3,
        "loss_per_day": 0.01,
        "soil_speed_m_per_day": 0.05,
        "surface_speed_m_per_day": 5000.0,
    },
}


class SoilWaterSection(Section):
    """How water enters the soil, moves and leaves it; keys that are left out are those of the kind of soil."""

    kind: Literal["forest", "dryland"] = Field("forest", description="What the other keys are by default.")
    cell_m: Positive = Field(1.5, ge=0.25, le=100, description="Side of a cell of the maps of water, metres.")
    substep_days: Positive = Field(0.5, le=31, description="Longest step of the water, days; for accuracy alone.")
    leaf_mass_g_per_m2: NonNegative = Field(
        70.0, le=1000, description="Dry mass of a square metre of leaf: what the density of plants is counted by."
    )
    reference_g_per_m2: NonNegative = Field(
        0.0, le=1e5, description="Leaf mass of the stand in which a species' precipitation is enough; 0: of bare soil."
    )
    evaporating_share: Fraction = Field(
        0.2, description="Share of what the soil loses that evaporates; the rest drains away."
    )
    uptake_mm_m2_per_g_day: NonNegative | None = Field(
        None, le=100, description="The most water a gram of leaves takes up."
    )
    half_uptake_mm: Positive | None = Field(None, le=1e4, description="Soil water at which uptake is half its most.")
    infiltration_per_day: NonNegative | None = Field(
        None, le=1e4, description="Infiltration among dense plants, as a rate of surface water."
    )
    half_infiltration_g_per_m2: Positive | None = Field(
        None, le=1e5, description="Leaf mass at which infiltration is halfway between bare and dense."
    )
    bare_infiltration: Fraction | None = Field(None, description="Share of the infiltration that bare soil has.")
    loss_per_day: NonNegative | None = Field(
        None, le=100, description="Evaporation and drainage, as a rate of soil water."
    )
    soil_diffusion_m2_per_day: NonNegative | None = Field(None, le=1e5, description="Spread of soil water.")
    surface_diffusion_m2_per_day: NonNegative | None = Field(None, le=1e7, description="Spread of surface water.")
    soil_speed_m_per_day: NonNegative | None = Field(
        None, le=1e5, description="Of soil water downhill, on a gradient of 1."
    )
    surface_speed_m_per_day: NonNegative | None = Field(
        None, le=1e7, description="Of surface water downhill, on a gradient of 1."
    )
    half_infiltration_gradient: Positive | None = Field(
        None, description="Gradient of the ground at which infiltration is halved."
    )

    def water(self) -> SoilWaterParameters:
        """The numbers of the soil model."""
        values = {name: getattr(self, name) for name in SoilWaterParameters.__dataclass_fields__}
        own = {name: value for name, value in values.items() if value is not None}
        return SoilWaterParameters(**{**KINDS[self.kind], **own})


class GlobalSeeding(Section):
    """Seeds from elsewhere, evenly over the site; how many come up goes by how well the place suits them (Eq. 38)."""

    species: tuple[Name, ...] = Field((), description="Which; left out: all that grow.")
    seeds_per_ha: NonNegative = Field(10.0, le=1e5, description="Of each species, each time.")
    every_yr: Positive = Field(1.0, ge=0.01, le=1e5, description="Time between, years.")
    from_yr: NonNegative = Field(0.0, le=1e6, description="When the first come, years.")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for index, name in enumerate(self.species):
            if name in self.species[:index]:
                raise violation("each species once", got=name, at=("species", index))
        return self

    def step(self, step_yr: float) -> int:
        """The first step at whose end seeds have come."""
        return first_step_after(self.from_yr, step_yr)

    def times_before(self, month: int) -> int:
        """How often they have come before this month since the beginning."""
        slack = 1e-9  # a time that is that of a month is not missed by rounding
        return max(0, math.ceil((month / MONTHS_PER_YR - self.from_yr) / self.every_yr - slack))


class EcoclimateParameters(BranchModulesParameters):
    """What a recipe says about the model besides its species."""

    timed_keys: ClassVar[Mapping[str, type[Any]]] = {
        **BranchModulesParameters.timed_keys,
        "climate_changes": ClimateChange,
        "global_seeding": GlobalSeeding,
    }
    memory_hint: ClassVar[str] = (
        "make the site smaller, community.soil_water.cell_m larger, or lower community.most_modules"
    )

    step_yr: float = Field(1 / 12, ge=1e-3, le=10, description="duration of a step of the plants, years: whole months")
    climate: Climate = Field(
        description="normals by month: of a place, or twelve temperatures and twelve precipitations"
    )
    climate_changes: tuple[ClimateChange, ...] = Field((), max_length=1000, description="how the climate changes")
    microclimate: Flag = Field(
        True, description="whether plants go by the water and shade where they stand; false: by the site's mean"
    )
    soil_water: SoilWaterSection = Field(
        default_factory=lambda: SoilWaterSection.model_validate({}), description="how water moves on and in the soil"
    )
    memory_yr: NonNegative = Field(
        1.0, le=100, description="years over which plants feel warmth and wetness: the decay of a weighted mean"
    )
    shade_cooling_k: NonNegative = Field(
        4.0, le=30, description="what complete shade is cooler than open ground [T_sh], K"
    )
    global_seeding: tuple[GlobalSeeding, ...] = Field((), max_length=100, description="seeds from elsewhere")
    weather: WeatherSection | None = Field(
        None, description="days of each month whose air is simulated over the forest; null: rain falls evenly"
    )

    @property
    def months_per_step(self) -> int:
        """Of the soil and the climate."""
        return round(self.step_yr * MONTHS_PER_YR)

    @model_validator(mode="before")
    @classmethod
    def _one_climate(cls, data: Any) -> Any:
        for key in ("temperature_c", "precipitation_mm_per_yr", "biome"):
            if isinstance(data, dict) and data.get(key) is not None:
                raise violation("climate", problem=f"two climates: {key} beside the months'", at=(key,))
        return data

    @model_validator(mode="after")
    def _whole_months(self) -> Self:
        months = self.step_yr * MONTHS_PER_YR
        if round(months) < 1 or not math.isclose(months, round(months), rel_tol=1e-6):
            raise violation(
                "a whole number of months, such as 1/12 = 0.0833333333 or 1", got=f"{self.step_yr:g}", at=("step_yr",)
            )
        return self

    @model_validator(mode="after")
    def _vapour_of_air(self) -> Self:
        for index, one in enumerate(self.climate_changes):
            if one.vapour != 1.0 and self.weather is None:
                expected, problem = "weather, whose clouds go by it", "vapour without air"
                got, hint = f"vapour: {one.vapour:g}, and no weather", "add weather: {}, or change precipitation"
                raise violation(expected, problem=problem, got=got, hint=hint, at=("climate_changes", index, "vapour"))
        return self

    @model_validator(mode="after")
    def _one_grid(self) -> Self:
        """Maps of water keep their cells, whatever changes."""
        for index, one in enumerate(self.changes):
            soil = one.set.get("soil_water")
            if not isinstance(soil, dict):
                continue
            cell_m = soil.get("cell_m", SoilWaterSection.model_fields["cell_m"].default)
            if isinstance(cell_m, int | float) and cell_m != self.soil_water.cell_m:
                expected = f"cell_m: {self.soil_water.cell_m:g}, as at the start"
                problem, got = "the cells of water hold for the whole simulation", f"{cell_m:g}"
                raise violation(expected, problem=problem, got=got, at=("changes", index, "set", "soil_water"))
        return self

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        for index, one in enumerate(self.global_seeding):
            yield from ((("global_seeding", index, "species", k), name) for k, name in enumerate(one.species))


def seedings_in_time(parameters: EcoclimateParameters) -> list[tuple[str, tuple[GlobalSeeding, ...]]]:
    """The seeds from elsewhere at the start, and as each change gives them, with their places."""
    values = values_in_time(parameters, "global_seeding")
    return [(place, tuple(GlobalSeeding.model_validate(one) for one in value or ())) for place, value in values]
