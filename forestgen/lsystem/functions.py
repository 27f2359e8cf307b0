"""User-defined functions: curves by control points, as cpfg's function editor makes them.

The control points are those of a clamped cubic B-spline (of lower degree where there are fewer than four): the curve
begins at the first, ends at the last, and its value at x is where it crosses x. Outside, the end values hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

_SAMPLES_A_SPAN = 64


def points_problem(points: Sequence[tuple[float, float]]) -> str | None:
    """What control points must be like, where these are not."""
    if not all(math.isfinite(value) for point in points for value in point):
        return "finite numbers"
    if len(points) < 2 or points[0][0] == points[-1][0]:
        return "two points of different x, at least"
    if any(b[0] < a[0] for a, b in pairwise(points)):
        return "control points that ascend in x"
    return None


def sample_function(points: Sequence[tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The curve as a fine polyline: x ascending, and y."""
    control = np.array(points, dtype=np.float64)
    degree = min(3, len(control) - 1)
    if degree == 1:
        return control[:, 0].copy(), control[:, 1].copy()
    from scipy.interpolate import BSpline  # late: most programs have no functions

    spans = len(control) - degree
    knots = np.concatenate([np.zeros(degree), np.linspace(0, 1, spans + 1), np.ones(degree)])
    curve = BSpline(knots, control, degree)(np.linspace(0, 1, spans * _SAMPLES_A_SPAN + 1))
    return np.maximum.accumulate(curve[:, 0]), np.ascontiguousarray(curve[:, 1])
