"""Boxes: volumes of spheres within them, and what ground they cover."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes, volume_in_boxes

SPHERE = 4 / 3 * np.pi


def box(size: tuple[float, float, float], base: tuple[float, float, float] = (0, 0, 0), azimuth: float = 0.0) -> Boxes:
    return Boxes(np.array([base], dtype=float), np.array([size], dtype=float), np.array([azimuth]))


def volume(at: tuple[float, float, float], r: float, boxes: Boxes, width: float = 0.0, height: float = 0.0) -> float:
    return float(volume_in_boxes(*at, r, boxes.rows, width, height))


def test_limits() -> None:
    large = box((100, 100, 100), (0, 0, -50))
    assert volume((3, 4, 5), 2, large) == pytest.approx(SPHERE * 8, rel=1e-6)
    assert volume((50, 0, 0), 2, large) == pytest.approx(SPHERE * 4, rel=1e-6)
    assert volume((50, 50, 0), 2, large) == pytest.approx(SPHERE * 2, rel=1e-6)
    assert volume((50, -50, 50), 2, large) == pytest.approx(SPHERE, rel=1e-6)
    assert volume((52, 0, 0), 2, large) == 0.0
    assert volume((0.2, 0.1, 0.5), 9, box((1, 2, 3), (0, 0, -1))) == pytest.approx(6, rel=1e-6)
    assert volume((0, 0, 0), 1, NO_BOXES) == 0.0


@pytest.mark.parametrize("depth", [0.1, 0.7, 1.0, 1.6])
def test_cap(depth: float) -> None:
    at = (0.0, 0.0, 1.0 - depth)
    assert volume(at, 1.0, box((9, 9, 9), (0, 0, -9))) == pytest.approx(np.pi * depth**2 * (1 - depth / 3), rel=1e-6)


def test_points_of_the_sphere_agree() -> None:
    """Against the share of 4 million points; and one number for the error, against slices a thousand times finer."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (4_000_000, 3))
    points = points[(points**2).sum(axis=1) < 1]
    for _ in range(12):
        size, at = rng.uniform(0.3, 3, 3), rng.uniform(-1, 1, 3)
        azimuth = float(rng.uniform(-4, 4))
        one = box(tuple(size), (0, 0, -size[2] / 2), azimuth)
        moved = points + at
        along = moved[:, 0] * np.cos(azimuth) + moved[:, 1] * np.sin(azimuth)
        across = moved[:, 1] * np.cos(azimuth) - moved[:, 0] * np.sin(azimuth)
        inside = (np.abs(np.stack([along, across, moved[:, 2]], axis=1)) <= size / 2).all(axis=1).mean()
        assert volume(tuple(at), 1.0, one) / SPHERE == pytest.approx(inside, abs=2e-3)


def test_parts_of_a_box_add_up() -> None:
    """Error below 1e-5 of the sphere: a box cut at any place holds what its parts hold."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        size, at, cut = rng.uniform(0.2, 3, 3), tuple(rng.uniform(-1.5, 1.5, 3)), rng.uniform(0.1, 0.9)
        whole = volume(at, 1.0, box(tuple(size)))
        for axis in range(3):
            low, high = size.copy(), size.copy()
            low[axis], high[axis] = size[axis] * cut, size[axis] * (1 - cut)
            base_low, base_high = np.zeros(3), np.zeros(3)
            if axis == 2:
                base_high[2] = low[2]
            else:
                base_low[axis], base_high[axis] = -high[axis] / 2, low[axis] / 2
            parts = volume(at, 1.0, box(tuple(low), tuple(base_low))) + volume(
                at, 1.0, box(tuple(high), tuple(base_high))
            )
            assert abs(parts - whole) / SPHERE < 1e-5


def test_on_a_torus_the_nearest_image_counts() -> None:
    one = box((2, 2, 2), (19, 1, 0))
    assert volume((0.5, 29.5, 1), 1, one, 20, 30) == pytest.approx(volume((20.5, -0.5, 1), 1, one))
    assert volume((0.5, 29.5, 1), 1, one) == 0.0


def test_ground_that_is_covered() -> None:
    one = box((4, 2, 3), (10, 10, 0), np.pi / 2)  # its width runs along y
    at = np.array([[10, 11.9], [10.9, 10], [11.1, 10], [10, 12.1], [30, 10]])
    assert one.cover(at).tolist() == [True, True, False, False, False]
    assert one.cover(at, (20.0, 20.0)).tolist() == [True, True, False, False, True]
