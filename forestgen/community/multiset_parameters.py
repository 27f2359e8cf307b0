"""What a recipe says about a multiset L-system, and the program made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, WithJsonSchema, model_validator

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.plant_words import Form, form_of
from forestgen.community.registry import COMPETITION_MODELS, DEFAULT_COMPETITION_MODEL
from forestgen.core.errors import LsystemError
from forestgen.lsystem.compiler import Value, compile_program, settable, with_values
from forestgen.lsystem.parsing import parse_text
from forestgen.lsystem.program import Program
from forestgen.lsystem.syntax import ProgramAST
from forestgen.recipe.assets import find_asset
from forestgen.recipe.fields import Section, Text, mistake, part_name

OF_SPECIES = (
    "growth_m_per_yr", "max_radius_m", "shade_tolerance", "old_age_survival", "seedlings_per_ha_per_yr",
    "seedling_radius_m", "height_scale", "height_exponent",
)  # fmt: skip
OF_SITE = ("site_width_m", "site_height_m", "site_area_ha", "step_yr", "number_of_species")


class ProgramText(Section):
    """An L-system program."""

    name: Text = Field(description="name in messages")
    text: Text = Field(description="the program itself")


def _shipped(value: Any) -> Any:
    """A name as the program of that name that comes with forestgen."""
    if isinstance(value, str):
        path = find_asset("lsystems", value)
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    return value


def _environment(value: Any) -> Any:
    return {"model": value} if isinstance(value, str) else value


class EnvironmentChoice(BaseModel):
    """A competition model, and its own keys."""

    model_config = {"extra": "allow", "frozen": True}

    model: Annotated[Text, *part_name(COMPETITION_MODELS)] = Field(
        DEFAULT_COMPETITION_MODEL, description="id of the competition model"
    )

    def check(self) -> None:
        """Raise a mistake unless its own keys are right."""
        try:
            self.parameters()
        except ValidationError as failure:
            first = failure.errors()[0]
            expected = first["msg"].removeprefix("Input should be ").lower()
            raise mistake(expected, got=repr(first["input"]), at=("environment", *first["loc"])) from failure

    def parameters(self) -> Any:
        """The competition model's own parameters."""
        return COMPETITION_MODELS.load(self.model).Parameters.model_validate(self.model_extra or {})


_PROGRAM_SCHEMA: dict[str, Any] = {
    "anyOf": [{"type": "string"}, {"type": "object", "properties": {"name": {}, "text": {}}}],
    "default": "succession",
}


class MultisetParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    program: Annotated[ProgramText, BeforeValidator(_shipped), WithJsonSchema(_PROGRAM_SCHEMA)] = Field(
        "succession",
        validate_default=True,
        description="the L-system: a shipped program's name, or the path of a .lsys file",
    )
    parameters: dict[str, float | tuple[float, ...] | tuple[tuple[float, float], ...]] = Field(
        {}, description="values of the program's #defines (numbers), arrays (lists) and functions (control points)"
    )
    environment: Annotated[
        EnvironmentChoice,
        BeforeValidator(_environment),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}], "default": DEFAULT_COMPETITION_MODEL}),
    ] = Field(
        EnvironmentChoice(model=DEFAULT_COMPETITION_MODEL),
        description="competition model: its id, or {model: id, ...}",
    )
    most_plants: int = Field(
        5_000_000, ge=1, le=500_000_000, description="stop with a message where the community grows beyond this"
    )

    @model_validator(mode="before")
    @classmethod
    def _program_brings_its_environment(cls, data: Any) -> Any:
        """A program that has an environment's name runs with it, unless another is named."""
        if not isinstance(data, Mapping) or data.get("environment") is not None:
            return data
        program = data.get("program")
        name = program.get("name") if isinstance(program, Mapping) else program
        stem = str(name).removesuffix(".lsys")
        return {**data, "environment": stem} if stem in COMPETITION_MODELS else data

    @model_validator(mode="after")
    def _fits_program_and_environment(self) -> Self:
        listing = parse_text(self.program.text, self.program.name)
        asked = set(settable(listing))
        for name, value in self.parameters.items():
            if name in (*OF_SITE, *OF_SPECIES):
                source = "the species' ecology" if name in OF_SPECIES else "the recipe's site, step and species"
                raise mistake(
                    f"parameters without {name}", problem=f"{source} set {name}", got=name, at=("parameters", name)
                )
            if name not in asked:
                own = sorted(asked.difference(OF_SITE, OF_SPECIES))
                raise mistake(
                    f"one of {', '.join(own)}" if own else "none: the program has no parameters",
                    problem=f"the program {self.program.name} has no parameter {name}",
                    got=name,
                    at=("parameters", name),
                )
            self._check_value(listing, name, value)
        self.environment.check()
        return self

    def _check_value(self, listing: ProgramAST, name: str, value: Value) -> None:
        try:
            with_values(listing, {name: value})
        except LsystemError as error:
            raise mistake(error.expected or "another value", got=repr(value), at=("parameters", name)) from error
        numbers = [value] if isinstance(value, int | float) else [one for one in value if isinstance(one, int | float)]
        if name == "initial_plants_per_ha" and any(one < 0 for one in numbers):
            raise mistake("numbers of at least 0", got=repr(value), at=("parameters", name))


def values_of(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> dict[str, Value]:
    """What the recipe tells the program: site, time and species, as far as it asks; then its own parameters."""
    known: dict[str, Value] = {
        "site_width_m": site.size_m[0],
        "site_height_m": site.size_m[1],
        "site_area_ha": site.area_ha,
        "step_yr": parameters.step_yr,
        "number_of_species": float(len(species)),
    }
    for name in OF_SPECIES:
        known[name] = tuple(float(getattr(one, name)) for one in species)
    return known


def program_of(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> tuple[Program, Form]:
    """The recipe's program, compiled with its values."""
    own = tuple(sorted(parameters.parameters.items()))
    known = tuple(sorted(values_of(parameters, site, species).items()))
    return _compiled(parameters.program.name, parameters.program.text, known, own)


@lru_cache(maxsize=16)
def _compiled(name: str, text: str, known: tuple[Any, ...], own: tuple[Any, ...]) -> tuple[Program, Form]:
    listing = parse_text(text, name)
    asked = set(settable(listing))
    values: Mapping[str, Value] = {key: value for key, value in known if key in asked}
    program = compile_program(with_values(listing, {**values, **dict(own)}))
    if not listing.is_multiset:
        raise LsystemError(
            "a community needs a multiset", where=name, expected="axiom: { ... }, a set of words", got="a single word"
        )
    return program, form_of(program)
