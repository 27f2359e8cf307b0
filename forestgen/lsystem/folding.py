"""Expressions whose value is known before anything runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from forestgen.core.errors import LsystemError
from forestgen.lsystem.syntax import Binary, Call, Expression, Index, Macro, Name, Number, Place, Unary

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
        value = _fold(expression, macros, name, 0)
    except (OverflowError, ValueError):
        return None  # the machine says where
    return value if value is None or math.isfinite(value) else None


def _where(name: str, place: Place) -> str:
    return f"{name}:{place.line}:{place.column}"


def _fold(expression: Expression, macros: Mapping[str, Macro], name: str, depth: int) -> float | None:
    if isinstance(expression, Number):
        return expression.value
    if isinstance(expression, Name):
        macro = macros.get(expression.name)
        if macro is None or macro.parameters is not None or depth > len(macros):
            return None
        return _fold(macro.body, macros, name, depth + 1)
    if isinstance(expression, Unary):
        value = _fold(expression.operand, macros, name, depth)
        return None if value is None else (-value if expression.operator == "-" else float(not value))
    if isinstance(expression, Index) or (isinstance(expression, Call) and expression.name not in _FUNCTIONS):
        return None
    parts = expression.arguments if isinstance(expression, Call) else (expression.left, expression.right)
    values = [_fold(part, macros, name, depth) for part in parts]
    known = [value for value in values if value is not None]
    if isinstance(expression, Binary) and expression.operator in "/%" and values[1] == 0:
        raise LsystemError("division by zero", where=_where(name, expression.place))
    if len(known) < len(values):
        return None
    if isinstance(expression, Call):
        return None if not known else float(_FUNCTIONS[expression.name](*known))
    return _OPERATORS[expression.operator](known[0], known[1])


def spell(expression: Expression | None) -> str:
    """The expression written in one way, to tell whether two are the same."""
    if expression is None:
        return ""
    if isinstance(expression, Number):
        return repr(expression.value)
    if isinstance(expression, Name):
        return expression.name
    if isinstance(expression, Call):
        return f"{expression.name}({','.join(map(spell, expression.arguments))})"
    if isinstance(expression, Index):
        return f"{expression.name}[{spell(expression.index)}]"
    if isinstance(expression, Unary):
        return f"{expression.operator}({spell(expression.operand)})"
    return f"({spell(expression.left)}{expression.operator}{spell(expression.right)})"
