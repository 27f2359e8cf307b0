"""All that a recipe draws: distributions, and what follows from variables; found in its data, checked and drawn.

A choice may be among mappings or lists that hold distributions again; the key path of one of these goes through the
choice, such as ``sky.clouds.choice.1.cover``. Values are put in place from the inside out, the choice's own last.

Numbers may share a drawn variable::

    sampling:
      variables:
        wetness: {uniform: [0, 1]}
        fog: {formula: "wetness^2"}                     # variables may follow from others
    sky:
      turbidity: {formula: "2 + 4 * wetness"}
    community:
      steps: {formula: "round(50 + 300 * wetness)"}     # a whole number
    plants:
      season: {variable: season}                        # a variable may also be a text

A formula of ``x`` is a curve's (recipe/curves.py) and no matter of this module.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeGuard

from pydantic import ValidationError

from forestgen.core.errors import ErrorList, RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.curves import VARIABLE, check_formula, evaluate_number, formula_names, is_whole
from forestgen.recipe.dataset import DEFAULT_SPLITS
from forestgen.recipe.distributions import (
    BadDistributionError,
    Choice,
    Distribution,
    Scalar,
    is_distribution,
    parse_distribution,
)
from forestgen.recipe.distributions import Sequence as InOrder
from forestgen.recipe.messages import UNDRAWN, Explainer, show
from forestgen.recipe.sampler import VARIABLES, Sampler, Sampling, is_variable, make_sampler
from forestgen.recipe.sources import Keys, SourceMap, dotted

Values = Mapping[Keys, Scalar]
REFERENCES = ("variable", "formula")
MOST_PROBES = 1000  # a recipe is checked so many times at most
_MOST_TRIED = 50  # of one distribution's numbers


def _tried(one: Distribution) -> list[Scalar]:
    """A distribution's extreme values, each once; of more than `_MOST_TRIED` numbers the ends and some between.

    Mappings and lists, which are chosen by their numbers, are all tried, and texts are.
    """
    values = list({(type(value), value): value for value in one.extremes()}.values())  # 1 is not true
    numbers = all(isinstance(value, int | float) for value in values) and not (isinstance(one, Choice) and one.numbered)
    if len(values) <= _MOST_TRIED or not numbers:
        return values
    ranked = sorted(values, key=float)  # type: ignore[arg-type]
    return [ranked[k * (len(ranked) - 1) // (_MOST_TRIED - 1)] for k in range(_MOST_TRIED)]


@dataclass(frozen=True)
class Reference:
    """A value that follows from variables."""

    text: str  # name of the variable, or the formula
    names: tuple[str, ...]  # of the variables in it
    is_formula: bool
    where: str

    def value(self, known: Mapping[str, Scalar]) -> Scalar:
        """Raises `RecipeError` for a formula of a text, or without a finite value."""
        if not self.is_formula:
            return known[self.text]
        numbers: dict[str, float] = {}
        for name in self.names:
            value = known[name]
            if isinstance(value, bool) or not isinstance(value, int | float):
                problem, expected = "a formula of what is no number", f"{name}, a number"
                raise RecipeError(problem, where=self.where, expected=expected, got=f"{value!r}")
            numbers[name] = value
        result = evaluate_number(self.text, numbers)
        if not math.isfinite(result):
            given = ", ".join(f"{name} = {value:g}" for name, value in numbers.items())
            problem, got = "a formula without a finite value", f"{result} at {given}"
            raise RecipeError(problem, where=self.where, expected="a number", got=got)
        return int(result) if is_whole(self.text) else result


@dataclass(frozen=True)
class Draws:
    """What is drawn, by key path in the recipe's order: a choice before what lies in it."""

    seed: int  # the recipe's
    written: Mapping[Keys, Any]  # distributions and references
    distributions: Mapping[Keys, Distribution]
    constants: Mapping[str, Scalar]  # variables that are plain values
    references: Mapping[Keys, Reference]  # those of variables first, each after what it needs
    sampler: Sampler | None  # None: all draws are independent

    def values(self, image: int) -> dict[Keys, Scalar]:
        """Of one image, by its number.

        Each value has its own stream of random numbers, named by its key and the image, or its place by `sampler`.
        """
        placed = self.sampler.quantiles(image) if self.sampler is not None else {}
        return self._followed({keys: self._drawn(keys, one, image, placed) for keys, one in self.distributions.items()})

    def _drawn(self, keys: Keys, one: Distribution, image: int, placed: Mapping[Keys, float]) -> Scalar:
        if keys in placed:
            return one.quantile(placed[keys])
        if isinstance(one, InOrder):
            return one.of_image(image)
        return one.draw(child_rng(self.seed, "recipe", image, dotted(keys)))

    def _followed(self, drawn: Values) -> dict[Keys, Scalar]:
        """All values, from those of the distributions."""
        known = {**self.constants, **{str(keys[-1]): one for keys, one in drawn.items() if is_variable(keys)}}
        found = dict(drawn)
        for keys, reference in self.references.items():
            found[keys] = reference.value(known)
            if is_variable(keys):
                known[str(keys[-1])] = found[keys]
        return found

    def probes(self, first: Values) -> Iterator[dict[Keys, Scalar]]:
        """Values at the ends of the distributions; `first` are those of an image.

        Each distribution goes through its extreme values while the others stay; then all stand at their first and all
        at their last extreme together.
        """
        for keys, one in self.distributions.items():
            within = dict(self._choices_around(keys))
            for extreme in _tried(one):
                changed = {**first, **within, keys: extreme}
                yield self._followed({keys: changed[keys] for keys in self.distributions})
        if len(self.distributions) > 1:
            for end in (0, -1):
                yield self._followed({keys: one.extremes()[end] for keys, one in self.distributions.items()})

    def put(self, data: dict[str, Any], values: Values, only: Mapping[Keys, Any] | None = None) -> None:
        """Put values in place, all or those of `only`, whose order is that of `written`."""
        for keys in reversed(list(self.written if only is None else only)):
            if keys in values:
                value: Any = values[keys]
                if self.is_numbered(keys):
                    choice = get(data, keys)["choice"]
                    value = (choice["values"] if isinstance(choice, Mapping) else choice)[int(value)]
                put(data, keys, value)

    def active(self, values: Values) -> dict[Keys, Scalar]:
        """The values that are in the image: not those of mappings or lists that were not chosen."""
        return {
            keys: value
            for keys, value in values.items()
            if all(values[choice] == number for choice, number in self._choices_around(keys))
        }

    def placed(self, values: Values, sources: SourceMap) -> tuple[SourceMap, Mapping[Keys, Any]]:
        """Where the keys of an image were written and what was, after the choices among mappings and lists."""
        if not self._numbered:
            return sources, self.written
        active = self.active(values)
        moved = SourceMap(dict(sources.places))
        for choice, entries in self._numbered.items():
            if choice in active:
                moved.take(moved, (*entries, int(active[choice] or 0)), self._final(choice))
        return moved, {self._final(keys): self.written[keys] for keys in active}

    def is_numbered(self, keys: Keys) -> bool:
        """Whether a choice among mappings or lists is at `keys`."""
        return keys in self._numbered

    @cached_property
    def _numbered(self) -> dict[Keys, Keys]:
        """Choices among mappings or lists, by key path: that of the list of their entries."""
        found = {}
        for keys, one in self.distributions.items():
            if isinstance(one, Choice) and one.numbered:
                weighted = isinstance(self.written[keys]["choice"], Mapping)
                found[keys] = (*keys, "choice", "values") if weighted else (*keys, "choice")
        return found

    def _choices_around(self, keys: Keys) -> Iterator[tuple[Keys, int]]:
        """The choices that a key path goes through, and which of their entries it is in."""
        for choice, entries in self._numbered.items():
            if keys[: len(entries)] == entries and len(keys) > len(entries):
                yield choice, int(keys[len(entries)])

    def _final(self, keys: Keys) -> Keys:
        """The key path after all choices were made."""
        for choice, _ in reversed(list(self._choices_around(keys))):  # the innermost first
            keys = (*choice, *keys[len(self._numbered[choice]) + 1 :])
        return keys


