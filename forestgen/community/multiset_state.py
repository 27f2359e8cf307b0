"""The state of a community that a multiset L-system grows: its words, answered by the environment, saved, restored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.arrivals import heights_m, on_the_ground
from forestgen.community.competition.contract import Circles
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.multiset_parameters import MultisetParameters
from forestgen.community.plant_words import (
    ORDER,
    RADIUS,
    SPECIES,
    Form,
    Plants,
    join_words,
    plant_words,
    plants_of,
    reorder_words,
    take_words,
    word_of,
)
from forestgen.community.population import Population, Status
from forestgen.community.registry import COMPETITION_MODELS
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, arrival_limits, check_columns
from forestgen.core.errors import LsystemError, ResourceError
from forestgen.lsystem.derivation import Derivation
from forestgen.lsystem.multiset import Kind, words_as_lists
from forestgen.lsystem.program import Program

_MODULES_OF_A_PLANT = 2  # T and ?E
_MOST_OWN_MODULES = 50_000  # of words that are no plants


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: MultisetParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    program: Program
    form: Form
    derivation: Derivation

    @property
    def step(self) -> int:
        return self.derivation.step


def answered(state: State) -> State:
    """The environment's part: every plant on the site, and c of every ?E(c, ...) set.

    Writes into the state's own parameters, which nobody else holds yet.
    """
    parameters, form, size_m = state.parameters, state.form, state.site.size_m
    plants = plants_of(state.derivation.multiset, form, state.program.name)
    values = plants.values
    _check_own_words(state, len(plants))
    _check_plants(state, values)
    if len(plants) > parameters.most_plants:
        raise too_many(state, state.step)
    xy = values[:, :2]
    if parameters.periodic:
        outside = (xy < 0) | (xy >= size_m)
        if outside.any():
            rows = np.flatnonzero(outside.any(axis=1))
            values[rows, :2] = np.mod(xy[rows], size_m)
            values[rows, :2] *= values[rows, :2] < size_m  # the sum of -1e-20 and W is W
    else:
        outside = ~np.all((xy >= 0) & (xy <= size_m), axis=1)
        if outside.any():  # seeds that fall beyond a bounded site are lost
            keep = np.ones(len(state.derivation.multiset), dtype=np.bool_)
            keep[plants.word[outside]] = False
            words = take_words(state.derivation.multiset, keep)
            return answered(replace(state, derivation=replace(state.derivation, multiset=words)))
    environment = COMPETITION_MODELS.load(parameters.environment.model)
    circles = Circles(
        position_m=values[:, :2],
        radius_m=values[:, RADIUS],
        height_m=_heights(state, values) if environment.needs_heights else values[:, RADIUS],
        plant_id=state.derivation.multiset.word_id[plants.word],
        species=values[:, SPECIES].astype(np.uint16),
    )
    answer = environment.answer(parameters.environment.parameters(), circles, size_m, periodic=parameters.periodic)
    if isinstance(plants.first, slice):
        values[:, form.arity] = answer  # a view of the multiset's own parameters, which this step has made
    else:
        state.derivation.multiset.parameter[plants.first + form.arity] = answer
        for axis in (0, 1):
            state.derivation.multiset.parameter[plants.first + axis] = values[:, axis]
    return state


def _check_own_words(state: State, plants: int) -> None:
    """Few modules in words that are no plants: every step of the history holds them all as a list."""
    modules = len(state.derivation.multiset.code) - _MODULES_OF_A_PLANT * plants
    if modules > _MOST_OWN_MODULES:
        raise ResourceError(
            "the program's own words, those without a plant, grow too long",
            where=state.program.name,
            expected=f"at most {_MOST_OWN_MODULES:,} modules in all of them",
            got=f"{modules:,} in step {state.step}",
            hint="a production that makes more of its own module in each step has no end: give it a condition",
        )


def _check_plants(state: State, values: NDArray[np.float64]) -> None:
    """Radii above 0, and species that exist."""
    sp = values[:, SPECIES]
    wrong = ~((values[:, RADIUS] > 0) & (sp >= 0) & (sp < len(state.species)) & (sp == np.floor(sp)))
    if wrong.any():
        row = values[np.flatnonzero(wrong)[0]]
        raise LsystemError(
            "a plant of impossible size or species",
            where=state.program.name,
            expected=f"T(x, y, r, sp) with r > 0, and sp from 0 to {len(state.species) - 1}",
            got=f"r = {row[RADIUS]:g}, sp = {row[SPECIES]:g} in step {state.step}",
        )


def _heights(state: State, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return heights_m(state.species, values[:, SPECIES].astype(np.int64), values[:, RADIUS])


def snapshot(state: State, plants: Plants) -> Population:
    """The plants by their id, and all else of the state beside them."""
    derivation, form = state.derivation, state.form
    words = derivation.multiset
    order = np.argsort(words.word_id[plants.word], kind="stable")
    word, values = plants.word[order], plants.values[order]
    sp = values[:, SPECIES].astype(np.uint16)
    largest = np.array([one.max_radius_m for one in state.species])[sp] if len(order) else np.zeros(0)
    status = np.where(values[:, RADIUS] >= largest, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
    status[values[:, form.arity] == 0] = Status.DOMINATED
    own = np.delete(np.arange(form.values), [0, 1, RADIUS, SPECIES])
    columns: dict[str, NDArray[Any]] = {ORDER: word.astype(np.uint32)}
    columns.update({name: values[:, k].copy() for name, k in zip(form.names, own, strict=True)})
    others = np.ones(len(words), dtype=np.bool_)
    others[plants.word] = False
    rest = take_words(words, others)
    return Population(
        time_yr=state.step * state.parameters.step_yr,
        species_names=tuple(one.name for one in state.species),
        plant_id=words.word_id[word],
        species=sp,
        position_m=on_the_ground(values[:, :2]),
        radius_m=values[:, RADIUS].copy(),
        height_m=_heights(state, values),
        age_yr=(state.step - words.born_step[word]).astype(np.float64) * state.parameters.step_yr,
        status=status,
        columns=columns,
        step=state.step,
        state={
            "next_id": derivation.next_id,
            "globals": derivation.globals.tolist(),
            "words": [
                [int(index), int(one), int(born), modules]
                for index, one, born, modules in zip(
                    np.flatnonzero(others), rest.word_id, rest.born_step, words_as_lists(rest), strict=True
                )
            ],
        },
    )


def restored(state: State, population: Population) -> State:
    """The state whose snapshot this is."""
    form, kinds, n = state.form, state.program.kinds, len(population)
    values = np.empty((n, form.values))
    values[:, :2], values[:, RADIUS] = population.position_m[:, :2], population.radius_m
    values[:, SPECIES] = population.species
    own = np.delete(np.arange(form.values), [0, 1, RADIUS, SPECIES])
    for name, k in zip(form.names, own, strict=True):
        values[:, k] = population.columns[name]
    age = np.rint(population.age_yr / state.parameters.step_yr).astype(np.int32)
    plants = plant_words(form, kinds, values, population.plant_id, np.int32(population.step) - age)
    rows = population.state["words"]
    parts = [plants]
    for _, one, born, modules in rows:
        lone = word_of(state.program, modules)
        parts.append(replace(lone, word_id=np.array([one], np.uint32), born_step=np.array([born], np.int32)))
    index = np.concatenate([population.columns[ORDER].astype(np.int64), [row[0] for row in rows]])
    joined = reorder_words(join_words(kinds, parts), np.argsort(index, kind="stable"))
    derivation = Derivation(
        joined, population.step, int(population.state["next_id"]), np.array(population.state["globals"])
    )
    return replace(state, derivation=derivation)


def check_restorable(program: Program, form: Form, step_yr: float, population: Population) -> None:
    """Raise `ImpossibleValueError` unless `restored` can make words of the plants, and of the state's words."""
    own = {name: Limits("f8", finite=False) for name in form.names}
    check_columns(population, {**arrival_limits(population, step_yr), ORDER: Limits("u4", 0), **own})
    numbers = population.state.get("globals")
    if not (isinstance(numbers, list) and len(numbers) == len(program.globals) and all(map(_is_number, numbers))):
        raise ImpossibleValueError("globals", f"a list of {len(program.globals)} numbers", f"{numbers!s:.80}")
    words = population.state.get("words")
    if not isinstance(words, list):
        raise ImpossibleValueError("words", "a list of words", f"{words!s:.80}")
    for index, word in enumerate(words):
        if not _is_word(word, program, population):
            expected = "[place, id, step of birth, [[symbol, parameter, ...], ...]] in symbols of the program"
            raise ImpossibleValueError(f"words.{index}", expected, f"{word!s:.80}")
    known = [*population.plant_id.tolist(), *(word[1] for word in words)]
    if len(set(known)) != len(known):
        raise ImpossibleValueError("words", "an id of its own for every word and plant", "one that is there twice")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_word(word: object, program: Program, population: Population) -> bool:
    """Whether a list is a word of the state that is no plant: [place, id, step of birth, modules], brackets paired."""
    if not (isinstance(word, list) and len(word) == 4 and all(type(one) is int for one in word[:3])):
        return False
    place, word_id, born, modules = word
    next_id = population.state["next_id"]
    if not (0 <= place < 2**32 and 0 < word_id < next_id and 0 <= born <= population.step):
        return False
    return isinstance(modules, list) and bool(modules) and _are_modules(modules, program)


def _are_modules(modules: list[Any], program: Program) -> bool:
    depth = 0
    for one in modules:
        if not (isinstance(one, list) and one and isinstance(one[0], str) and all(map(_is_number, one[1:]))):
            return False
        if Kind(one[0], len(one) - 1) not in program.kinds:
            return False
        depth += (one[0] == "[") - (one[0] == "]")
        if depth < 0:
            return False
    return depth == 0


def too_many(state: State, step: int) -> ResourceError:
    """The community grows beyond the recipe's limit."""
    return ResourceError(
        "the community grows too large",
        where=state.program.name,
        expected=f"at most community.most_plants = {state.parameters.most_plants:,} plants",
        got=f"more of them in step {step}",
        hint="fewer seedlings, a smaller site, or a higher most_plants",
    )
