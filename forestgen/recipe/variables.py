"""Numbers that share a drawn variable.

::

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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

from forestgen.core.errors import RecipeError
from forestgen.recipe.curves import VARIABLE, check_formula_of, evaluate_number, formula_names, is_whole
from forestgen.recipe.distributions import Scalar
from forestgen.recipe.sources import Keys, SourceMap

SECTION: Keys = ("sampling", "variables")
REFERENCES = ("variable", "formula")


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


@dataclass(frozen=True)
class Reference:
    """A value that follows from variables."""

    text: str  # name of the variable, or the formula
    names: tuple[str, ...]  # of the variables in it
    is_formula: bool
    where: str


@dataclass(frozen=True)
class Variables:
    """What follows from the drawn variables."""

    constants: Mapping[str, Scalar]  # variables that are plain values
    references: Mapping[Keys, Reference]  # those of variables first, each after what it needs

    def values(self, drawn: Mapping[Keys, Scalar]) -> dict[Keys, Scalar]:
        """The references' values, from those of what is drawn.

        Raises `RecipeError` for a formula of a text, or without a finite value.
        """
        known = dict(self.constants)
        known.update({str(keys[-1]): value for keys, value in drawn.items() if keys[: len(SECTION)] == SECTION})
        found: dict[Keys, Scalar] = {}
        for keys, reference in self.references.items():
            found[keys] = _value(reference, known)
            if keys[: len(SECTION)] == SECTION:
                known[str(keys[-1])] = found[keys]
        return found


def make_variables(
    variables: Mapping[str, Any],
    references: Mapping[Keys, Mapping[str, str]],
    drawn: Iterable[Keys],
    sources: SourceMap,
) -> Variables:
    """Check the references of a recipe.

    Parameters
    ----------
    variables : name -> distribution, value or reference, as written.
    references : by key path, as written; those among the variables too.
    drawn : key paths of all distributions.
    """
    made = {keys: _reference(value, [*variables], sources.where(keys)) for keys, value in references.items()}
    constants: dict[str, Scalar] = {}
    for name, value in variables.items():
        keys = (*SECTION, name)
        if keys in made or keys in drawn:
            continue
        if isinstance(value, Mapping | list):
            expected = "a distribution, a number, a text, or {formula: ...} of other variables"
            raise RecipeError("bad variable", where=sources.where(keys), expected=expected, got=f"{value!r:.60}")
        constants[name] = value
    return Variables(constants, {keys: made[keys] for keys in _in_order(made)})


def _reference(value: Mapping[str, str], variables: list[str], where: str) -> Reference:
    kind, text = next(iter(value.items()))
    names: tuple[str, ...] = (text,)
    try:
        if kind == "formula":
            names = tuple(sorted(formula_names(text)))
            check_formula_of(text, names)
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
    own = {str(keys[-1]): keys for keys in references if keys[: len(SECTION)] == SECTION}
    order: list[Keys] = []
    path: list[str] = []

    def visit(name: str) -> None:
        keys = own.get(name)
        if keys is None or keys in order:
            return
        if name in path:
            cycle = " -> ".join([*path[path.index(name) :], name])
            problem = "variables that need one another"
            expected = "formulas of variables that are drawn, or follow from such"
            raise RecipeError(problem, where=references[keys].where, expected=expected, got=cycle)
        path.append(name)
        for needed in references[keys].names:
            visit(needed)
        path.pop()
        order.append(keys)

    for name in own:
        visit(name)
    return [*order, *(keys for keys in references if keys not in order)]


def _value(reference: Reference, known: Mapping[str, Scalar]) -> Scalar:
    if not reference.is_formula:
        return known[reference.text]
    numbers: dict[str, float] = {}
    for name in reference.names:
        value = known[name]
        if isinstance(value, bool) or not isinstance(value, int | float):
            problem, expected = "a formula of what is no number", f"{name}, a number"
            raise RecipeError(problem, where=reference.where, expected=expected, got=f"{value!r}")
        numbers[name] = value
    result = evaluate_number(reference.text, numbers)
    if not math.isfinite(result):
        given = ", ".join(f"{name} = {value:g}" for name, value in numbers.items())
        problem, got = "a formula without a finite value", f"{result} at {given}"
        raise RecipeError(problem, where=reference.where, expected="a number", got=got)
    return int(result) if is_whole(reference.text) else result
