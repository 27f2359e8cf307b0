"""What a recipe says about a multiset L-system, the program made of it, and plants as its words.

A plant is a word ``T(x, y, r, sp, ...)?E(c, ...)`` that holds nothing else: place, radius and species in metres, metres
and 0, 1, ..., then what else the program gives it; and the module by which the competition model answers. All other
words are the program's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, ValidationError, WithJsonSchema, model_validator

from forestgen.community.model import CommunityParameters
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.community.registry import COMPETITION_MODELS, DEFAULT_COMPETITION_MODEL
from forestgen.core.errors import LsystemError
from forestgen.lsystem.compiler import Program, Value, compile_program, settable, with_values
from forestgen.lsystem.multiset import Kind, Multiset, words_as_text
from forestgen.lsystem.parsing import parse_text
from forestgen.lsystem.syntax import ProgramAST
from forestgen.recipe.assets import find_asset
from forestgen.recipe.fields import Section, Text, part_name, violation

OF_SPECIES = (
    "growth_m_per_yr", "max_radius_m", "shade_tolerance", "old_age_survival", "seedlings_per_ha_per_yr",
    "seedling_radius_m", "height_scale", "height_exponent",
)  # fmt: skip
OF_SITE = ("site_width_m", "site_height_m", "site_area_ha", "step_yr", "number_of_species")
X, Y, RADIUS, SPECIES, OWN = 0, 1, 2, 3, 4  # parameters of T
ORDER = "word"  # the column with the order of the words


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


class CompetitionChoice(BaseModel):
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
            raise violation(expected, got=repr(first["input"]), at=("environment", *first["loc"])) from failure

    def parameters(self) -> Any:
        """The competition model's own parameters."""
        return COMPETITION_MODELS.load(self.model).Parameters.model_validate(self.model_extra or {})


class MultisetParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    program: Annotated[
        ProgramText,
        BeforeValidator(_shipped),
        WithJsonSchema(
            {
                "anyOf": [{"type": "string"}, {"type": "object", "properties": {"name": {}, "text": {}}}],
                "default": "succession",
            }
        ),
    ] = Field(
        "succession",
        validate_default=True,
        description="the L-system: a shipped program's name, or the path of a .lsys file",
    )
    parameters: dict[str, float | tuple[float, ...] | tuple[tuple[float, float], ...]] = Field(
        {}, description="values of the program's #defines (numbers), arrays (lists) and functions (control points)"
    )
    environment: Annotated[
        CompetitionChoice,
        BeforeValidator(lambda value: {"model": value} if isinstance(value, str) else value),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}], "default": DEFAULT_COMPETITION_MODEL}),
    ] = Field(
        CompetitionChoice(model=DEFAULT_COMPETITION_MODEL), description="competition model: its id, or {model: id, ...}"
    )
    most_plants: int = Field(
        5_000_000, ge=1, le=500_000_000, description="stop with a message where the community grows beyond this"
    )

    @model_validator(mode="before")
    @classmethod
    def _program_brings_its_competition_model(cls, data: Any) -> Any:
        """A program that has a competition model's name runs with it, unless another is named."""
        if not isinstance(data, Mapping) or data.get("environment") is not None:
            return data
        program = data.get("program")
        name = program.get("name") if isinstance(program, Mapping) else program
        stem = str(name).removesuffix(".lsys")
        return {**data, "environment": stem} if stem in COMPETITION_MODELS else data

    @model_validator(mode="after")
    def _fits_its_program(self) -> Self:
        listing = parse_text(self.program.text, self.program.name)
        asked = set(settable(listing))
        for name, value in self.parameters.items():
            if name in (*OF_SITE, *OF_SPECIES):
                source = "the species' ecology" if name in OF_SPECIES else "the recipe's site, step and species"
                raise violation(
                    f"parameters without {name}", problem=f"{source} set {name}", got=name, at=("parameters", name)
                )
            if name not in asked:
                own = sorted(asked.difference(OF_SITE, OF_SPECIES))
                expected = f"one of {', '.join(own)}" if own else "none: the program has no parameters"
                problem = f"the program {self.program.name} has no parameter {name}"
                raise violation(expected, problem=problem, got=name, at=("parameters", name))
            self._check_value(listing, name, value)
        self.environment.check()
        return self

    def _check_value(self, listing: ProgramAST, name: str, value: Value) -> None:
        try:
            with_values(listing, {name: value})
        except LsystemError as error:
            raise violation(error.expected or "another value", got=repr(value), at=("parameters", name)) from error
        numbers = [value] if isinstance(value, int | float) else [one for one in value if isinstance(one, int | float)]
        if name == "initial_plants_per_ha" and any(one < 0 for one in numbers):
            raise violation("numbers of at least 0", got=repr(value), at=("parameters", name))


