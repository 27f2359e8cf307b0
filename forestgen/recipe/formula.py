"""Formulas in recipes and species files: arithmetic of named numbers, compiled from text, without Python's reach.

A curve's formula knows its position ``x`` (recipe/curves.py); a drawn number's knows the recipe's variables
(recipe/variables.py).
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Names = Mapping[str, Any]  # name -> number or array

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
    "round": (np.rint, 1),
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
RESERVED = frozenset([VARIABLE, *_CONSTANTS, *_FUNCTIONS])  # what no variable may be called


def check_formula(text: str) -> None:
    """Whether `text` is a formula of x.

    Raises
    ------
    ValueError : it is none; says what is wrong and what there is.
    """
    _compiled(text, (VARIABLE,))


def evaluate_formula(text: str, x: Floats) -> Floats:
    """Values of a checked formula, of x's shape; what is no number (0/0, the root of -1) counts as 0."""
    with np.errstate(all="ignore"):
        values = np.broadcast_to(_compiled(text, (VARIABLE,))({VARIABLE: x}), x.shape).astype(np.float64)
    return np.nan_to_num(values, nan=0.0, posinf=1e9, neginf=-1e9)


def formula_names(text: str) -> frozenset[str]:
    """The names in a formula besides those of constants and functions; raises ValueError for what is no formula."""
    names = (node.id for node in ast.walk(_parsed(text)) if isinstance(node, ast.Name))
    return frozenset(names) - (RESERVED - {VARIABLE})


def is_whole(text: str) -> bool:
    """Whether a checked formula gives whole numbers because all of it is rounded: ``round(...)``."""
    tree = _parsed(text)
    return isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and tree.func.id == "round"


def check_formula_of(text: str, names: tuple[str, ...]) -> None:
    """Whether `text` is a formula of these names; raises ValueError as `check_formula` does."""
    _compiled(text, names)


def evaluate_number(text: str, values: Mapping[str, float]) -> float:
    """Value of a checked formula of the names in `values`; it need not be finite."""
    with np.errstate(all="ignore"):
        numbers = {name: np.float64(value) for name, value in values.items()}
        return float(_compiled(text, tuple(values))(numbers))


def _parsed(text: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise ValueError(f"a formula has at most {_LONGEST} characters, got {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on what is refused below
            return ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"not a formula: {text!r}; write it like 'sqrt(1 - (2*x - 1)^2)'") from error


@lru_cache(maxsize=256)
def _compiled(text: str, names: tuple[str, ...]) -> Callable[[Names], Any]:
    return _node(_parsed(text), names)


def _node(node: ast.expr, names: tuple[str, ...]) -> Callable[[Names], Any]:
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as value):
            number = float(value)
            return lambda of: number
        case ast.Name(id=name) if name in names:
            return lambda of: of[name]
        case ast.Name(id=name) if name in _CONSTANTS:
            constant = _CONSTANTS[name]
            return lambda of: constant
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            one, other, both = _node(left, names), _node(right, names), _BINARY[type(op)]
            return lambda of: both(one(of), other(of))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _SIGNS:
            inner, sign = _node(operand, names), _SIGNS[type(op)]
            return lambda of: sign(inner(of))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _FUNCTIONS:
            function, count = _FUNCTIONS[name]
            if len(args) != count:
                raise ValueError(f"{name} takes {count} argument{'s' * (count > 1)}, got {len(args)}")
            parts = [_node(argument, names) for argument in args]
            return lambda of: function(*(part(of) for part in parts))
        case _:
            pass
    known = ", ".join([*names, *_CONSTANTS, *_FUNCTIONS])
    raise ValueError(f"a formula knows numbers, + - * / ^ ( ) and {known}; not {ast.unparse(node)!r:.60}")