def is_reference(value: object) -> TypeGuard[Mapping[str, str]]:
    """Whether `value` is written as a variable or a formula: a mapping with one such key and a text."""
    if not (isinstance(value, Mapping) and len(value) == 1):
        return False
    kind, text = next(iter(value.items()))
    return kind in REFERENCES and isinstance(text, str)


def needs_variables(value: Mapping[str, str], variables: Mapping[str, Any]) -> bool:
    """Whether a reference is this module's, and not a curve's formula; a broken one is, where there are variables."""
    kind, text = next(iter(value.items()))
    if kind == "variable" or not variables:
        return kind == "variable"
    try:
        return bool(formula_names(text) - {VARIABLE})
    except ValueError:
        return True


def find_written(data: Mapping[str, Any]) -> dict[Keys, Any]:
    """All distributions and references of a recipe's data, as written."""
    section = data.get("sampling")
    variables = section.get("variables") if isinstance(section, Mapping) else None
    variables = variables if isinstance(variables, Mapping) else {}
    found = {
        (*VARIABLES, str(name)): value
        for name, value in variables.items()
        if is_distribution(value) or is_reference(value)
    }
    return {**found, **dict(_find(data, (), variables))}


def _find(value: Any, keys: Keys, variables: Mapping[str, Any]) -> Iterator[tuple[Keys, Mapping[str, Any]]]:
    if keys in UNDRAWN:
        return
    if keys and (is_distribution(value) or (is_reference(value) and needs_variables(value, variables))):
        yield keys, value
        if "choice" not in value:
            return
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _find(item, (*keys, key), variables)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _find(item, (*keys, i), variables)


