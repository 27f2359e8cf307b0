"""Functions in recipes and species files: a number, control points, a smooth curve, or a formula.

::

    internode_m: 0.2                                          # constant
    internode_m: [[0, 0.3], [1, 0.08]]                        # straight between the points, constant beyond
    internode_m: {smooth: [[0, 0.3], [0.5, 0.2], [1, 0.08]]}  # through the points without overshoot
    internode_m: {formula: "0.3 - 0.22 * x^2"}                # of the position x
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, WithJsonSchema

from forestgen.recipe.formula import check_formula, evaluate_formula

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

_points = TypeAdapter(
    tuple[tuple[Annotated[float, Field(allow_inf_nan=False)], Annotated[float, Field(allow_inf_nan=False)]], ...]
)


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


def _falling(curve: Function) -> Function:
    if isinstance(curve, Formula):
        values = evaluate(curve, np.linspace(0.0, 1.0, 101))
        rises = bool(np.any(np.diff(values) > 1e-9))
    else:
        points = curve.points if isinstance(curve, Smooth) else curve
        rises = any(b[1] > a[1] for a, b in pairwise(points))
    if rises:
        raise ValueError("a tube may not thicken from its base to its tip: the values must not ascend")
    return curve


def _not_negative(curve: Function) -> Function:
    if isinstance(curve, Formula):
        least = float(evaluate(curve, np.linspace(0.0, 1.0, 101)).min())
    else:
        points = curve.points if isinstance(curve, Smooth) else curve
        least = min(value for _, value in points)
    if least < 0.0:
        raise ValueError(f"the values of this curve must not be negative, got {least:g}")
    return curve


def _positive(curve: Function) -> Function:
    if isinstance(curve, Formula):
        least = float(evaluate(curve, np.linspace(0.0, 1.0, 101)).min())
    else:
        least = min(value for _, value in (curve.points if isinstance(curve, Smooth) else curve))
    if least <= 0.0:
        raise ValueError(f"the values of this curve must be above 0, got {least:g}")
    return curve


_pairs = {
    "type": "array",
    "items": {"type": "array", "prefixItems": [{"type": "number"}] * 2, "minItems": 2, "maxItems": 2},
}
CURVE_SCHEMA: dict[str, Any] = {
    "anyOf": [
        {"type": "number"},
        {**_pairs, "minItems": 2},
        {
            "type": "object",
            "properties": {"smooth": {**_pairs, "minItems": 2}},
            "required": ["smooth"],
            "additionalProperties": False,
        },
        {
            "type": "object",
            "properties": {"formula": {"type": "string"}},
            "required": ["formula"],
            "additionalProperties": False,
        },
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
