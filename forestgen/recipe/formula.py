"""Formulas in recipes and species files: arithmetic of one variable, compiled from text, without Python's reach."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

VARIABLE = "x"
_LONGEST = 300  # characters
_CONSTANTS = {"pi": np.pi, "e": np.e}
_FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {  # with their number of arguments
    "sqrt": (np.sqrt, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "abs": (np.abs, 1),
    "sin": (np.sin, 1),
    "cos": (np.cos, 1),
    "tan": (np.tan, 1),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
}
_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.true_divide,
    ast.Pow: np.power,
}
_SIGNS: dict[type, Callable[[Any], Any]] = {ast.UAdd: np.positive, ast.USub: np.negative}


def check_formula(text: str) -> None:
    """Whether `text` is a formula.

    Raises
    ------
    ValueError : it is none; says what is wrong and what there is.
    """
    _compiled(text)


def evaluate_formula(text: str, x: Floats) -> Floats:
    """Values of a checked formula, of x's shape; what is no number (0/0, the root of -1) counts as 0."""
    with np.errstate(all="ignore"):
        values = np.broadcast_to(_compiled(text)(x), x.shape).astype(np.float64)
    return np.nan_to_num(values, nan=0.0, posinf=1e9, neginf=-1e9)


@lru_cache(maxsize=256)
def _compiled(text: str) -> Callable[[Floats], Any]:
    if len(text) > _LONGEST:
        raise ValueError(f"a formula has at most {_LONGEST} characters, got {len(text)}")
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval")
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"not a formula: {text!r}; write it like 'sqrt(1 - (2*x - 1)^2)'") from error
    return _node(tree.body)


def _node(node: ast.expr) -> Callable[[Floats], Any]:
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as value):
            number = float(value)
            return lambda x: number
        case ast.Name(id=name) if name == VARIABLE:
            return lambda x: x
        case ast.Name(id=name) if name in _CONSTANTS:
            constant = _CONSTANTS[name]
            return lambda x: constant
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            one, other, both = _node(left), _node(right), _BINARY[type(op)]
            return lambda x: both(one(x), other(x))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _SIGNS:
            inner, sign = _node(operand), _SIGNS[type(op)]
            return lambda x: sign(inner(x))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _FUNCTIONS:
            function, count = _FUNCTIONS[name]
            if len(args) != count:
                raise ValueError(f"{name} takes {count} argument{'s' * (count > 1)}, got {len(args)}")
            parts = [_node(argument) for argument in args]
            return lambda x: function(*(part(x) for part in parts))
        case _:
            pass
    known = ", ".join([VARIABLE, *_CONSTANTS, *_FUNCTIONS])
    raise ValueError(f"a formula knows numbers, + - * / ^ ( ) and {known}; not {ast.unparse(node)!r:.60}")