def _parsed(written: Mapping[Keys, Any], sources: SourceMap) -> dict[Keys, Distribution]:
    """The distributions among what is written; raises `RecipeError` with the places of bad ones."""
    errors = ErrorList(sources.place(()).origin)
    chosen = {keys: value for keys, value in written.items() if is_distribution(value)}
    tried = {keys: errors.attempt(_distribution, keys, value, sources) for keys, value in chosen.items()}
    errors.raise_all()
    return {keys: one for keys, one in tried.items() if one is not None}


def _distribution(keys: Keys, value: Any, sources: SourceMap) -> Distribution:
    where = sources.where(keys)
    try:
        one = parse_distribution(value)
    except BadDistributionError as cause:
        expected, hint = str(cause), cause.hint
        raise RecipeError("bad distribution", where=where, expected=expected, got=show(value), hint=hint) from cause
    of_species = keys[0] == "species"
    if isinstance(one, Choice) and one.numbered and (of_species or is_variable(keys)):
        expected = "numbers, texts, true or false" + (": all images have the same species" if of_species else "")
        hint = "choose how many there are of each: community: {plants: {choice: [...]}}" if of_species else None
        problem = "no mappings or lists are chosen here"
        raise RecipeError(problem, where=where, expected=expected, got=show(value), hint=hint)
    return one


def _reference(value: Mapping[str, str], variables: list[str], where: str) -> Reference:
    kind, text = next(iter(value.items()))
    names: tuple[str, ...] = (text,)
    try:
        if kind == "formula":
            names = tuple(sorted(formula_names(text)))
            check_formula(text, names)
    except ValueError as cause:
        expected = "arithmetic of variables, such as '10 + 30 * wetness'"
        got, hint = f"{text!r:.80}", str(cause)
        raise RecipeError("bad formula", where=where, expected=expected, got=got, hint=hint) from cause
    for name in names:
        if name not in variables:
            raise _unknown(name, variables, where, curve=kind == "formula" and name == VARIABLE)
    return Reference(text, names, kind == "formula", where)


