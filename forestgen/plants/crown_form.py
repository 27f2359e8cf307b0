"""Silhouettes of crowns: a name, a drawn curve or a formula, and the branches that reach them."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, TypeAdapter, WithJsonSchema

from forestgen.recipe.curves import CURVE_SCHEMA, Function, PositiveCurve, evaluate

Floats = NDArray[np.float64]

Name = Literal["ellipsoid", "ovoid", "cone", "column"]
_NAMES = get_args(Name)
_curve: TypeAdapter[Any] = TypeAdapter(PositiveCurve)
_FINE = np.linspace(0.0, 1.0, 1001)


def _read(value: Any) -> Any:
    if isinstance(value, str):
        if value not in _NAMES:
            raise ValueError(f"no silhouette is called {value!r:.40}; there are {', '.join(_NAMES)}, or draw a curve")
        return value
    curve = _curve.validate_python(value)
    if evaluate(curve, _FINE).max() <= 0.0:
        raise ValueError("a silhouette that is nowhere wider than 0 has no branches")
    return curve


#: Crown radius over the height within the crown (0 its base, 1 its top), scaled so that the greatest counts as 1.
Silhouette = Annotated[
    Any,
    BeforeValidator(_read),
    WithJsonSchema({"anyOf": [{"type": "string", "enum": list(_NAMES)}, *CURVE_SCHEMA["anyOf"]]}),
]


def envelope(silhouette: Name | Function, height: Floats) -> Floats:
    """Crown radius as a share of the greatest, at a height within the crown, 0 its base and 1 its top; 0 outside."""
    u = np.clip(height, 0.0, 1.0)
    match silhouette:
        case "ellipsoid":
            form = np.sqrt(np.maximum(1.0 - (2.0 * u - 1.0) ** 2, 0.0))
        case "ovoid":  # an ellipsoid with its widest part at 38% and a blunter foot
            form = np.sqrt(np.maximum(1.0 - (2.0 * u**0.716 - 1.0) ** 2, 0.0)) ** 0.85
        case "cone":
            form = np.minimum(1.0, 0.7 + 3.0 * u) * (1.0 - u) ** 0.92 / 0.907
        case "column":
            form = np.minimum(1.0, np.minimum(0.6 + 4.0 * u, np.sqrt(np.maximum(1.0 - u, 0.0) * 5.0)))
        case drawn:
            form = evaluate(drawn, u) / evaluate(drawn, _FINE).max()
    return np.asarray(np.where((height < 0.0) | (height > 1.0), 0.0, form), dtype=np.float64)


def silhouette_length(
    silhouette: Name | Function, foot: Floats, angle_rad: Floats, crown_m: float, width_m: float
) -> Floats:
    """(M,) length of straight branches from the axis of the crown to its silhouette, metres.

    Parameters
    ----------
    foot : (M,) height of the branch's foot within the crown, 0 its base and 1 its top.
    angle_rad : (M,) from the vertical.
    crown_m, width_m : height and width of the crown.
    """
    sine, cosine = np.maximum(np.sin(angle_rad), 0.15), np.cos(angle_rad)
    share = np.linspace(0.0, 1.0, 65)[1:]
    farthest = 0.5 * width_m / sine
    outward = share * (0.5 * width_m)
    height = foot[:, None] + share * (farthest * cosine / crown_m)[:, None]
    inside = outward <= 0.5 * width_m * envelope(silhouette, height)
    reached = np.where(np.all(inside, axis=1), len(share), np.argmin(inside, axis=1))
    return np.asarray(np.where(foot < 0.0, 0.0, farthest * (reached / len(share))), dtype=np.float64)
