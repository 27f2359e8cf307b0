"""Zamuda et al.'s Algorithm 1: strands are conserved, d = k_d sqrt(S), and everything stands where the page puts it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from strand_oracle import Model, tree

from forestgen.core.errors import RecipeError
from forestgen.plants.generators.strands import GENERATOR, Parameters, branching_of, tables
from forestgen.plants.registry import GENERATORS
from forestgen.plants.strands import ANGLE, GRAVIMORPHISM, LONGEST, SPLIT, Branching, Wind, pose, product
from support.error_messages import raises_error

FLAT = [(0.0, 1.0), (50.0, 1.0)]
BEECH: dict[str, Any] = {  # section III.A
    "strands": 1000,
    "trunk_length_m": 5,
    "thickness_m": 0.01,
    "phyllotaxis_deg": 85,
    "gravicentralism": 0.3,
    "split": {"gravelius": [[0, 0.75], [15, 0.9]], "weibull": FLAT},
    "angle_deg": {"gravelius": [[0, 45], [15, 45]], "weibull": FLAT},
    "shortest": {"gravelius": [[0, 1], [7.5, 0.45], [15, 1]], "weibull": FLAT},
    "longest": {"gravelius": [[0, 1], [15, 1]], "weibull": FLAT},
    "length": {"gravelius": [[0, 1], [15, 1]], "weibull": FLAT},
    "gravimorphism_deg": {"gravelius": [[0, 0], [15, 0]], "weibull": FLAT},
}
PINE: dict[str, Any] = {  # section III.B
    "strands": 6000,
    "trunk_length_m": 5.47,
    "thickness_m": 0.005,
    "phyllotaxis_deg": 85,
    "gravicentralism": 0.98,
    "split": {
        "gravelius": [[0, 0.955], [0.7749, 0.9615], [1.827, 0.8288], [4.207, 0.8269], [15, 0.8294]],
        "weibull": [[0, 1], [42.89, 1.005], [42.8901, 0.654], [50, 0.6256]],
    },
    "angle_deg": {"gravelius": [[0, 128.8], [1.164, 17.91], [3.621, 45.21], [15, 35.83]], "weibull": FLAT},
    "shortest": {"gravelius": [[0, 0.7109], [1.293, 0.8531], [15, 1]], "weibull": FLAT},
    "longest": {"gravelius": [[0, 0.9953], [15, 1]], "weibull": FLAT},
    "length": {
        "gravelius": [[0, 0.7109], [0.7749, 0.5385], [2.522, 1.327], [15, 1]],
        "weibull": [[0, 1.014], [38.58, 1.014], [45.26, 0.5877], [50, 0.01896]],
    },
    "gravimorphism_deg": {
        "gravelius": [[0, 0], [0.3875, 34.62], [1.034, -4.265], [1.55, -4.154], [2.974, -5.972], [15, -0.8532]],
        "weibull": FLAT,
    },
}
SHAPES = {"leaf": {"form": "simple", "material": "leaf", "length_m": 0.1, "width_m": 0.07}}


def parameters(**keys: Any) -> Parameters:
    return Parameters.model_validate({"generator": "strands", "wood": {"material": "bark"}, "shapes": SHAPES, **keys})


def branching(plant: Parameters, height_m: float = 20.0) -> Branching:
    return branching_of(plant, height_m, np.random.default_rng(0))


def oracle(keys: dict[str, Any], **more: Any) -> list[Any]:
    pairs: dict[str, Any] = {
        symbol: (keys[name]["gravelius"], keys[name]["weibull"])
        for symbol, name in {
            "k_s": "split",
            "alpha": "angle_deg",
            "m": "shortest",
            "M": "longest",
            "k_l": "length",
            "alpha_m": "gravimorphism_deg",
        }.items()
    }
    return tree(
        Model(
            S=keys["strands"],
            l0=keys["trunk_length_m"],
            k_d=keys["thickness_m"],
            k_c=keys["gravicentralism"],
            alpha_p=keys["phyllotaxis_deg"],
            **pairs,
            **more,
        )
    )


def check_conserved(b: Branching) -> None:
    daughters = np.bincount(b.parent[2:], minlength=len(b.parent))
    held = np.bincount(b.parent[2:], weights=b.strands[2:], minlength=len(b.parent))
    divides = daughters > 0
    assert set(daughters[1:]) <= {0, 2}
    np.testing.assert_array_equal(held[divides], b.strands[divides])
    assert np.all(b.strands[~divides][1:] == 1)
    assert np.count_nonzero(~divides[1:]) == b.strands[1]


@pytest.mark.parametrize("keys", [BEECH, PINE], ids=["beech", "pine"])
def test_strands_are_conserved_and_each_ends_alone(keys: dict[str, Any]) -> None:
    b = branching(parameters(**keys))
    check_conserved(b)
    assert b.strands[1] == keys["strands"]
    assert np.count_nonzero(b.strands[1:] == 1) == keys["strands"]


@given(
    strands=st.integers(1, 400),
    split=st.floats(0.5, 1.0),
    factor=st.floats(0.0, 2.0),
    jitter=st.floats(0.0, 0.5),
)
@settings(max_examples=60, deadline=None)
def test_strands_are_conserved_whatever_the_split(strands: int, split: float, factor: float, jitter: float) -> None:
    plant = parameters(strands=strands, split={"gravelius": split, "weibull": factor}, split_jitter=jitter)
    b = branching(plant)
    check_conserved(b)
    minor = np.flatnonzero(b.axis[2:] != b.axis[b.parent[2:]]) + 2
    assert np.all(2 * b.strands[minor] <= b.strands[b.parent[minor]])


def test_axes_are_numbered_as_a_skeleton_wants_them() -> None:
    b = branching(parameters(**BEECH))
    assert np.all(np.diff(b.axis) >= 0)
    chained = np.flatnonzero(np.diff(b.axis) == 0) + 1
    np.testing.assert_array_equal(b.parent[chained], chained - 1)
    begins = np.flatnonzero(np.diff(b.axis) > 0) + 1
    np.testing.assert_array_equal(b.gravelius[begins], b.gravelius[b.parent[begins]] + 1)
    np.testing.assert_array_equal(b.weibull[2:], b.weibull[b.parent[2:]] + 1)


def test_diameter_is_k_d_times_the_root_of_the_strands() -> None:
    plant = parameters(**BEECH)
    skeleton = GENERATOR.grow(plant, 20.0, 10.0, np.random.default_rng(0))
    b = branching(plant)
    np.testing.assert_allclose(2.0 * skeleton.radius_m, 0.01 * np.sqrt(b.strands), rtol=1e-6)
    np.testing.assert_array_equal(skeleton.order, b.gravelius)
    # Mandelbrot's rule: the sections of the sub-branches sum to their bearer's.
    area = np.bincount(b.parent[2:], weights=skeleton.radius_m[2:].astype(float) ** 2, minlength=len(b.parent))
    np.testing.assert_allclose(area[area > 0], skeleton.radius_m[area > 0].astype(float) ** 2, rtol=1e-5)


def test_another_exponent_keeps_one_strands_diameter() -> None:
    skeleton = GENERATOR.grow(parameters(**BEECH, thickness_exponent=0.6), 20.0, 10.0, np.random.default_rng(0))
    strands = branching(parameters(**BEECH)).strands
    np.testing.assert_allclose(skeleton.radius_m[strands == 1], 0.005, rtol=1e-6)
    assert skeleton.radius_m[1] == pytest.approx(0.005 * 1000**0.6, rel=1e-6)


LOPSIDED: dict[str, Any] = {  # every clamp of Eqs. 1-6 and of r at work
    "strands": 130,
    "trunk_length_m": 1.3,
    "thickness_m": 0.02,
    "phyllotaxis_deg": 137.5,
    "gravicentralism": 0.6,
    "split": {"gravelius": [[0, 0.9], [1, 0.6], [3, 1]], "weibull": [[0, 0.4], [4, 1], [9, 2]]},
    "angle_deg": {"gravelius": [[0, 120], [4, 20]], "weibull": [[0, 2], [5, 0.3]]},
    "shortest": {"gravelius": [[0, 0.9], [3, 0.2]], "weibull": [[0, 1], [10, 1.3]]},
    "longest": {"gravelius": [[0, 0.95], [3, 1.2]], "weibull": [[0, 1], [6, 0.5]]},
    "length": {"gravelius": [[0, 0.5], [3, 2]], "weibull": [[0, 2], [8, 0.3]]},
    "gravimorphism_deg": {"gravelius": [[0, 0], [1, 9], [2, -7], [3, 3]], "weibull": [[0, 0.5], [6, 1.5]]},
}


@pytest.mark.parametrize(
    "keys", [LOPSIDED, {**BEECH, "strands": 150}, {**PINE, "strands": 300}], ids=["lopsided", "beech", "pine"]
)
@pytest.mark.parametrize("speed", [0.0, 7.0])
def test_every_segment_stands_where_the_recursion_puts_it(keys: dict[str, Any], speed: float) -> None:
    wind = Wind(speed_directed=speed, axis=(1.0, 0.0, 0.0), bends="thick")
    expected = oracle(keys, w=(1.0, 0.0, 0.0), w_g=speed)
    b = branching(parameters(**keys))

    def rows(g: Any, w: Any, s: Any, foot: Any, end: Any) -> Any:
        table = np.column_stack([g, w, s, foot, end])
        return table[np.lexsort(np.round(table, 3).T[::-1])]

    position = pose(b, wind, 1.0, np.zeros((len(b.parent), 2))).position_m
    found = rows(b.gravelius[1:], b.weibull[1:], b.strands[1:], position[b.parent[1:]], position[1:])
    g, w, s, _, foot, end = (np.array(column) for column in zip(*expected, strict=True))
    to_plant = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # the page's y is the plant's z
    np.testing.assert_allclose(found, rows(g, w, s, foot @ to_plant.T, end @ to_plant.T), atol=1e-6)


def test_local_parameters_are_products_within_their_ranges() -> None:
    at = tables(parameters(**LOPSIDED))
    assert product(SPLIT, *at, 0, 0) == pytest.approx(0.5)  # 0.9 * 0.4 is below a half
    assert product(SPLIT, *at, 3, 9) == 1.0
    assert product(SPLIT, *at, 0, 2) == pytest.approx(0.9 * 0.7)
    assert product(ANGLE, *at, 0, 0) == pytest.approx(np.pi)  # 240 degrees
    assert product(ANGLE, *at, 4, 5) == pytest.approx(np.radians(6.0))
    assert product(LONGEST, *at, 3, 0) == pytest.approx(1.2)
    assert product(LONGEST, *at, 30, 600) == pytest.approx(0.6)  # beyond the last point
    extreme = tables(parameters(gravimorphism_deg={"gravelius": [[0, -150], [1, 150]], "weibull": 2}))
    assert [product(GRAVIMORPHISM, *extreme, g, 0) for g in (0, 1)] == pytest.approx([-np.pi, np.pi])


def test_the_papers_trees_are_as_tall_as_trees() -> None:
    """The published lengths are metres: a beech of 27 m, a pine of 23 m."""
    for keys, height in ((BEECH, 26.8), (PINE, 23.2)):
        skeleton = GENERATOR.grow(parameters(**keys), 20.0, 10.0, np.random.default_rng(0))
        assert skeleton.position_m[:, 2].max() == pytest.approx(height, abs=0.1)


def test_without_jitter_all_individuals_are_alike_and_with_it_none() -> None:
    def grown(seed: int, **keys: Any) -> Any:
        plant = parameters(**{**BEECH, **keys})
        return GENERATOR.grow(plant, 20.0, 10.0, np.random.default_rng(seed)).position_m

    np.testing.assert_array_equal(grown(1), grown(2))
    for key, value in {
        "angle_jitter_deg": 5,
        "phyllotaxis_jitter_deg": 20,
        "length_jitter": 0.1,
        "split_jitter": 0.05,
    }.items():
        assert not np.array_equal(grown(1, **{key: value}), grown(2, **{key: value}))
        np.testing.assert_array_equal(grown(3, **{key: value}), grown(3, **{key: value}))


def test_strands_may_depend_on_height() -> None:
    plant = parameters(strands=[[2, 50], [20, 1000]], trunk_length_m=[[2, 0.5], [20, 5]])
    assert branching(plant, 2.0).strands[1] == 50
    assert branching(plant, 11.0).strands[1] == 525
    assert branching(plant, 11.0).length_m[1] == pytest.approx(2.75)


def test_wood_scales_with_height_as_the_species_says() -> None:
    plants = [parameters(**BEECH, scale_by_height=scale) for scale in (1.0, [[0, 0], [20, 0.5]])]
    full, half = (GENERATOR.grow(plant, 20.0, 10.0, np.random.default_rng(0)) for plant in plants)
    np.testing.assert_allclose(half.position_m, 0.5 * full.position_m, atol=1e-5)
    np.testing.assert_allclose(half.radius_m, 0.5 * full.radius_m, rtol=1e-6)


def test_a_level_of_detail_stops_at_its_strands() -> None:
    full, cut = (branching(parameters(**BEECH, lod=lod)) for lod in (0, 7))
    ends = np.setdiff1d(np.arange(1, len(cut.parent)), cut.parent)
    assert cut.strands[ends].sum() == 1000
    assert cut.strands[ends].max() == 7
    assert np.all(cut.strands[np.setdiff1d(np.arange(1, len(cut.parent)), ends)] > 7)
    assert len(cut.parent) < 0.4 * len(full.parent)


@pytest.mark.parametrize(
    "keys",
    [
        {"strands": 0},
        {"strands": 1e9},
        {"strands": [[1, 10]]},
        {"trunk_length_m": -1},
        {"thickness_m": 0},
        {"gravicentralism": 1.2},
        {"phyllotaxis_deg": 400},
        {"split": {"gravelius": 0.3}},
        {"split": {"gravelius": [[0, 0.75]]}},
        {"angle_deg": {"gravelius": 200}},
        {"length": {"gravelius": -0.5}},
        {"length": {"gravelius": [[0, 1], [15, 11]]}},
        {"shortest": {"weibull": 2.5}},
        {"shortest": {"gravelius": {"smooth": [[0, 1], [3, -1]]}}},
        {"leaves": {"shape": "needle"}},
        {"leaves": {"shape": "leaf", "arrangement": "random"}},
        {"leaves": {"shape": "leaf", "size_m": -0.1}},
        {"wind": {"axis": [0, 0, 0]}},
        {"wind": {"speed_directed": 11}},
    ],
    ids=str,
)
def test_bad_parameters_are_refused(keys: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        parameters(**keys)


def test_a_plant_without_any_length_is_refused() -> None:
    with raises_error(RecipeError, place="plant"):
        branching(parameters(trunk_length_m=0, length={"gravelius": 0}))


def test_a_plant_too_large_for_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("forestgen.plants.skeleton.free_bytes", lambda: 100_000_000)
    with raises_error(RecipeError, place="plant"):
        branching(parameters(strands=200_000))
    plant = parameters(strands=1000, leaves={"shape": "leaf", "density": 200})
    with raises_error(RecipeError, place="plant"):
        GENERATOR.grow(plant, 20.0, 10.0, np.random.default_rng(0))


def test_the_registry_knows_the_generator() -> None:
    assert GENERATORS.load("strands") is GENERATOR
