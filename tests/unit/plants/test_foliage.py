"""Foliage rules on a straight stem: counts, places, attitudes, and the limit on their number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.plants.foliage import Foliage, _deviations, place
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from support.error_messages import raises_error

LENGTH_M = 1.0
BASE_RADIUS_M, TIP_RADIUS_M = 0.02, 0.002


def stem(nodes: int = 51) -> Skeleton:
    height = np.linspace(0.0, LENGTH_M, nodes)
    return Skeleton(
        np.arange(-1, nodes - 1, dtype=np.int32),
        np.column_stack([np.zeros(nodes), np.zeros(nodes), height]).astype(np.float32),
        np.linspace(BASE_RADIUS_M, TIP_RADIUS_M, nodes).astype(np.float32),
        np.zeros(nodes, np.uint8),
        np.zeros(nodes, np.int32),
    )


def placed(**keys: Any) -> OrganPlacements:
    rule = Foliage.model_validate({"shape": "leaf", "orders": [0], "turn_jitter_deg": 0} | keys)
    return place(rule, stem(), 5.0, np.random.default_rng(3))


def azimuths_deg(found: OrganPlacements) -> np.ndarray:
    along = found.frame[:, :, 1]
    return np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 360.0


@pytest.mark.parametrize(("spacing_m", "expected"), [(0.1, 10), (0.05, 20), (0.013, 77)])
def test_spacing_gives_the_number(spacing_m: float, expected: int) -> None:
    assert len(placed(spacing_m=spacing_m).frame) == expected


@pytest.mark.parametrize("count", [1, 7])
@pytest.mark.parametrize("per_node", [1, 2, 5])
@pytest.mark.parametrize("terminal", [False, True])
def test_count_and_organs_at_a_node(count: int, per_node: int, terminal: bool) -> None:
    found = placed(count=count, per_node=per_node, terminal=terminal)
    assert len(found.frame) == count * per_node + terminal


def test_decussate_pairs() -> None:
    azimuth = azimuths_deg(placed(spacing_m=0.1, per_node=2, divergence_deg=90)).reshape(-1, 2)
    np.testing.assert_allclose((azimuth[:, 1] - azimuth[:, 0]) % 360.0, 180.0, atol=0.01)
    np.testing.assert_allclose((azimuth[1:, 0] - azimuth[:-1, 0]) % 180.0, 90.0, atol=0.01)


def test_a_whorl_stands_evenly_at_one_height() -> None:
    found = placed(count=1, per_node=6)
    np.testing.assert_allclose(np.sort(np.diff(np.sort(azimuths_deg(found)))), 60.0, atol=0.01)
    assert np.ptp(found.frame[:, 2, 3]) < 0.01


@pytest.mark.parametrize(("end", "low", "high"), [("tip", 0.8, 1.0), ("base", 0.0, 0.2)])
def test_within_counts_from_either_end(end: str, low: float, high: float) -> None:
    height = placed(spacing_m=0.01, within_m=0.2, end=end, angle_deg=90).frame[:, 2, 3]
    assert len(height) == 20
    assert low <= height.min() < height.max() <= high


def test_only_thin_shoots_bear() -> None:
    found = placed(spacing_m=0.01, thinner_than_m=0.02, angle_deg=90)
    share = (0.01 - BASE_RADIUS_M) / (TIP_RADIUS_M - BASE_RADIUS_M)
    assert found.frame[:, 2, 3].min() == pytest.approx(share * LENGTH_M, abs=0.03)
    assert len(found.frame) == pytest.approx(100 * (1.0 - share), abs=3)


def test_light_lays_organs_flat() -> None:
    rise = [np.abs(placed(spacing_m=0.02, angle_deg=40, light=light).frame[:, 2, 1]).mean() for light in (0, 0.5, 1)]
    assert rise[0] == pytest.approx(np.cos(np.radians(40.0)), rel=1e-5)
    assert rise[0] > rise[1] > rise[2]
    assert rise[2] < 0.01
    upper = placed(spacing_m=0.02, angle_deg=40, light=1).frame[:, 2, 2]
    assert upper.min() > 0.99, "the upper side looks at the sky"


def test_frames_are_right_handed_rotations_times_size() -> None:
    found = placed(spacing_m=0.02, size=0.7, per_node=3, roll_jitter_deg=30, droop_deg=20, light=0.3)
    linear = found.frame[:, :, :3].astype(np.float64) / 0.7
    np.testing.assert_allclose(linear @ linear.transpose(0, 2, 1), np.tile(np.eye(3), (len(linear), 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(linear), 1.0, atol=1e-5)


@pytest.mark.parametrize(
    "keys",
    [
        {"spacing_m": 1e-9},
        {"spacing_m": 1e-320},
        {"spacing_m": 0.01, "size_by_height": 0},
        {"count": 10_000, "per_node": 500, "spacing_m": None, "orders": [0] * 1},
        {"spacing_m": 1e-6, "per_node": 500},
    ],
)
def test_too_many_organs_are_refused_before_they_are_made(
    keys: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("forestgen.plants.skeleton.LARGEST_PLANT", 1_000_000)
    with raises_error(RecipeError, place="plant"):
        placed(**keys)


@pytest.mark.parametrize("keys", [{}, {"spacing_m": 0.1, "count": 3}, {"spacing_m": 0}, {"count": 0}, {"orders": []}])
def test_a_rule_has_a_spacing_or_a_count(keys: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        placed(**keys)


def test_organs_of_an_axis_are_alike_and_lean_to_one_side() -> None:
    """Sizes and rolls stay standard normal; organs on opposite sides of an axis roll against each other."""
    axis = np.repeat(np.arange(20_000), 2)
    along = np.tile([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], (20_000, 1))
    for shared in (0.0, 0.7):
        shares = np.full(len(axis), shared > 0.0)
        larger, tilt = _deviations(axis, along, shares, np.random.default_rng(1))
        for one, sign in ((larger, 1.0), (tilt, -1.0)):
            assert np.std(one) == pytest.approx(1.0, abs=0.02)
            assert np.mean(one[::2] * one[1::2]) == pytest.approx(sign * shared, abs=0.03)
        upright = _deviations(axis, np.abs(along[:, ::-1]), shares, np.random.default_rng(1))
        assert np.std(upright, axis=1) == pytest.approx(1.0, abs=0.02)
