"""The parts of an L-system program as the parser finds them; every part knows its place in the text.

Expressions are equal if they are written alike, wherever they stand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple, NoReturn

from forestgen.core.errors import LsystemError


class Place(NamedTuple):
    """A place in a text; both count from 1."""

    line: int
    column: int


FIRST = Place(1, 1)


def place_in(text: str, position: int) -> Place:
    """The place of an index into a text."""
    return Place(text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position))


def fail(problem: str, name: str, place: Place, **about: str | None) -> NoReturn:
    """Raise `LsystemError` for a place in the program of file `name`."""
    raise LsystemError(problem, where=f"{name}:{place.line}:{place.column}", **about)


@dataclass(frozen=True)
class Number:
    value: float
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Name:
    """A parameter, a local or global variable, or a #define."""

    name: str
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Call:
    name: str
    arguments: tuple[Expression, ...]
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Index:
    """An array's element, counted from 0."""

    name: str
    index: Expression
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Unary:
    operator: str  # - !
    operand: Expression
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Binary:
    left: Expression
    operator: str  # || && == != < <= > >= + - * / % ^
    right: Expression
    place: Place = field(compare=False)


Expression = Number | Name | Call | Index | Unary | Binary


@dataclass(frozen=True)
class Assign:
    name: str
    value: Expression
    place: Place = field(compare=False)


@dataclass(frozen=True)
class If:
    condition: Expression
    then: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]
    place: Place = field(compare=False)


@dataclass(frozen=True)
class UseGroup:
    group: Expression
    place: Place = field(compare=False)


Statement = Assign | If | UseGroup


@dataclass(frozen=True)
class Module:
    """A symbol with actual parameters (or, in a predecessor or context, names for them)."""

    symbol: str
    arguments: tuple[Expression, ...]
    place: Place


@dataclass(frozen=True)
class Production:
    """``left < predecessor > right : {before} condition {after} --> successor : probability``"""

    predecessor: tuple[Module, ...]
    successor: tuple[Module, ...]
    probability: Expression | None
    place: Place
    left: tuple[Module, ...] = ()
    right: tuple[Module, ...] = ()
    before: tuple[Statement, ...] = ()
    condition: Expression | None = None
    after: tuple[Statement, ...] = ()
    group: int = 0  # 0: in every group


@dataclass(frozen=True)
class Macro:
    """``#define name(parameters) body``; without parameters a named value."""

    parameters: tuple[str, ...] | None
    body: Expression
    place: Place


@dataclass(frozen=True)
class Block:
    """Productions applied recursively: `decomposition` or `interpretation`."""

    productions: tuple[Production, ...] = ()
    maximum_depth: Expression | None = None
    place: Place = FIRST


@dataclass(frozen=True)
class ProgramAST:
    """A whole L-system program, parsed."""

    name: str  # of the file, for messages
    dialect: str = "cpfg"
    derivation_length: Expression | None = None
    axiom: tuple[tuple[Module, ...], ...] = ()
    is_multiset: bool = False  # the axiom is a set of words, and % fragments
    considered: tuple[Module, ...] | None = None
    ignored: tuple[Module, ...] = ()
    macros: dict[str, Macro] = field(default_factory=dict)
    arrays: dict[str, tuple[float, ...]] = field(default_factory=dict)
    functions: dict[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)  # control points
    turtle: dict[str, tuple[float, ...]] = field(default_factory=dict)  # options of the turtle, see turtle.py
    start: tuple[Statement, ...] = ()
    start_each: tuple[Statement, ...] = ()
    end_each: tuple[Statement, ...] = ()
    end: tuple[Statement, ...] = ()
    productions: tuple[Production, ...] = ()
    decomposition: Block = Block()
    interpretation: Block = Block()

    @property
    def all_productions(self) -> tuple[Production, ...]:
        """Those of the derivation, of the decomposition and of the interpretation."""
        return (*self.productions, *self.decomposition.productions, *self.interpretation.productions)


def points_problem(points: Sequence[tuple[float, float]]) -> str | None:
    """What is expected of a function's control points, where these are not so."""
    if not all(math.isfinite(value) for point in points for value in point):
        return "finite numbers"
    if len(points) < 2 or points[0][0] == points[-1][0]:
        return "two points of different x, at least"
    if any(b[0] < a[0] for a, b in pairwise(points)):
        return "control points that ascend in x"
    return None
