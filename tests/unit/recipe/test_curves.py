"""A species' functions as its file may write them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from forestgen.recipe.curves import Curve, FallingCurve, PositiveCurve, evaluate, evaluate_one

ANY, POSITIVE, FALLING = TypeAdapter(Curve), TypeAdapter(PositiveCurve), TypeAdapter(FallingCurve)


def test_a_number_is_constant_and_points_are_joined_by_lines() -> None:
    assert evaluate_one(ANY.validate_python(3), -7.0) == 3.0
    curve = ANY.validate_python([[0, 1], [2, 5]])
    np.testing.assert_allclose(evaluate(curve, [-1.0, 0.0, 1.0, 2.0, 9.0]), [1, 1, 3, 5, 5])


def test_a_smooth_curve_meets_its_points_and_never_overshoots() -> None:
    points = [[0, 0], [1, 1], [2, 1], [3, 0.2]]
    curve = ANY.validate_python({"smooth": points})
    np.testing.assert_allclose(evaluate(curve, [0, 1, 2, 3, 4]), [0, 1, 1, 0.2, 0.2])
    fine = evaluate(curve, np.linspace(0, 3, 301))
    assert fine.min() >= 0.0
    assert fine.max() <= 1.0
    assert np.all(np.diff(fine[:101]) >= 0)


def test_a_formula_is_what_it_says() -> None:
    x = np.linspace(0, 1, 11)
    curve = ANY.validate_python({"formula": "sqrt(max(1 - (2*x - 1)^2, 0)) - -pi/2"})
    np.testing.assert_allclose(evaluate(curve, x), np.sqrt(np.maximum(1 - (2 * x - 1) ** 2, 0)) + np.pi / 2)
    np.testing.assert_allclose(evaluate(ANY.validate_python({"formula": "sqrt(x - 2)"}), x), 0.0)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ([[0, 1]], "two"),
        ([], "two"),
        ([[1, 1], [0, 1]], "ascend"),
        ([[0, float("nan")], [1, 1]], "finite"),
        (float("inf"), "finite"),
        ({"formula": "__import__('os')"}, "knows"),
        ({"formula": "x.real"}, "knows"),
        ({"formula": "y + 1"}, "knows"),
        ({"formula": "sqrt(x, x)"}, "argument"),
        ({"formula": "(" * 290}, "formula"),
        ({"formula": "x+" * 400}, "characters"),
        ({"smooth": [[0, 1]]}, "two"),
        ({"spline": [[0, 1], [1, 2]]}, "smooth"),
    ],
)
def test_what_is_no_curve_is_refused_with_a_reason(bad: Any, says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        ANY.validate_python(bad)


@pytest.mark.parametrize("bad", [-1, [[0, 1], [1, -0.1]], {"formula": "0.5 - x"}])
def test_lengths_are_not_negative(bad: Any) -> None:
    with pytest.raises(ValidationError, match="negative"):
        POSITIVE.validate_python(bad)


@pytest.mark.parametrize("bad", [[[0, 1], [1, 2]], {"formula": "x"}])
def test_a_tube_does_not_thicken(bad: Any) -> None:
    with pytest.raises(ValidationError, match="thicken"):
        FALLING.validate_python(bad)
