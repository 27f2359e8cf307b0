"""Functions in recipes and species files: a number, control points, a smooth curve, or a formula.

::

    internode_m: 0.2                                          # constant
    internode_m: [[0, 0.3], [1, 0.08]]                        # straight between the points, constant beyond
    internode_m: {smooth: [[0, 0.3], [0.5, 0.2], [1, 0.08]]}  # through the points without overshoot
    internode_m: {formula: "0.3 - 0.22 * x^2"}                # of the position x

A formula is arithmetic of named numbers, compiled from text, without access to Python. A curve's formula knows its
position ``x``; a drawn number's formula knows the recipe's variables (recipe/draws.py).
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, WithJsonSchema

Floats = NDArray[np.float64]
Names = Mapping[str, Any]  # name -> number or array
Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Smooth:
    """A monotone cubic (PCHIP) through control points."""

    points: Points


@dataclass(frozen=True)
class Formula:
    """Arithmetic of the position x."""

    text: str


Function = Points | Smooth | Formula

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

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_points = TypeAdapter(tuple[tuple[_Finite, _Finite], ...])


def _read(value: Any) -> Any:
    """A plain number is a constant function; a mapping names the other forms."""
    if isinstance(value, Smooth | Formula):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
        if not np.isfinite(number):
            raise ValueError("a curve's value must be a finite number")
        return ((0.0, number),)
    if isinstance(value, dict):
        match value:
            case {"smooth": points, **rest} if not rest:
                return Smooth(_checked(points))
            case {"formula": str(text), **rest} if not rest:
                check_formula(text)
                return Formula(text)
        raise ValueError("a curve is a number, [position, value] pairs, {smooth: pairs} or {formula: text}")
    return _checked(value)


def _checked(value: Any) -> Points:
    points: Points = _points.validate_python(value)
    if isinstance(value, tuple) and len(points) == 1:  # a constant, as this module makes it
        return points
    if len(points) < 2:
        raise ValueError("a curve needs two [position, value] pairs or more; a constant is a plain number")
    if any(b[0] <= a[0] for a, b in pairwise(points)):
        raise ValueError("the positions of a curve's [position, value] pairs must ascend")
    return points


def _values(curve: Function) -> Floats:
    """A curve's values at its control points; a formula's at 101 positions from 0 to 1."""
    if isinstance(curve, Formula):
        return evaluate(curve, np.linspace(0.0, 1.0, 101))
    points = curve.points if isinstance(curve, Smooth) else curve
    return np.array([value for _, value in points])


def _falling(curve: Function) -> Function:
    if np.any(np.diff(_values(curve)) > (1e-9 if isinstance(curve, Formula) else 0.0)):
        raise ValueError("a tube may not thicken from its base to its tip: the values must not ascend")
    return curve


def _not_negative(curve: Function) -> Function:
    if (least := float(_values(curve).min())) < 0.0:
        raise ValueError(f"the values of this curve must not be negative, got {least:g}")
    return curve


def _positive(curve: Function) -> Function:
    if (least := float(_values(curve).min())) <= 0.0:
        raise ValueError(f"the values of this curve must be above 0, got {least:g}")
    return curve


_pairs = {
    "type": "array",
    "items": {"type": "array", "prefixItems": [{"type": "number"}] * 2, "minItems": 2, "maxItems": 2},
}
_forms = {"smooth": {**_pairs, "minItems": 2}, "formula": {"type": "string"}}
CURVE_SCHEMA: dict[str, Any] = {
    "anyOf": [
        {"type": "number"},
        {**_pairs, "minItems": 2},
        *(
            {"type": "object", "properties": {key: form}, "required": [key], "additionalProperties": False}
            for key, form in _forms.items()
        ),
    ]
}

#: A function of the position, see this module's page.
Curve = Annotated[Any, BeforeValidator(_read), WithJsonSchema(CURVE_SCHEMA)]
#: A curve whose values are never negative: lengths, sizes, numbers.
PositiveCurve = Annotated[Any, BeforeValidator(_read), AfterValidator(_not_negative), WithJsonSchema(CURVE_SCHEMA)]
#: A curve whose values are always above zero: lengths that a loop steps by.
StrictlyPositiveCurve = Annotated[Any, BeforeValidator(_read), AfterValidator(_positive), WithJsonSchema(CURVE_SCHEMA)]
#: A curve whose values are never negative and never ascend.
FallingCurve = Annotated[
    Any, BeforeValidator(_read), AfterValidator(_not_negative), AfterValidator(_falling), WithJsonSchema(CURVE_SCHEMA)
]


def evaluate(curve: Function, position: ArrayLike) -> NDArray[np.float64]:
    """Values of the curve at `position`, of the same shape."""
    at = np.asarray(position, dtype=np.float64)
    if isinstance(curve, Formula):
        return evaluate_formula(curve.text, at)
    x, y = np.array(curve.points if isinstance(curve, Smooth) else curve, dtype=np.float64).T
    if isinstance(curve, Smooth):
        from scipy.interpolate import PchipInterpolator

        return np.asarray(PchipInterpolator(x, y)(np.clip(at, x[0], x[-1])), dtype=np.float64)
    return np.asarray(np.interp(at, x, y), dtype=np.float64)


def evaluate_one(curve: Function, position: float) -> float:
    """Value of the curve at one position."""
    return float(evaluate(curve, position))


def check_formula(text: str, names: tuple[str, ...] = (VARIABLE,)) -> None:
    """Raise ValueError where `text` is no formula of these names; it says what is wrong and what there is."""
    _compiled(text, names)


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
