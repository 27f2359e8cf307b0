"""Types of the recipe's fields, shared by every section and free for models and generators to use."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    Strict,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError

from forestgen.core.errors import RecipeError
from forestgen.core.registry import Registry
from forestgen.recipe.suggestions import did_you_mean

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


class GivenSection(Section):
    """A section whose keys may all be left out; it is written down as it was given."""

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


def part_name(registry: Registry) -> tuple[AfterValidator, FieldInfo]:
    """Validator and JSON Schema of a registered part's name, for ``Annotated[Text, *part_name(...)]``."""

    def known(name: str) -> str:
        try:
            registry.check(name)
        except RecipeError as error:
            raise _as_violation(error) from error
        return name

    return AfterValidator(known), Field(json_schema_extra=partial(_add_names, registry=registry))


def _add_names(schema: dict[str, Any], registry: Registry) -> None:
    """Add to the JSON Schema of a part's name the names that are registered when it is made, and descriptions."""
    schema["enum"] = registry.ids()
    about = "; ".join(f"{name}: {registry.describe(name)}" for name in registry)
    schema["description"] = f"{schema.get('description', 'The part.')} {about}."


def each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    """A validator that refuses a name that stands twice in a list."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise violation("each one once", problem="a name that stands twice", got=name, at=(index,))
    return names


class PartSection(Section):
    """A section whose key `selector` names a part of a registry, which has all other keys.

    The class with the `registry` is the section's type in the recipe. Each part has a class `Parameters` based on it,
    which validates the section where it names the part. Where a part's class allows extra keys, those are the keys of
    the registry's other parts: so a recipe can draw the part's name and give the keys of all.
    """

    registry: ClassVar[Registry]
    selector: ClassVar[str]
    instead: ClassVar[Mapping[str, str]] = {}  # key of other parts -> what to do without it in this one, for messages

    @classmethod
    def named_by(cls, data: Mapping[str, Any]) -> Any:
        """The part's name in a section."""
        name = data.get(cls.selector)
        return cls.model_fields[cls.selector].default if name is None else name

    @classmethod
    def class_for(cls, data: object) -> type[Self]:
        """The class that validates a section; `cls` itself, which has no further keys, if no part is named."""
        if "registry" not in vars(cls) or not isinstance(data, Mapping) or not isinstance(cls.named_by(data), str):
            return cls
        try:
            part = cls.registry.load(cls.named_by(data))
        except RecipeError as error:
            raise _as_violation(error, at=cls.selector) from error
        parameters: type[Self] = part.Parameters
        return parameters

    @model_validator(mode="wrap")
    @classmethod
    def _of_its_part(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        own = cls.class_for(data)
        if own is cls:
            return handler(data)
        known = {key: value for key, value in data.items() if key in own.model_fields or value is not None}
        for key in sorted(known.keys() - own.model_fields.keys(), key=str):
            cls._check_key(key, known, own)
        return own.model_validate({**known, cls.selector: cls.named_by(data)})

    @classmethod
    def _check_key(cls, key: str, data: Mapping[str, Any], own: type[PartSection]) -> None:
        """Check a key that the named part does not have."""
        parameters = {name: part.Parameters for name, part in cls.registry.parts()}
        owners = {name: one for name, one in parameters.items() if key in one.model_fields}
        if owners and own.model_config.get("extra") == "allow":
            name, owner = next(iter(owners.items()))
            try:
                owner.model_validate({cls.selector: name, key: data[key]})
            except ValidationError as failure:
                if any(details["loc"][:1] == (key,) for details in failure.errors()):
                    raise
        elif own.model_config.get("extra") == "allow":
            keys = {inner for one in parameters.values() for inner in one.model_fields}
            hint = did_you_mean(key, keys, cutoff=0.5)
            raise violation("one of " + ", ".join(sorted(keys)), problem=f"unknown key {key!r}", hint=hint, at=(key,))
        elif owners:
            problem = f"the {cls.registry.kind} {cls.named_by(data)} has no {key}"
            hint, at = own.instead.get(key, f"leave {key} out, or choose {cls.selector}: {' or '.join(owners)}"), (key,)
            raise violation("one of " + ", ".join(sorted(own.model_fields)), problem=problem, got=key, hint=hint, at=at)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """With the keys of all parts, where the class stands for all."""
        schema = handler(core_schema)
        if "registry" in vars(cls):
            properties = handler.resolve_ref_schema(schema)["properties"]
            for _, part in cls.registry.parts():
                own = handler(part.Parameters.__pydantic_core_schema__)
                for key, value in handler.resolve_ref_schema(own)["properties"].items():
                    properties.setdefault(key, value)
            _add_names(properties[cls.selector], cls.registry)
        return schema


def violation(
    expected: str,
    *,
    problem: str = "bad value",
    got: str | None = None,
    hint: str | None = None,
    at: str | tuple[str | int, ...] = (),
) -> PydanticCustomError:
    """Error for a validator to raise; `forestgen.recipe.messages` turns it into a `RecipeError`.

    `at` is the key, or the path of keys, from the validated value to the one at fault.
    """
    path = (at,) if isinstance(at, str) else at
    context = {"problem": problem, "expected": expected, "got": got, "hint": hint, "at": path}
    return PydanticCustomError("violation", "{problem}: expected {expected}", context)


def _as_violation(error: RecipeError, at: str = "") -> PydanticCustomError:
    return violation(error.expected or "", problem=error.problem, got=error.got, hint=error.hint, at=at or ())


def spelled_out(value: Any, key: str, of: type = str) -> Any:
    """A shorthand such as ``terrain: flat`` as the mapping that it stands for."""
    return {key: value} if isinstance(value, of) else value


def extent_m(site: Any) -> tuple[float, float]:
    """A recipe's site's extent; its default instead of a bad one, which is left for validation to name."""
    size = site.get("size_m") if isinstance(site, Mapping) else None
    pair = size if isinstance(size, list | tuple) and len(size) == 2 else (0, 0)
    good = all(isinstance(extent, int | float) and 0 < extent <= 5000 for extent in pair)
    return (float(pair[0]), float(pair[1])) if good else (100.0, 100.0)


def shorthand(key: str, of: type = str) -> tuple[BeforeValidator, FieldInfo]:
    """For ``Annotated[Section, *shorthand(...)]``: the section may be written as the value of its `key` alone.

    `of` is the value's type. `forestgen.recipe.json_schema` reads what the JSON Schema says of it.
    """
    return BeforeValidator(partial(spelled_out, key=key, of=of)), Field(json_schema_extra={"shorthand": key})


def _no_text_for_whole_number(value: Any) -> Any:
    # Lax integers also take "16" and true; 16.0 is accepted because YAML writes 1e3 as a float.
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
