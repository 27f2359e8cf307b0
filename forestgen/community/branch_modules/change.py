"""Parameters that change at a time of the simulation: the recipe's entries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Self

from pydantic import Field, model_validator

from forestgen.community.disturbance import KINDS
from forestgen.recipe.fields import NonNegative, Section, mistake
from forestgen.recipe.messages import show
from forestgen.recipe.suggestions import nearest

#: Keys of the section that a simulation starts with, and cannot change on its way.
FIXED = (
    "steps", "step_yr", "periodic", "disturbances", "initial_plants", "biome", "soil", "changes",
    "standing_dead_yr", "dieback_share", "most_modules", "history_modules",
)  # fmt: skip


class Change(Section):
    """Other values of some parameters."""

    at_yr: NonNegative = Field(le=1e6, description="Time from which they hold, years.")
    set: dict[str, Any] = Field(
        min_length=1, description="New values by key: of this section, or species.NAME.KEY of a species' modules."
    )

    @model_validator(mode="before")
    @classmethod
    def _is_no_disturbance(cls, data: Any) -> Any:
        for key in data if isinstance(data, Mapping) else ():
            kind = None if key in cls.model_fields else nearest(str(key), KINDS)
            if kind is not None:
                raise mistake(
                    "at_yr and set",
                    problem=f"unknown key {str(key)!r}",
                    hint=f"a change sets numbers; write disturbances: [{{at_yr: ..., {kind}: ...}}] beside changes",
                    at=(str(key),),
                )
        return data

    @model_validator(mode="after")
    def _can_be_changed(self) -> Self:
        for key in self.set:
            if key in FIXED:
                raise mistake(
                    "a key that may change with time",
                    problem=f"{key} holds for the whole simulation",
                    got=show(self.set[key]),
                    at=("set", key),
                )
            if key.startswith("species") and species_key(key) is None:
                raise mistake(
                    "species.NAME.KEY, such as species.pine.shade_tolerance",
                    problem="this names no key of a species",
                    got=repr(key),
                    at=("set", key),
                )
        return self

    def step(self, step_yr: float) -> int:
        """The step at whose end it is made."""
        # Whole numbers of steps, such as 0.3 years in steps of 0.1, must not be missed by a rounding error.
        return math.ceil(self.at_yr / step_yr * (1 - 1e-9))


def species_key(key: str) -> tuple[str, str] | None:
    """Name and key of ``species.NAME.KEY``; None: a key of the section itself."""
    parts = key.split(".")
    return (parts[1], parts[2]) if len(parts) == 3 and parts[0] == "species" else None
