"""The recipe's sky: sun, sky model (a part; render/skies) and clouds, whose sources are parts (atmosphere/clouds)."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from forestgen.recipe.fields import (
    Fraction,
    GivenSection,
    NonNegative,
    Number,
    PartSection,
    Positive,
    Text,
    shorthand,
    violation,
)
from forestgen.recipe.map_files import Sha256
from forestgen.recipe.registries import CLOUD_SOURCES, SKIES

FileName = Annotated[Text, Field(min_length=1, max_length=4000)]
YEARS = (1700, 2200)
_ANGLES, _DATE = ("elevation_deg", "azimuth_deg"), ("date", "time", "utc_offset_h")
_ELEVATION_DEG, _AZIMUTH_DEG = 40.0, 140.0
_CLOCK = re.compile(r"^(\d{1,2}):(\d{2})(?::(\d{2}))?$", re.ASCII)


class NamedFile(GivenSection):
    """A file beside the recipe, known by its content."""

    file: FileName = Field(description="Its path, relative to the recipe's folder.")
    sha256: Sha256 | None = Field(
        None, description="SHA-256 of its content, written when the recipe is loaded; another file is refused."
    )


class Clouds(PartSection, GivenSection):
    """The clouds above the site, or around it."""

    registry = CLOUD_SOURCES
    selector = "type"
    has_clouds: ClassVar[bool] = True  # whether there are ever any

    type: Text = Field("none", description="Where the clouds come from.")

    @property
    def known_cover(self) -> float | None:
        """Share of the sky's area under cloud, where the recipe itself says it."""
        return None

    @classmethod
    def named_by(cls, data: Mapping[str, Any]) -> Any:
        """The type; of a story its first chapter's."""
        story = data.get("story")
        if data.get("type") is None and isinstance(story, list | tuple) and story and isinstance(story[0], Mapping):
            return story[0].get("type", cls.model_fields["type"].default)
        return super().named_by(data)


class CirrusSection(GivenSection):
    """Thin high clouds of ice."""

    cover: Fraction = Field(0.6, description="Of cirrus: fraction of the sky's area under cloud, 0 to 1.")
    optical_depth: Positive = Field(
        0.2, le=3, description="Of cirrus: mean optical depth of the cloudy part; thin cirrus have 0.05 to 0.5."
    )
    base_m: Positive = Field(9000.0, le=18000, description="Of cirrus: height of the base above ground, metres.")
    thickness_m: Positive = Field(900.0, le=4000, description="Of cirrus: height of the layer, metres.")
    streak_m: NonNegative = Field(
        4000.0, le=20000, description="Of cirrus: length of the streaks of falling ice, metres."
    )
    extent_m: Positive = Field(
        60000.0,
        le=100000,
        description="Of cirrus: side of the square of clouds, metres. Three by three of them are seen: of 60 km each "
        "and 9 km up, down to 6 degrees above the horizon.",
    )


class CloudsBelowCirrus(Clouds):
    """Clouds that may have cirrus far above them."""

    cirrus: CirrusSection | None = Field(
        None, description="Thin high clouds of ice above these, with the keys of type: cirrus. Default: none."
    )


