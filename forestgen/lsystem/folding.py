"""Expressions whose value is known before anything runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from forestgen.core.errors import LsystemError
from forestgen.lsystem.opcodes import FUNCTIONS
from forestgen.lsystem.syntax import Binary, Call, Expression, Index, Macro, Name, Number, Unary

_FUNCTIONS: dict[str, Callable[..., float]] = {
    "min": min,
    "max": max,
    "floor": math.floor,
    "ceil": math.ceil,
    "trunc": math.trunc,
    "abs": abs,
    "fabs": abs,
    "exp": math.exp,
    "sqrt": math.sqrt,
    "pow": math.pow,
    "log": math.log,
    "sin": lambda x: math.sin(math.radians(x)),
    "cos": lambda x: math.cos(math.radians(x)),
}
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "%": math.fmod,
    "^": math.pow,
    "==": lambda a, b: float(a == b),
    "!=": lambda a, b: float(a != b),
    "<": lambda a, b: float(a < b),
    "<=": lambda a, b: float(a <= b),
    ">": lambda a, b: float(a > b),
    ">=": lambda a, b: float(a >= b),
    "&&": lambda a, b: float(bool(a) and bool(b)),
    "||": lambda a, b: float(bool(a) or bool(b)),
}


def fold(expression: Expression, macros: Mapping[str, Macro], name: str) -> float | None:
    """Value of an expression of numbers and #defines; None where it needs more, draws, or has no value.

    Raises
    ------
    LsystemError : a division by zero.
    """
    try:
        value = _Folder(macros, name).fold(expression)
    except (OverflowError, ValueError):
        return None  # the machine says where
    return value if value is None or math.isfinite(value) else None


class _Folder:
    """Each #define is computed once, however often it stands."""

    def __init__(self, macros: Mapping[str, Macro], name: str) -> None:
        self.macros, self.name = macros, name
        self.known: dict[str, float | None] = {}

    def fold(self, one: Expression) -> float | None:
        if isinstance(one, Number):
            return one.value
        if isinstance(one, Name):
            return self.named(one.name)
        if isinstance(one, Unary):
            value = self.fold(one.operand)
            return None if value is None else (-value if one.operator == "-" else float(not value))
        if isinstance(one, Index):
            return None
        return self.call(one) if isinstance(one, Call) else self.binary(one)

    def named(self, name: str) -> float | None:
        macro = self.macros.get(name)
        if macro is None or macro.parameters is not None:
            return None
        if name not in self.known:
            self.known[name] = None  # if it is made of itself
            self.known[name] = self.fold(macro.body)
        return self.known[name]

    def call(self, one: Call) -> float | None:
        if one.name in self.macros or one.name not in _FUNCTIONS or len(one.arguments) != FUNCTIONS[one.name][1]:
            return None
        values = [self.fold(argument) for argument in one.arguments]
        known = [value for value in values if value is not None]
        return float(_FUNCTIONS[one.name](*known)) if len(known) == len(values) else None

    def binary(self, one: Binary) -> float | None:
        left = self.fold(one.left)
        if one.operator in ("&&", "||") and left is not None and bool(left) == (one.operator == "||"):
            return float(bool(left))  # the right side never runs
        right = self.fold(one.right)
        if one.operator in "/%" and right == 0:
            where = f"{self.name}:{one.place.line}:{one.place.column}"
            raise LsystemError("division by zero", where=where)
        return None if left is None or right is None else _OPERATORS[one.operator](left, right)
