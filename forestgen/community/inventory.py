"""Plants that a recipe lists, one by one or as a table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from forestgen.community.disturbance import PointOnGround
from forestgen.recipe.fields import Name, NonNegative, Number, Positive, Section, mistake

_NUMBERS = ("x_m", "y_m", "height_m", "radius_m", "age_yr", "azimuth_deg")


class PlacedPlant(Section):
    """One plant."""

    species: Name = Field(description="Its species, as the recipe names it.")
    position_m: PointOnGround = Field(description="Where it stands: x, y, metres; on the site.")
    radius_m: Positive | None = Field(
        None, description="Its radius, metres; null: by height_m, or the species' largest."
    )
    height_m: Positive | None = Field(None, description="Its height, metres; instead of radius_m.")
    age_yr: NonNegative = Field(0.0, description="Its age at the beginning, years.")
    azimuth_deg: Number | None = Field(
        None, ge=-360, le=360, description="Turn about the vertical, degrees clockwise from above; null: random."
    )

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        if self.radius_m is not None and self.height_m is not None:
            raise mistake("radius_m or height_m, not both", problem="the allometry gives one from the other")
        return self


def rows(table: str) -> list[PlacedPlant]:
    """The plants of a table.

    Raises
    ------
    PydanticCustomError : what is wrong, and in which line.
    """
    lines = [line for line in table.splitlines() if line.strip()]
    if len(lines) < 2:
        raise mistake(
            "a line of names (species, x_m, y_m, height_m) and a line for each plant",
            problem="not a table of plants",
            got=repr(table[:60]),
            hint="paste the file's text below `table: |`",
        )
    names = [name.strip() for name in next(csv.reader(lines[:1]))]
    unknown = [name for name in names if name not in (*_NUMBERS, "species")]
    missing = [name for name in ("species", "x_m", "y_m") if name not in names]
    if unknown or missing or len(set(names)) < len(names):
        raise mistake(
            "the names species, x_m, y_m, and any of height_m, radius_m, age_yr, azimuth_deg, each once",
            problem="the table's first line does not name its columns",
            got=lines[0].strip()[:100],
        )
    return [_plant(names, cells, number) for number, cells in enumerate(csv.reader(lines[1:]), start=1)]


def _plant(names: Sequence[str], cells: Sequence[str], number: int) -> PlacedPlant:
    if len(cells) != len(names):
        raise mistake(
            f"{len(names)} values: {', '.join(names)}",
            problem=f"row {number} of the table has another number of values",
            got=", ".join(cells)[:100],
        )
    given: dict[str, Any] = {}
    for name, cell in zip(names, (cell.strip() for cell in cells), strict=True):
        if not cell:
            continue
        try:
            given[name] = float(cell) if name in _NUMBERS else cell
        except ValueError:
            raise mistake("a number", problem=f"bad {name} in row {number} of the table", got=repr(cell[:40])) from None
    try:
        position_m = given.pop("x_m", None), given.pop("y_m", None)
        return PlacedPlant.model_validate({**given, "position_m": position_m})
    except ValidationError as error:
        first = error.errors()[0]
        where = " of ".join(str(part) for part in reversed(first["loc"]))
        raise mistake(
            f"{', '.join(names)} of a plant",
            problem=f"row {number} of the table is no plant ({f'{where}: ' if where else ''}{first['msg']})",
            got=", ".join(cells)[:100],
        ) from None