def _unknown(name: str, variables: list[str], where: str, *, curve: bool) -> RecipeError:
    if curve:
        hint = "x is a curve's position; a curve's formula knows no variables"
        return RecipeError("a formula of x and of variables", where=where, expected="one or the other", hint=hint)
    near = difflib.get_close_matches(name, variables, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"sampling: {{variables: {{{name}: {{uniform: [0, 1]}}}}}}"
    expected = f"one of {', '.join(variables)}" if variables else "a variable of sampling.variables, which has none"
    return RecipeError("no such variable", where=where, expected=expected, got=name, hint=hint)


def _in_order(references: Mapping[Keys, Reference]) -> list[Keys]:
    """Variables before what needs them, then all else."""
    own = {str(keys[-1]): keys for keys in references if is_variable(keys)}
    needed = {name: [one for one in references[keys].names if one in own] for name, keys in own.items()}
    try:
        order = [own[name] for name in TopologicalSorter(needed).static_order()]
    except CycleError as cause:
        names = cause.args[1][::-1]  # each needs the next
        problem = "variables that need one another"
        expected = "formulas of variables that are drawn, or follow from such"
        where = references[own[names[0]]].where
        raise RecipeError(problem, where=where, expected=expected, got=" -> ".join(names)) from cause
    return [*order, *(keys for keys in references if not is_variable(keys))]


def make_draws(data: Mapping[str, Any], sources: SourceMap) -> Draws:
    """All that is drawn, checked."""
    section = _sampling(data, sources)
    written, seed = find_written(data), whole_number(data, "seed", 0)
    distributions = _parsed(written, sources)
    given = section.variables if section is not None else {}
    references = {
        keys: _reference(value, list(given), sources.where(keys))
        for keys, value in written.items()
        if is_reference(value)
    }
    constants = {name: one for name, one in given.items() if (*VARIABLES, name) not in written}
    for name, value in constants.items():
        if isinstance(value, Mapping | list):
            where = sources.where((*VARIABLES, name))
            expected = "a distribution, a number, a text, or {formula: ...} of other variables"
            raise RecipeError("bad variable", where=where, expected=expected, got=f"{value!r:.60}")
    references = {keys: references[keys] for keys in _in_order(references)}
    sampler: Sampler | None = None
    if section is not None:
        sampler = make_sampler(section, distributions, references, sources, seed, splits_of(data))
    probes = 2 + sum(len(_tried(one)) for one in distributions.values())
    if probes > MOST_PROBES:
        problem, got = "the recipe draws too much to be checked", f"{probes:,}"
        expected = f"at most {MOST_PROBES:,} ends of distributions and choices in all"
        raise RecipeError(problem, where=sources.where(()), expected=expected, got=got)
    return Draws(seed, written, distributions, constants, references, sampler)


def _sampling(data: Mapping[str, Any], sources: SourceMap) -> Sampling | None:
    """The section of the name, which decides how all the others are drawn."""
    written = data.get("sampling")
    if written is None:
        return None
    try:
        return Sampling.model_validate(written)
    except ValidationError as failure:
        given = written if isinstance(written, dict) else {}
        raise Explainer(Sampling, given, sources, ("sampling",)).error(failure) from None


def whole_number(data: Mapping[str, Any], key: str, default: int) -> int:
    """A whole number needed before validation; a bad one counts as the default until validation rejects it."""
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        return default
    return int(value)


def splits_of(data: Mapping[str, Any]) -> Mapping[str, float]:
    """Splits are needed before validation, too; bad ones count as the default until validation rejects them."""
    section = data.get("dataset")
    splits = section.get("splits") if isinstance(section, Mapping) else None
    shares = list(splits.values()) if isinstance(splits, Mapping) else []
    good = all(isinstance(one, int | float) and not isinstance(one, bool) and 0 < one < 1e100 for one in shares)
    return {str(name): float(share) for name, share in splits.items()} if splits and shares and good else DEFAULT_SPLITS


def mentions(value: Any, words: frozenset[str]) -> bool:
    """Whether a mapping in `value`, at any depth, has one of these keys."""
    if isinstance(value, dict):
        return not words.isdisjoint(value) or any(mentions(item, words) for item in value.values())
    return isinstance(value, list) and any(mentions(item, words) for item in value)


def get(data: Any, keys: Keys) -> Any:
    """What is at a key path."""
    for key in keys:
        data = data[key]
    return data


def put(data: Any, keys: Keys, value: Any) -> None:
    """Put a value at a key path whose parent is there."""
    get(data, keys[:-1])[keys[-1]] = value
