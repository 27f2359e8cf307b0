"""Keys of the weather near the ground: wind, and a list of parts such as fog and rain (scene/weather)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from forestgen.recipe import fields
from forestgen.recipe.registries import WEATHER

MOST_WEATHER = 5


class Wind(fields.Section):
    """Wind at each plant's top, in which it leans and sways; it blows from site.wind_from_deg, by default the west."""

    speed_m_per_s: fields.NonNegative = Field(0.0, le=40, description="Mean speed, metres per second; 0: still air.")
    gustiness: fields.Fraction = Field(0.5, description="Amplitude of the sway by the mean lean, 0 to 1.")


class Weather(fields.PartSection):
    """One part of the weather."""

    registry = WEATHER
    selector = "what"

    what: Annotated[fields.Text, Field(description="What it is.")]
