"""L-systems on their own: `derive` runs a program and answers with its words."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from forestgen.core.arguments import MOST_SEEDS, path_of, texts_of, whole_of
from forestgen.core.errors import LsystemError, RecipeError
from forestgen.lsystem import derivation
from forestgen.lsystem.compiler import Value, compile_program, with_values
from forestgen.lsystem.multiset import words_as_lists, words_as_text
from forestgen.lsystem.parsing import parse_file
from forestgen.recipe.assets import find_asset

_MOST_STEPS = 1_000_000
_MOST_MODULES = 50_000_000
_MOST_LIMIT = 10**9
Module = list[str | float]  # a symbol and its parameters


@dataclass(frozen=True)
class Words:
    """What a program has derived."""

    file: str
    steps: int
    seed: int
    last: derivation.Derivation = field(repr=False)

    @property
    def modules(self) -> int:
        """How many, in all words."""
        return len(self.last.multiset.code)

    @property
    def counts(self) -> Mapping[str, int]:
        """Symbol -> how many modules."""
        return self.last.multiset.counts()

    @property
    def text(self) -> Iterator[str]:
        """The words as text, one after another."""
        return iter(words_as_text(self.last.multiset))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "file": self.file,
            "steps": self.steps,
            "seed": self.seed,
            "modules": self.modules,
            "counts": self.counts,
            "words": list(self),
        }

    def __iter__(self) -> Iterator[list[Module]]:
        """The words, each a list of modules: ``["F", 1.5]``; whole numbers are written as such."""
        return ([_plain(module) for module in word] for word in words_as_lists(self.last.multiset))


def derive(
    file: str | os.PathLike[str],
    steps: int | None = None,
    *,
    seed: int = 0,
    set: Mapping[str, Value] | Sequence[str] | None = (),  # noqa: A002 - the name of the option on the command line
    max_modules: int = _MOST_MODULES,
) -> Words:
    """Derive an L-system.

    Parameters
    ----------
    file : a .lsys or .sys file, or a shipped program's name.
    steps : by default the file's derivation length.
    seed : another seed draws other random numbers.
    set : other values of #defines and arrays: ``{"A": 1.5, "B": [1, 2]}``, or texts ``["A=1.5", "B=1,2"]``.
    max_modules : stop where the words grow longer than this.

    Raises
    ------
    LsystemError, RecipeError, AssetError
    """
    named = path_of(file, "file")
    drawn, most = whole_of(seed, "seed", 0, MOST_SEEDS), whole_of(max_modules, "max_modules", 1, _MOST_LIMIT)
    path = named if os.path.exists(named) else find_asset("lsystems", str(named))  # noqa: PTH110 - never raises
    program = compile_program(with_values(parse_file(path), _values(set)))
    wanted = program.derivation_length if steps is None else steps
    if wanted is None:
        expected = "`steps=N`, or derivation length: N in the file"
        raise RecipeError("how many steps?", where=program.name, expected=expected, got="neither")
    wanted = whole_of(wanted, "steps", 0, _MOST_STEPS)
    last: derivation.Derivation | None = None
    for last in derivation.derive(program, wanted, drawn, most_modules=most):  # noqa: B007 - the last matters
        pass
    assert last is not None
    return Words(str(path), wanted, drawn, last)


def _values(settings: Mapping[str, Value] | Sequence[str] | None) -> dict[str, Value]:
    """Values by name; texts are NAME=NUMBER or NAME=NUMBER,NUMBER,..."""
    if isinstance(settings, Mapping):
        return dict(settings)
    values: dict[str, Value] = {}
    for setting in () if settings is None else texts_of(settings, "set"):
        name, equals, text = setting.partition("=")
        try:
            numbers = [float(one) for one in text.split(",") if one.strip()]
        except ValueError:
            numbers = []
        if not equals or not name.strip() or not numbers:
            raise LsystemError(
                "not a setting", parameter="set", expected="NAME=NUMBER or NAME=NUMBER,NUMBER", got=setting
            )
        values[name.strip()] = numbers if "," in text else numbers[0]
    return values


def _plain(module: Sequence[str | float]) -> Module:
    symbol, *values = module
    return [symbol, *(int(v) if isinstance(v, float) and v.is_integer() and abs(v) < 1e15 else v for v in values)]
