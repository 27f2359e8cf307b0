"""Types of the recipe's fields, shared by every section and free for models and generators to use."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from forestgen.core.errors import RecipeError
from forestgen.core.registry import Registry

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
_CONTROL = r"\x00-\x1F\x7F-\x9F\u2028\u2029"
LABEL_PATTERN = rf"^[^\s{_CONTROL}]([^{_CONTROL}]*[^\s{_CONTROL}])?$"


class Section(BaseModel):
    """A section of the recipe: frozen, and a key that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class OpenSection(BaseModel):
    """A section that also carries the keys of a model or generator, which checks them itself."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    @property
    def parameters(self) -> dict[str, Any]:
        """The keys beyond the section's own, as the recipe gives them."""
        return dict(self.model_extra or {})


def part_name(registry: Registry) -> tuple[AfterValidator, FieldInfo]:
    """Validator and JSON Schema of a registered part's name, for ``Annotated[Text, *part_name(...)]``."""

    def known(name: str) -> str:
        try:
            registry.check(name)
        except RecipeError as error:
            raise mistake(error.expected or "", problem=error.problem, got=error.got, hint=error.hint) from error
        return name

    return AfterValidator(known), Field(json_schema_extra=partial(_add_names, registry=registry))


def _add_names(schema: dict[str, Any], registry: Registry) -> None:
    """To the JSON Schema of a part's name, the parts that are registered when it is made."""
    schema["enum"] = registry.ids()
    about = "; ".join(f"{name}: {registry.describe(name)}" for name in registry)
    schema["description"] = f"{schema.get('description', 'The part.')} {about}."


def mistake(
    expected: str,
    *,
    problem: str = "bad value",
    got: str | None = None,
    hint: str | None = None,
    at: tuple[str | int, ...] = (),
) -> PydanticCustomError:
    """Error for a validator to raise; `forestgen.recipe.messages` turns it into a `RecipeError`.

    `at` is the path from the validated value to the one at fault.
    """
    context = {"problem": problem, "expected": expected, "got": got, "hint": hint, "at": at}
    return PydanticCustomError("mistake", "{problem}: expected {expected}", context)


def spelled_out(value: Any, key: str) -> Any:
    """A shorthand such as ``terrain: flat`` as the mapping that it stands for."""
    return {key: value} if isinstance(value, str) else value


def _no_text_for_whole_number(value: Any) -> Any:
    # Lax integers also take "16" and true; 16.0 is welcome because YAML writes 1e3 as a float.
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("int_type", "a whole number")
    return value


Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_no_text_for_whole_number)]
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
Name = Annotated[str, Strict(), Field(pattern=NAME_PATTERN)]  # also of files and columns
Label = Annotated[str, Strict(), Field(max_length=200, pattern=LABEL_PATTERN)]  # for people and data sets alone
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Fraction = Annotated[Number, Field(ge=0, le=1)]
Coordinate = Annotated[Number, Field(ge=-1e5, le=1e5)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Colour = tuple[Fraction, Fraction, Fraction]
