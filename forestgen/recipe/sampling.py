"""The recipe's section ``sampling``: how the images' draws are spread, tied together and shared."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from forestgen.recipe.curves import RESERVED
from forestgen.recipe.fields import Number, Section, Text, Whole, mistake
from forestgen.recipe.points import Method

MOST_CELLS = 10_000
_Key = Annotated[Text, Field(min_length=1, max_length=300)]
_Variable = Annotated[Text, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
_Level = bool | int | float | str | None


def _is_strata(value: Any) -> Any:
    number = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_CELLS
    levels = isinstance(value, list | tuple) and not any(isinstance(one, dict | list | tuple) for one in value)
    if value == "all" or number or levels:
        return value
    raise mistake(f"all, a number of bins from 1 to {MOST_CELLS}, or a list of the choice's values")


_Strata = Annotated[Literal["all"] | Whole | tuple[_Level, ...], BeforeValidator(_is_strata)]


class Correlation(Section):
    """Two correlated drawn values."""

    keys: tuple[_Key, _Key] = Field(description="Two keys or variables that are drawn.")
    rank: Number = Field(
        gt=-1, lt=1, description="Spearman's rank correlation: 0 none, near 1 both are high at the same time."
    )

    @field_validator("keys")
    @classmethod
    def _differ(cls, value: tuple[str, str]) -> tuple[str, str]:
        if value[0] == value[1]:
            raise mistake("two different keys", problem="a key correlated with itself", got=value[0])
        return value


class Sampling(Section):
    """How the draws of a recipe's images are spread over their ranges, correlated and shared."""

    method: Method = Field(
        default="independent",
        description="independent: each value by itself. latin_hypercube, sobol, halton: the values of all `keys` are "
        "spread evenly over the images of each split.",
    )
    block: Whole = Field(
        default=128, ge=2, le=65_536, description="Of latin_hypercube: images of a split that make a whole hypercube."
    )
    keys: tuple[_Key, ...] | None = Field(
        default=None,
        min_length=1,
        description="Keys or variables that the method spreads, such as sky.sun.elevation_deg. Default: all that are "
        "drawn.",
    )
    strata: dict[_Key, _Strata] = Field(
        default={},
        description="Key or variable -> number of equally likely bins; or all, each value of a choice; or a list of "
        "these values. Among as many images of a split as there are cells, each cell is met once.",
    )
    correlations: tuple[Correlation, ...] = Field(
        default=(), description="Pairs of correlated drawn values.", max_length=1000
    )
    variables: dict[_Variable, Any] = Field(
        default={},
        max_length=100,
        description="Name -> a distribution, a value or a formula of other variables. {variable: NAME} or {formula: "
        "'10 + 30 * NAME'} stands for any number of the recipe.",
    )

    @field_validator("variables")
    @classmethod
    def _own_names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if name in RESERVED:
                taken = ", ".join(sorted(RESERVED))
                raise mistake(f"another name than {taken}", problem="formulas use this name", got=name, at=name)
        return value

    @model_validator(mode="after")
    def _keys_have_their_method(self) -> Self:
        needed = {"keys": ("latin_hypercube", "sobol", "halton"), "block": ("latin_hypercube",)}
        for name, methods in needed.items():
            if name in self.model_fields_set and self.method not in methods and getattr(self, name) is not None:
                expected = f"method: {' or '.join(methods)}, where there is {name}"
                at = "method" if "method" in self.model_fields_set else name
                raise mistake(expected, problem=f"the method {self.method} has no {name}", got=self.method, at=at)
        return self