def program_of(parameters: MultisetParameters, site: Site, species: Ecologies) -> tuple[Program, Form]:
    """The recipe's program, compiled with site, time and species, as far as it asks for them; then its own values."""
    known: dict[str, Value] = {
        "site_width_m": site.size_m[0],
        "site_height_m": site.size_m[1],
        "site_area_ha": site.area_ha,
        "step_yr": parameters.step_yr,
        "number_of_species": float(len(species)),
    }
    for name in OF_SPECIES:
        known[name] = tuple(float(getattr(one, name)) for one in species)
    own = tuple(sorted(parameters.parameters.items()))
    return _compiled(parameters.program.name, parameters.program.text, tuple(sorted(known.items())), own)


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


@dataclass(frozen=True)
class Form:
    """The form of a program's plants."""

    plant: int  # code of T
    query: int  # code of ?E
    arity: int  # of T
    answers: int  # parameters of ?E
    names: tuple[str, ...]  # of the parameters of T after the species, then of ?E

    @property
    def values(self) -> int:
        return self.arity + self.answers

    @property
    def own(self) -> list[int]:
        """Numbers of the parameters that `names` names."""
        return list(range(OWN, self.values))


def form_of(program: Program) -> Form:
    """How a program writes its plants; raises `LsystemError` if it has none, or some of several forms."""
    plants = [i for i, kind in enumerate(program.kinds) if kind.symbol == "T"]
    queries = [i for i, kind in enumerate(program.kinds) if kind.symbol == "?E"]
    if len(plants) != 1 or len(queries) != 1:
        expected = "plants as T(x, y, r, sp)?E(c), all with the same number of parameters"
        got = ", ".join(f"{symbol}({arity})" for symbol, arity in program.kinds if symbol in ("T", "?E")) or "no T"
        raise LsystemError("this program writes no plants", where=program.name, expected=expected, got=got)
    arity, answers = program.kinds[plants[0]].arity, program.kinds[queries[0]].arity
    if arity < OWN or answers < 1:
        problem, expected = "plants have too few parameters", "T(x, y, r, sp)?E(c), or more parameters"
        raise LsystemError(problem, where=program.name, expected=expected, got=f"T with {arity}, ?E with {answers}")
    return Form(plants[0], queries[0], arity, answers, _names(program, arity, answers))


def _names(program: Program, arity: int, answers: int) -> tuple[str, ...]:
    """The names that the first productions give the parameters."""
    names: dict[Kind, list[str]] = {}
    for production in program.ast.productions:
        for module in production.predecessor:
            found = [getattr(argument, "name", "") for argument in module.arguments]
            names.setdefault(Kind(module.symbol, len(found)), found)
    of_plant = names.get(Kind("T", arity), [f"parameter_{i}" for i in range(arity)])[OWN:]
    of_query = names.get(Kind("?E", answers), [f"answer_{i}" for i in range(answers)])
    both = tuple(f"{name}_parameter" if name == ORDER else name for name in (*of_plant, *of_query))
    return both if len(set(both)) == len(both) else tuple(f"parameter_{i}" for i in range(len(both)))


