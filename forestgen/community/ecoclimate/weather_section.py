"""What a recipe says about the air of an ecoclimate."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from forestgen.community.ecoclimate.climate import MONTHS, MONTHS_PER_YR
from forestgen.recipe.fields import Fraction, NonNegative, Number, Positive, Section, Whole, mistake

MOST_CELLS = 4_000_000
_MOST_WATTS = 1000.0


def _one_or_twelve(value: Any) -> Any:
    """What is wrong with a list of months, told at its place; the rest is the schema's."""
    if isinstance(value, list | tuple):
        if len(value) != MONTHS_PER_YR:
            raise mistake("one number, or twelve with January first", got=f"{len(value)} of them")
        for index, one in enumerate(value):
            if isinstance(one, bool) or not isinstance(one, int | float) or not 0 <= one <= _MOST_WATTS:
                raise mistake(f"numbers from 0 to {_MOST_WATTS:g}", got=f"{one} in {MONTHS[index]}")
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
        60.0,
        description="Vapour that the region brings in [E_M], as its latent heat, W/m2; or of twelve months.",
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

    def heat_of(self, of_year: int) -> float:
        """Heat from open ground in a month of the year, 0 to 11, W/m2."""
        return _of_month(self.heat_w_per_m2, of_year)

    def vapour_of(self, of_year: int) -> float:
        """The region's vapour in a month of the year, 0 to 11, W/m2."""
        return _of_month(self.vapour_w_per_m2, of_year)

    @model_validator(mode="after")
    def _not_too_large(self) -> Self:
        east, north = self.sides_m
        cells = east * north / self.cell_m**2 * self.height_m / self.cell_height_m
        if cells > MOST_CELLS:
            raise mistake(
                f"at most {MOST_CELLS:,} cells",
                problem="too fine an air",
                got=f"{cells:,.0f}",
                hint="raise cell_m or cell_height_m, or lower extent_m",
                at=("cell_m",),
            )
        if min(east, north) < 8 * self.cell_m or self.height_m < 8 * self.cell_height_m:
            along = east / self.cell_m, north / self.cell_m, self.height_m / self.cell_height_m
            raise mistake(
                "8 cells or more along each axis",
                problem="too coarse an air",
                got=" x ".join(f"{one:.3g}" for one in along),
                hint="smaller cells, or a larger extent_m and height_m",
                at=("cell_m",),
            )
        return self


def _of_month(values: float | tuple[float, ...], of_year: int) -> float:
    return values[of_year] if isinstance(values, tuple) else values
