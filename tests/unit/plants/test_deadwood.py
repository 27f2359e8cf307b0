"""Snags, stumps and logs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.plants.generators.deadwood import GENERATOR, Parameters
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import Skeleton


def parameters(**changes: Any) -> Parameters:
    plain = {"form": "snag", "wood": {"material": "bark"}, "lean_deg": 0, "bow_deg_per_m": 0, "stubs_per_m": 0}
    return Parameters.model_validate(plain | changes)


def grow(height_m: float, width_m: float, seed: int = 1, **changes: Any) -> Skeleton:
    return GENERATOR.grow(parameters(**changes), height_m, width_m, np.random.default_rng(seed))


def check(skeleton: Skeleton) -> None:
    parent = skeleton.parent
    same = skeleton.axis[1:] == skeleton.axis[:-1]
    assert np.all(parent[1:][same] == np.arange(len(parent) - 1)[same])
    assert np.all(np.isfinite(skeleton.position_m))
    assert np.all(skeleton.radius_m > 0)


@pytest.mark.parametrize("seed", range(4))
def test_a_snag_is_as_tall_and_thick_as_asked(seed: int) -> None:
    ratio = [[5, 0.04], [15, 0.02]]
    skeleton = grow(10.0, 1.0, seed, diameter_ratio=ratio, stubs_per_m=2, lean_deg=3, bow_deg_per_m=2)
    check(skeleton)
    assert skeleton.position_m[:, 2].max() == pytest.approx(10.0, rel=0.01)
    assert skeleton.radius_m[0] == pytest.approx(0.5 * 10.0 * 0.03)
    stem = skeleton.radius_m[skeleton.order == 0]
    assert stem[-1] == pytest.approx(0.6 * stem[0])


def test_a_sawn_stump_ends_flat_under_its_cut() -> None:
    shapes = {"cut": {"form": "disc", "material": "wood", "diameter_m": 1}}
    skeleton = grow(0.5, 0.6, form="stump", diameter_ratio=1.2, ending="sawn", roots=5, cut_shape="cut", shapes=shapes)
    check(skeleton)
    assert skeleton.position_m[:, 2].max() == pytest.approx(0.5)
    assert len(np.unique(skeleton.axis[skeleton.order == 1])) == 5
    assert skeleton.position_m[skeleton.order == 1, 2].min() < 0.0, "roots dive under the ground"
    (cut,) = skeleton.organs
    linear = cut.frame[0, :, :3].astype(np.float64)
    np.testing.assert_allclose(linear[:, 2] / np.linalg.norm(linear[:, 2]), [0, 0, 1], atol=1e-6)
    assert np.linalg.det(linear) == pytest.approx((2 * skeleton.radius_m[skeleton.order == 0][-1]) ** 3, rel=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_a_logs_height_is_its_diameter_and_its_width_the_mean_extent(seed: int) -> None:
    skeleton = grow(0.4, 3.0, seed, form="log", ending="sawn", top_share=1.0, sunk=0.0)
    check(skeleton)
    length = float(np.ptp(skeleton.position_m[:, 0]))
    assert 0.5 * (length + 0.4) == pytest.approx(3.0, rel=1e-3)
    np.testing.assert_allclose(skeleton.position_m[[0, -1], 2], 0.2, atol=1e-5)
    np.testing.assert_allclose(skeleton.radius_m, 0.2, rtol=1e-6)


def test_stubs_come_at_their_rate() -> None:
    counts = [len(np.unique(grow(10.0, 1.0, seed, ending="sawn", stubs_per_m=3.0).axis)) - 1 for seed in range(200)]
    assert np.mean(counts) == pytest.approx(30.0, abs=4 * np.sqrt(30.0 / 200))


def test_same_seed_same_wood() -> None:
    one, again, other = (grow(8.0, 1.0, seed, stubs_per_m=2).position_m for seed in (5, 5, 6))
    assert one.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"form": "trunk"}, "snag"),
        ({"diameter_ratio": -1}, "negative"),
        ({"diameter_ratio": [[1, 1]]}, "two"),
        ({"cut_shape": "cut"}, "cut_shape"),
        ({"top_share": 0}, "greater than 0"),
        ({"roots": 10**9}, "16"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        parameters(**changes)


def test_registry_knows_the_generator() -> None:
    assert GENERATORS.load("deadwood") is GENERATOR
