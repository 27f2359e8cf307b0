"""What a recipe says about the plants to be placed: how many of each species, where, how large."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.static_model import StaticParameters
from forestgen.recipe.fields import Flag, Name, NonNegative, Positive, Section, Whole, mistake
from forestgen.recipe.sources import Keys

MOST_PLANTS = 20_000_000


class Sizes(Section):
    """A log-normal hierarchy of radii, cut off at the species' largest."""

    median: Positive = Field(le=100, description="Half of the plants would be smaller, were none cut off; metres.")
    sigma: NonNegative = Field(0.4, le=3, description="Standard deviation of the natural logarithm; 0: all are alike.")


def _one_size(value: Any) -> Any:
    return {"median": value, "sigma": 0.0} if isinstance(value, int | float) and not isinstance(value, bool) else value


class Stand(Section):
    """The plants of one species."""

    count: Whole | None = Field(None, ge=0, le=MOST_PLANTS, description="How many; or, instead, plants_per_ha.")
    plants_per_ha: NonNegative | None = Field(
        None, le=1e8, description="How many per hectare (10,000 m²) where map and conditions are 1; the sum is rounded."
    )
    map: DensityMap | None = Field(None, description="Relative density over the site, such as a painted picture.")
    conditions: Conditions = Field(Conditions(), description="What the species asks of the ground.")
    radius_m: Annotated[Sizes | None, BeforeValidator(_one_size)] = Field(
        None, description="Radii: a number, or {median, sigma} of a log-normal; null: median half of the largest."
    )
    height_sigma: NonNegative = Field(
        0.0, le=1, description="Scatter of heights about the species' allometry: deviation of the natural logarithm."
    )

    @model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.count is None) == (self.plants_per_ha is None):
            raise mistake(
                "count or plants_per_ha",
                problem="how many plants?" if self.count is None else "two numbers of plants",
                got=None if self.count is None else f"count {self.count} and plants_per_ha {self.plants_per_ha:g}",
            )
        return self


class PlacementParameters(StaticParameters):
    """What every placement model's recipe says."""

    memory_hint: ClassVar[str] = "ask for fewer plants in community.plants"

    plants: dict[Name, Stand] = Field({}, description="the plants of each species")
    keep_out: DensityMap | None = Field(
        None, description="where no plant of any species may stand: any value above 0 of this map bars"
    )
    periodic: Flag = Field(True, description="the site is a torus, without edges; false: a bounded site")

    @field_validator("plants", mode="before")
    @classmethod
    def _none_is_empty(cls, value: object) -> object:
        return {} if value is None else value

    def for_trial(self) -> Self:
        """Without plants: their numbers are those of the whole site, and all have the same columns."""
        return self.model_copy(update={"plants": {}})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("plants", name), name) for name in self.plants)