class Sun(GivenSection):
    """Where the sun stands: by its angles, or by date, time and the site's place on earth."""

    elevation_deg: Number | None = Field(
        None,
        ge=-90,
        le=90,
        description="Height above the horizon as it is seen, degrees; below 0 it is dusk, below -18 night. Default 40, "
        "without a date.",
    )
    azimuth_deg: Number | None = Field(
        None,
        ge=-360,
        le=360,
        description="Direction clockwise from north, degrees: 90 is east. Default 140, without a date.",
    )
    date: Text | None = Field(
        None,
        max_length=40,
        description="Day, YYYY-MM-DD, with time and utc_offset_h; or both with their offset as 2026-06-21T14:30+02:00. "
        "Needs site.latitude_deg and site.longitude_deg.",
    )
    time: Annotated[Number, Field(ge=0, lt=24)] | Text | None = Field(
        None, description="Of the clock, 'HH:MM' or 'HH:MM:SS', or hours since midnight, such as 14.5."
    )
    utc_offset_h: Number | None = Field(
        None, ge=-12, le=14, description="What the clock is ahead of UTC, hours: 2 in central Europe's summer."
    )

    @property
    def moment(self) -> datetime.datetime | None:
        """Date and time, with its offset from UTC; None where the sun is given by angles."""
        if self.date is None:
            return None
        if self.time is None or self.utc_offset_h is None:
            return datetime.datetime.fromisoformat(self.date)
        zone = datetime.timezone(datetime.timedelta(hours=self.utc_offset_h))
        midnight = datetime.datetime.combine(datetime.date.fromisoformat(self.date), datetime.time(), zone)
        return midnight + datetime.timedelta(hours=_hours(self.time))

    @model_validator(mode="before")
    @classmethod
    def _angles_by_default(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or any(data.get(key) is not None for key in _DATE):
            return data
        given = {key: value for key, value in data.items() if value is not None or key not in _ANGLES}
        return {"elevation_deg": _ELEVATION_DEG, "azimuth_deg": _AZIMUTH_DEG, **given}

    @field_validator("date")
    @classmethod
    def _is_date(cls, value: str | None) -> str | None:
        expected = "a day as 2026-06-21, or with time and offset from UTC as 2026-06-21T14:30+02:00"
        if value is None:
            return None
        try:
            moment = datetime.datetime.fromisoformat(value)
        except ValueError as cause:
            raise violation(expected, problem="not a date") from cause
        if len(value) > 10 and moment.tzinfo is None:
            hint = "add the offset: Z is UTC, +02:00 central Europe's summer"
            raise violation(expected, problem="a time without its offset from UTC", hint=hint)
        if not YEARS[0] <= moment.year <= YEARS[1]:
            raise violation(f"a year from {YEARS[0]} to {YEARS[1]}", problem="too far away")
        return value

    @field_validator("time", mode="before")
    @classmethod
    def _is_time(cls, value: Any) -> Any:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        good = (number and 0 <= value < 24) or (isinstance(value, str) and _hours(value) < 24)
        if value is not None and not good:
            raise violation("'HH:MM' or 'HH:MM:SS', or hours since midnight from 0 to 24", problem="not a time of day")
        return value

    @model_validator(mode="after")
    def _angles_or_date(self) -> Self:
        given = [key for key in _DATE if getattr(self, key) is not None]
        if not given:
            return self
        angles = [key for key in _ANGLES if getattr(self, key) is not None]
        if angles:
            expected, hint = "elevation_deg and azimuth_deg; or date, time and utc_offset_h", " and ".join(angles)
            problem, got = "the sun is given twice, by angle and by date", ", ".join(angles + given)
            raise violation(expected, problem=problem, got=got, hint=f"leave out {hint} or the date", at=angles[0])
        needed = ("date",) if self.date is not None and len(self.date) > 10 else _DATE
        missing = [key for key in needed if key not in given]
        if missing:
            hint = "add " + " and ".join(f"{key}: {_EXAMPLES[key]}" for key in missing)
            raise violation(" and ".join(needed), problem="half a date", got=", ".join(given), hint=hint, at=given[0])
        if given != list(needed):
            problem, hint = "the time is given twice, in the date and beside it", "leave out time and utc_offset_h"
            raise violation(" and ".join(needed), problem=problem, got=", ".join(given), hint=hint, at=given[1])
        return self


class Moon(GivenSection):
    """Where the moon stands, and its phase."""

    elevation_deg: Number = Field(40.0, ge=-90, le=90, description="Height above the horizon, degrees.")
    azimuth_deg: Number = Field(140.0, ge=-360, le=360, description="Direction clockwise from north, degrees.")
    illuminated: Fraction | None = Field(
        None,
        description="Share of its disc that is lit: 1 is full, 0.5 half. Default: by its angle from the sun.",
    )


_EXAMPLES = {"date": "2026-06-21", "time": "'14:30'", "utc_offset_h": "2"}


def _hours(time: float | str) -> float:
    """Since midnight; infinite for what is no time."""
    if not isinstance(time, str):
        return time
    match = _CLOCK.match(time)
    if match is None:
        return float("inf")
    hours, minutes, seconds = (int(part or 0) for part in match.groups())
    return hours + minutes / 60 + seconds / 3600 if minutes < 60 and seconds < 60 else float("inf")


class SkySection(PartSection):
    """Sun, clear or overcast sky, and clouds."""

    registry = SKIES
    selector = "kind"

    kind: Text = Field("clear", description="Model of the sky.")
    sun: Sun = Field(Sun.model_validate({}), description="Where the sun stands, by angles or by date.")
    moon: Moon | None = Field(
        None,
        description="Where the moon stands. Its light counts, and cameras see it, while the sun is below the horizon. "
        "None: where the sun's date puts it; without a date there is none.",
    )
    turbidity: Number = Field(3.0, ge=1, le=10, description="Haze: 1 is pure air, 3 clear, 10 hazy; no unit.")
    precipitable_water_mm: Number = Field(
        14.16,
        ge=0,
        le=100,
        description="Water vapour of the whole air column, mm: 5 in winter, 14 standard, 50 in the tropics.",
    )
    ozone_du: Number = Field(
        344.0, ge=0, le=1000, description="Ozone of the whole air column, Dobson units; 344 is standard."
    )
    visibility_m: Number | None = Field(
        None,
        ge=1000,
        le=300000,
        description="Haze between camera and scene: how far one sees, metres; 3000 is murky, 20000 usual, 100000 very "
        "clear. None: no haze. Below 1000 it is fog: see clouds.",
    )
    clouds: Annotated[SerializeAsAny[Clouds], *shorthand("type")] = Field(
        default_factory=lambda: Clouds.model_validate({}), description="The cloud field, or just its type."
    )
