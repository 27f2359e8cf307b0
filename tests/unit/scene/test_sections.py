"""Areas of sections, against those of circles and squares, and of overlapping tubes counted point by point."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.geometry.mesh import Mesh
from forestgen.scene.plant_measures import section_area_m2


def tube(foot, tip, radius_m, sides=48, tip_radius_m=None):
    """An open tube of level rings: its level sections are regular polygons."""
    angle = np.arange(sides) / sides * 2 * np.pi
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    ends = np.concatenate([foot + ring * radius_m, tip + ring * (radius_m if tip_radius_m is None else tip_radius_m)])
    k, after = np.arange(sides), (np.arange(sides) + 1) % sides
    lower = np.stack([k, after, after + sides], axis=1)
    upper = np.stack([k, after + sides, k + sides], axis=1)
    return Mesh(ends.astype(np.float32), np.concatenate([lower, upper]).astype(np.uint32))


def polygon_area(radius_m, sides=48):
    return sides / 2 * np.sin(2 * np.pi / sides) * radius_m**2


def test_a_cone_at_every_height():
    heights = np.array([-0.5, 0.0, 0.5, 1.0, 1.999, 2.5])
    area = section_area_m2([tube(np.zeros(3), np.array([0.3, 0, 2]), 0.4, tip_radius_m=0.2)], heights)
    radius = 0.4 - 0.1 * heights
    # A corner in the plane counts as above it: nothing is cut at the foot, and at the top everything would be.
    expected = np.where((heights > 0) & (heights < 2), polygon_area(radius), 0)
    np.testing.assert_allclose(area, expected, rtol=1e-6)


@pytest.mark.parametrize("apart_m", [0.0, 0.1, 0.3, 0.5, 0.7, 1.0])
def test_overlapping_tubes_count_once(apart_m):
    up = np.array([0.02, 0.01, 3.0])
    places = np.array([[0, 0, 0], [apart_m, 0.013, 0]])
    tubes = [tube(place, place + up, 0.3, sides=96) for place in places]
    area = section_area_m2(tubes, np.array([1.3]))[0]
    x, y = np.meshgrid(*[np.linspace(-0.5, 1.5, 1600)] * 2)
    middle = places + up * 1.3 / 3
    inside = np.any([np.hypot(x - cx, y - cy) < 0.3 for cx, cy, _ in middle], axis=0)
    assert area == pytest.approx(inside.sum() * (2.0 / 1599) ** 2, rel=3e-3)


def test_a_tube_inside_another_adds_nothing_and_one_apart_all_of_it():
    outer, inner = tube(np.zeros(3), np.array([0, 0, 2.0]), 0.5), tube(np.zeros(3), np.array([0.05, 0, 2.0]), 0.2)
    away = tube(np.array([3.0, 0, 0]), np.array([3.0, 0, 2.0]), 0.2)
    one = section_area_m2([outer], np.array([1.0]))
    np.testing.assert_allclose(section_area_m2([outer, inner], np.array([1.0])), one, rtol=1e-9)
    np.testing.assert_allclose(section_area_m2([outer, away], np.array([1.0])), one + polygon_area(0.2), rtol=1e-6)


def test_a_plane_through_rings_of_corners_is_no_trouble():
    lower = tube(np.zeros(3), np.array([0, 0, 1.0]), 0.25)
    upper = tube(np.array([0, 0, 1.0]), np.array([0, 0, 2.0]), 0.25)
    area = section_area_m2([lower, upper], np.array([1.0]))
    np.testing.assert_allclose(area, polygon_area(0.25), rtol=1e-6)


def test_sheets_and_nothing_have_no_area():
    sheet = Mesh(np.array([[0, 0, 0], [1, 0, 2], [1, 1, 2]], np.float32), np.array([[0, 1, 2]], np.uint32))
    assert section_area_m2([sheet], np.array([1.0])).tolist() == [0.0]
    assert section_area_m2([], np.array([1.0])).tolist() == [0.0]
    assert section_area_m2([sheet], np.zeros(0)).tolist() == []
