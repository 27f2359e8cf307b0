"""Kernels as a recipe writes them, and their tables."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.community.models.deformation_kernel import DeformationKernelParameters
from forestgen.community.placement.kernels import NAMED, HopkinsTarget, KernelSection, kernel_matrix, table


def kernels_of(value):
    return DeformationKernelParameters(kernels=value).kernels


def mistakes(value):
    with pytest.raises(ValidationError) as caught:
        kernels_of(value)
    return [(one["loc"], one.get("ctx", {})) for one in caught.value.errors()]


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        ([[0, 0], [1, 0.5], [4, 2]], lambda d: np.interp(d, [0, 1, 4], [0, 0.5, 2])),
        ({"formula": "1 + 3 * exp(-x^2)"}, lambda d: 1 + 3 * np.exp(-(d**2))),
        (0.25, lambda d: np.full(d.shape, 0.25)),
    ],
)
@pytest.mark.parametrize("distance", ["radii", "metres"])
def test_a_table_is_the_curve_within_reach_and_one_beyond(curve, expected, distance):
    made = table(KernelSection(curve=curve, reach=4, distance=distance))
    unit = 0.7 if distance == "radii" else 1.0
    d = np.linspace(0, 6, 997)
    found = made(d * unit, 0.7)
    np.testing.assert_allclose(found[d <= 4], expected(d[d <= 4]), atol=2e-3)
    assert np.all(found[d > 4.001] == 1)
    assert float(made.reach_m(0.7)) == pytest.approx(4 * unit)


def test_a_smooth_curve_passes_through_its_points_without_overshoot():
    made = table(KernelSection(curve={"smooth": [[0, 0], [1, 2], [3, 1]]}))
    assert made.reach == 3
    np.testing.assert_allclose(made(np.array([0.0, 1.0, 3.0]), 1.0), [0, 2, 1], atol=1e-3)
    assert made.values.max() <= 2
    assert made.values.min() >= 0


def test_a_kernel_matrix_is_by_who_acts_then_by_who_is_affected():
    matrix = kernel_matrix(kernels_of({"a": "inhibition", "b": {"a": "clustering"}}), ["a", "b", "c"])
    inhibition, clustering = (table(KernelSection(**NAMED[name])) for name in ("inhibition", "clustering"))
    for affected in range(3):
        np.testing.assert_array_equal(matrix[affected][0].values, inhibition.values)
        assert matrix[affected][2].is_neutral
    np.testing.assert_array_equal(matrix[0][1].values, clustering.values)
    assert matrix[1][1].is_neutral
    assert matrix[2][1].is_neutral


@pytest.mark.parametrize(
    "value",
    [
        "clustering",
        "neutral",
        {"hopkins": 1.6},
        {"curve": {"smooth": [[0, 0], [2, 1]]}, "balanced": True},
        {"curve": {"formula": "x"}, "reach": 1, "distance": "metres"},
        {"a": "inhibition", "b": {"a": {"curve": 0.5, "reach": 2}}},
        {},
    ],
)
def test_what_is_dumped_is_read_again(value):
    parameters = DeformationKernelParameters(kernels=value)
    assert DeformationKernelParameters.model_validate(parameters.model_dump(mode="json")) == parameters


def test_a_target_is_told_from_kernels():
    assert kernels_of({"hopkins": 1.6}) == HopkinsTarget(hopkins=1.6)


@pytest.mark.parametrize(
    ("value", "at", "problem"),
    [
        ({"curve": [[0, -1], [1, 1]]}, ("curve",), "never negative"),
        ({"curve": {"smooth": [[0, 0], [1, -2], [2, 1]]}}, ("curve",), "never negative"),
        ({"curve": 0.5}, ("curve",), "does not end"),
        ({"curve": {"formula": "exp(-x)"}}, ("curve",), "does not end"),
        ({"curve": {"formula": "1 / x"}, "reach": 2}, ("curve",), "too strong"),
        ({"curve": [[-1, 0], [1, 1]]}, ("curve",), "distance is not negative"),
        ({"curve": 0.0, "reach": 2, "balanced": True}, ("curve",), "leaves it no place"),
        ({"hopkins": 2, "reach": 1}, ("reach",), "no further keys"),
        ({"curv": [[0, 0], [1, 1]]}, ("curv",), "unknown key 'curv'"),
        ([[0, 0], [1, 1]], (), "this is no kernel"),
        ("inhibitoin", (), "no such kernel"),
        (None, (), "says nothing"),
        ({"a": 3}, (), "this is no kernel"),
        ({"a": {"b": {"curve": [[0, -1], [1, 1]]}}}, ("curve",), "never negative"),
    ],
)
def test_mistakes_are_told_where_they_are(value, at, problem):
    ((where, context),) = mistakes(value)
    inside = {"a": ("a",)}.get(next(iter(value), "") if isinstance(value, dict) else "", ())
    if isinstance(value, dict) and isinstance(value.get("a"), dict):
        inside = ("a", "b")
    assert problem in context["problem"]
    assert (*where, *context["at"]) == ("kernels", *inside, *at)


def test_a_kernel_named_many_times_is_made_once():
    """So a matrix of hundreds of species is read in a moment."""
    kernels = kernels_of({"a": {"b": "clustering", "c": "clustering"}, "b": "inhibition"})
    assert kernels["a"]["b"] is kernels["a"]["c"]
    assert kernels["a"]["b"] == kernels_of(NAMED["clustering"])
    assert kernels["b"] == kernels_of("inhibition") == KernelSection(**NAMED["inhibition"])


@pytest.mark.parametrize("value", [{"curve": [[0, float("nan")], [1, 1]]}, {"hopkins": 0.2}, {"hopkins": 11}])
def test_numbers_out_of_range_are_refused_at_their_key(value):
    ((where, _),) = mistakes(value)
    assert where[:2] == ("kernels", next(iter(value)))


def test_the_schema_knows_names_targets_and_matrices():
    schema = DeformationKernelParameters.model_json_schema()
    forms = schema["properties"]["kernels"]["anyOf"]
    assert {"enum": list(NAMED), "type": "string"} in forms
    assert {"$ref": "#/$defs/HopkinsTarget"} in forms
    assert any(one.get("type") == "object" for one in forms)


def test_named_species_are_told_with_their_keys():
    parameters = DeformationKernelParameters(kernels={"a": "neutral", "b": {"c": "neutral"}})
    assert dict(parameters.named_species()) == {
        ("kernels", "a"): "a",
        ("kernels", "b"): "b",
        ("kernels", "b", "c"): "c",
    }


def test_a_last_point_reaches_no_farther_than_reach_may():
    ((_, context),) = mistakes({"curve": [[0, 0], [1e6, 1]], "distance": "metres"})
    assert context["problem"] == "this kernel reaches too far"
    ((where, _),) = mistakes({"curve": [[0, 0], [1, 1]], "reach": 1e6})
    assert where[-1] == "reach"
