"""Functions of a species, written in its file as control points."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator

Points = tuple[tuple[float, float], ...]


def _from_number(value: Any) -> Any:
    """A plain number is a constant function."""
    return ((0.0, value),) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _ascending(points: Points) -> Points:
    if not points:
        raise ValueError("a curve needs at least one [position, value] pair")
    if any(b[0] <= a[0] for a, b in pairwise(points)):
        raise ValueError("the positions of a curve's [position, value] pairs must ascend")
    return points


def _falling(points: Points) -> Points:
    if any(b[1] > a[1] for a, b in pairwise(points)):
        raise ValueError("a tube may not thicken from its base to its tip: the values must not ascend")
    return points


#: A number, or a list of [position, value] pairs: linear between them, constant beyond.
Curve = Annotated[Points, BeforeValidator(_from_number), AfterValidator(_ascending)]
#: A curve whose values never ascend.
FallingCurve = Annotated[Curve, AfterValidator(_falling)]


def evaluate(curve: Points, position: ArrayLike) -> NDArray[np.float64]:
    """Values of the curve at `position`, of the same shape."""
    x, y = np.array(curve, dtype=np.float64).T
    return np.asarray(np.interp(np.asarray(position, dtype=np.float64), x, y), dtype=np.float64)


def evaluate_one(curve: Points, position: float) -> float:
    """Value of the curve at one position."""
    return float(evaluate(curve, position))
