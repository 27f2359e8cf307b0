"""What a recipe says about an ecoclimate besides what it says about its forest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from forestgen.community.branch_modules.changes import values_in_time
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.ecoclimate.climate import MONTHS_PER_YR, MonthlyClimate, Turn, climate_of
from forestgen.community.ecoclimate.weather_section import WeatherSection
from forestgen.community.soil_water.parameters import SoilWaterParameters
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Flag, Fraction, Name, NonNegative, Number, Positive, Section, Text, mistake
from forestgen.recipe.sources import Keys

_Twelve = Field(min_length=MONTHS_PER_YR, max_length=MONTHS_PER_YR)
_Warmth = Annotated[Number, Field(ge=-60, le=60)]
_Rain = Annotated[NonNegative, Field(le=5000)]

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
            raise mistake("a place, or temperature_c and precipitation_mm", problem="half a climate", at=(missing,))
        if self.place is not None:
            try:
                climate_of(self.place)
            except RecipeError as error:
                raise mistake(
                    error.expected or "a place", problem=error.problem, got=self.place, hint=error.hint, at=("place",)
                ) from error
        return self

    def normals(self) -> MonthlyClimate:
        """The twelve months; numbers that are given take the place's places."""
        if self.place is not None:
            of_place = climate_of(self.place)
            return MonthlyClimate(
                self.temperature_c or of_place.temperature_c, self.precipitation_mm or of_place.precipitation_mm
            )
        assert self.temperature_c is not None
        assert self.precipitation_mm is not None
        return MonthlyClimate(self.temperature_c, self.precipitation_mm)


def _first_after(time_yr: float, step_yr: float) -> int:
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
            raise mistake(f"from_yr = {self.from_yr:g} or more", got=f"{self.to_yr:g}", at=("to_yr",))
        return self

    def step(self, step_yr: float) -> int:
        """The first step at whose end it has begun."""
        return _first_after(self.from_yr, step_yr)

    @property
    def turn(self) -> Turn:
        return Turn(self.from_yr, self.to_yr, self.precipitation, self.temperature_k, self.vapour)


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
        own = {
            name: getattr(self, name)
            for name in SoilWaterParameters.__dataclass_fields__
            if getattr(self, name) is not None
        }
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
                raise mistake("each species once", got=name, at=("species", index))
        return self

    def step(self, step_yr: float) -> int:
        """The first step at whose end seeds have come."""
        return _first_after(self.from_yr, step_yr)

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

    @property
    def turns(self) -> tuple[Turn, ...]:
        return tuple(one.turn for one in self.climate_changes)

    @model_validator(mode="before")
    @classmethod
    def _one_climate(cls, data: Any) -> Any:
        for key in ("temperature_c", "precipitation_mm_per_yr", "biome"):
            if isinstance(data, dict) and data.get(key) is not None:
                raise mistake("climate", problem=f"two climates: {key} beside the months'", at=(key,))
        return data

    @model_validator(mode="after")
    def _whole_months(self) -> Self:
        months = self.step_yr * MONTHS_PER_YR
        if round(months) < 1 or not math.isclose(months, round(months), rel_tol=1e-6):
            raise mistake(
                "a whole number of months, such as 1/12 = 0.0833333333 or 1", got=f"{self.step_yr:g}", at=("step_yr",)
            )
        return self

    @model_validator(mode="after")
    def _vapour_of_air(self) -> Self:
        for index, one in enumerate(self.climate_changes):
            if one.vapour != 1.0 and self.weather is None:
                raise mistake(
                    "weather, whose clouds go by it",
                    problem="vapour without air",
                    got=f"vapour: {one.vapour:g}, and no weather",
                    hint="add weather: {}, or change precipitation",
                    at=("climate_changes", index, "vapour"),
                )
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
                raise mistake(
                    f"cell_m: {self.soil_water.cell_m:g}, as at the start",
                    problem="the cells of water hold for the whole simulation",
                    got=f"{cell_m:g}",
                    at=("changes", index, "set", "soil_water"),
                )
        return self

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        for index, one in enumerate(self.global_seeding):
            yield from ((("global_seeding", index, "species", k), name) for k, name in enumerate(one.species))


def seedings_in_time(parameters: EcoclimateParameters) -> list[tuple[str, tuple[GlobalSeeding, ...]]]:
    """The seeds from elsewhere at the start, and as each change gives them, with their places."""
    told = values_in_time(parameters, "global_seeding")
    return [(place, tuple(GlobalSeeding.model_validate(one) for one in value or ())) for place, value in told]