@dataclass(frozen=True)
class Plants:
    """The plants among the words: N of them, in the words' order."""

    word: NDArray[np.intp]  # (N,) index of each plant's word
    values: Floats  # (N, values) parameters of T, then of ?E
    first: NDArray[np.int64]  # (N,) where they lie among the multiset's parameters

    def __len__(self) -> int:
        return len(self.word)


def plants_of(multiset: Multiset, form: Form, name: str) -> Plants:
    """The plants among the words of a program's multiset; raises `LsystemError` if another word holds a T."""
    starts, code = multiset.word_start, multiset.code
    length = np.diff(starts)
    is_plant = length == 2
    is_plant[is_plant] = (code[starts[:-1][is_plant]] == form.plant) & (code[starts[:-1][is_plant] + 1] == form.query)
    word = np.flatnonzero(is_plant)
    if np.count_nonzero(code == form.plant) != len(word):
        _refuse(multiset, form, is_plant, name)
    first = multiset.parameter_start()[starts[:-1][word]]
    values = np.empty((len(word), form.values))
    for k in range(form.values):
        values[:, k] = multiset.parameter[first + k]
    return Plants(word, values, first)


def _refuse(multiset: Multiset, form: Form, is_plant: NDArray[np.bool_], name: str) -> None:
    for index in np.flatnonzero(~is_plant):
        begin, end = multiset.word_start[index : index + 2]
        if np.any(multiset.code[begin:end] == form.plant):
            lone = words_at(multiset, np.array([index]))
            problem = "a word holds a plant and more, or only a part of one"
            expected = "T(...)?E(...) alone; % before each new plant cuts it off"
            raise LsystemError(problem, where=name, expected=expected, got=f"{next(words_as_text(lone)):.80}")


def words_at(multiset: Multiset, index: NDArray[np.integer]) -> Multiset:
    """The words of these numbers, in this order."""
    starts, length = multiset.word_start[:-1][index].astype(np.int64), np.diff(multiset.word_start)[index]
    modules = _ranges(starts, length)
    values, arity = multiset.parameter_start(), multiset.arity[multiset.code]
    return Multiset(
        multiset.kinds,
        multiset.code[modules],
        multiset.parameter[_ranges(values[:-1][modules], arity[modules])],
        np.concatenate([[0], np.cumsum(length)]).astype(np.int32),
        multiset.word_id[index],
        multiset.born_step[index],
    )


def _ranges(start: NDArray[np.int64], length: NDArray[np.integer]) -> NDArray[np.int64]:
    """start[0], start[0] + 1, ... (length[0] of them), start[1], ..."""
    before = np.cumsum(length) - length
    found: NDArray[np.int64] = np.repeat(start - before, length) + np.arange(int(length.sum()))
    return found


def join_words(kinds: tuple[Kind, ...], parts: Sequence[Multiset]) -> Multiset:
    """The words of all parts, which know the same kinds."""
    columns = ("code", "parameter", "word_id", "born_step")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
    lengths = np.concatenate([np.diff(part.word_start) for part in parts])
    return Multiset(kinds=kinds, word_start=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32), **joined)


def plant_words(
    form: Form, kinds: tuple[Kind, ...], values: Floats, plant_id: NDArray[np.uint32], born_step: NDArray[np.int32]
) -> Multiset:
    """Words of plants; `values` (N, values) as in `Plants`."""
    n = len(values)
    code = np.tile(np.array([form.plant, form.query], np.uint16), n)
    return Multiset(kinds, code, values.reshape(-1), np.arange(0, 2 * n + 1, 2, dtype=np.int32), plant_id, born_step)


def word_of(program: Program, modules: Sequence[Sequence[str | float]], word_id: int, born_step: int) -> Multiset:
    """The multiset of one word from the list that `words_as_lists` makes of it."""
    values = [float(value) for module in modules for value in module[1:]]
    return Multiset(
        program.kinds,
        np.array([program.kinds.index(Kind(str(one[0]), len(one) - 1)) for one in modules], np.uint16),
        np.array(values, dtype=np.float64),
        np.array([0, len(modules)], np.int32),
        np.array([word_id], np.uint32),
        np.array([born_step], np.int32),
    )
