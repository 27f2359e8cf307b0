"""Rain: its drops, and that streaks cover what they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label

from forestgen.recipe import land
from forestgen.render import falling as render_falling
from forestgen.render.falling import coverage
from forestgen.scene.projection import image_circle
from forestgen.scene.puddles import filled, puddles_m
from forestgen.scene.shaped_ground import shaped
from forestgen.scene.spec import Falling
from forestgen.scene.terrain import HeightField
from forestgen.scene.weather import snowfall
from forestgen.scene.weather.rain import extinction_per_m, fall_m_per_s, slope_per_mm
from support.scenes import camera_at


def test_drops_are_as_many_as_fall_and_dim_the_air() -> None:
    """The water of Marshall and Palmer's drops at Gunn and Kinzer's speeds is the rate, within a fifth."""
    diameter = np.linspace(0.01, 10.0, 4000)
    for rate in (2.0, 8.0, 30.0):
        number = 8000.0 * np.exp(-slope_per_mm(rate) * diameter)
        fallen = np.trapezoid(number * np.pi / 6.0 * diameter**3 * fall_m_per_s(diameter), diameter) * 3600.0 * 1e-6
        assert fallen == pytest.approx(rate, rel=0.2)
        taken = np.trapezoid(number * 2.0 * np.pi / 4.0 * diameter**2, diameter) * 1e-6
        assert extinction_per_m(rate) == pytest.approx(taken, rel=0.01)


def falling(shutter_s: float) -> Falling:
    return Falling(60.0, 2.0, 0.5, (0.0, 0.0), shutter_s, fall_m_per_s)


@pytest.mark.parametrize("shutter_s", [0.001, 0.02])
def test_streaks_cover_as_much_as_the_drops_themselves(shutter_s: float) -> None:
    """Summed over the image: the number of drops times their mean cross-section, seen between 1 and 12 m."""
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 50.0, 2.0), (240, 160), 60.0)
    rng = np.random.default_rng(5)
    covered = coverage(falling(shutter_s), camera, np.full((160, 240), np.inf, np.float32), rng)
    square_m2 = (2.0**2 + 2.0 * 2.0 * 0.5 + 2.0 * 0.5**2) * 1e-6
    assert covered.mean() == pytest.approx(60.0 * 11.0 * np.pi / 4.0 * square_m2, rel=0.15)


def test_parallel_rays_see_a_slab_of_drops() -> None:
    camera = replace(camera_at((0.0, 0.0, 2.0), (0.0, 50.0, 2.0), (240, 160), 60.0), projection="orthographic")
    camera = replace(camera, width_m=6.0)
    covered = coverage(falling(0.01), camera, np.full((160, 240), np.inf, np.float32), np.random.default_rng(5))
    square_m2 = (2.0**2 + 2.0 * 2.0 * 0.5 + 2.0 * 0.5**2) * 1e-6
    assert covered.mean() == pytest.approx(60.0 * 11.0 * np.pi / 4.0 * square_m2, rel=0.15)


def test_no_drop_falls_outside_of_a_fisheyes_circle() -> None:
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 0.1, 50.0), (160, 160), 180.0)
    camera = replace(camera, projection="fisheye", hfov_deg=180.0)
    covered = coverage(falling(0.01), camera, np.full((160, 160), np.inf, np.float32), np.random.default_rng(5))
    assert covered[~image_circle(camera)].max() == 0.0
    assert covered[image_circle(camera)].mean() > 0.0


def test_puddles_fill_hollows_and_run_off_at_the_edge() -> None:
    """Brute force: water on a cell stands as high as the lowest pass of any way to the edge."""
    height = np.random.default_rng(3).random((9, 11))
    level = np.full(height.shape, np.inf)
    for cell in np.ndindex(*height.shape):
        for threshold in np.sort(height.ravel()):
            pools, _ = label(height <= threshold, np.ones((3, 3)))
            here = pools[cell]
            if here and here in np.concatenate([pools[0], pools[-1], pools[:, 0], pools[:, -1]]):
                level[cell] = threshold
                break
    np.testing.assert_array_equal(filled(height), level)


def test_puddles_stand_in_ruts_alone() -> None:
    road = land.Path(what="forest_road", points_m=((-10.0, 20.0), (50.0, 20.0)))
    ground = shaped(HeightField((40.0, 40.0)), None, (road,), (), 3)
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0.0, 40.0, 0.1), np.arange(10.0, 30.0, 0.1)))
    depth = puddles_m(ground, x, y)
    wet = depth > 0.0
    assert 0.0 < wet.mean() < 0.1
    assert (np.abs(np.abs(y[wet] - 20.0) - 0.9) < 0.5).all()
    assert depth.max() < 0.15
    assert (puddles_m(HeightField((40.0, 40.0)), x, y) < 0.0).all()


def test_a_near_surface_hides_them() -> None:
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 50.0, 2.0), (120, 80), 60.0)
    wall = np.full((80, 120), np.inf, np.float32)
    wall[:, :60] = 0.9
    covered = coverage(falling(0.01), camera, wall, np.random.default_rng(5))
    assert covered[:, :60].max() == 0.0
    assert covered[:, 60:].max() > 0.0


def test_flakes_carry_the_snow_that_falls_and_dim_the_air() -> None:
    """The water of Gunn and Marshall's flakes at Locatelli and Hobbs' speeds is the rate of usual snowfalls."""
    melted = np.linspace(0.01, 20.0, 8000)
    for rate in (0.5, 1.0):
        number = snowfall.number_per_m3_mm(rate) * np.exp(-snowfall.slope_per_mm(rate) * melted)
        fallen = np.trapezoid(number * np.pi / 6.0 * melted**3 * snowfall.fall_m_per_s(melted), melted) * 3600.0 * 1e-6
        assert fallen == pytest.approx(rate, rel=0.2)
        taken = np.trapezoid(number * 2.0 * np.pi / 4.0 * snowfall.seen_mm(melted) ** 2, melted) * 1e-6
        assert snowfall.extinction_per_m(rate) == pytest.approx(taken, rel=0.01)


def test_many_things_are_drawn_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = replace(camera_at((0.0, 0.0, 2.0), (0.0, 50.0, 2.0), (64, 32), 60.0), projection="panorama")
    many, far = replace(falling(0.01), number_per_m3=20.0), np.full((32, 64), np.inf, np.float32)
    whole = coverage(many, camera, far, np.random.default_rng(5))
    monkeypatch.setattr(render_falling, "_MOST_THINGS", 10_000)
    parts = coverage(many, camera, far, np.random.default_rng(5))
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.03)
    assert (parts != whole).any()


def test_wide_flakes_are_discs_that_cover_what_they_measure() -> None:
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 50.0, 2.0), (240, 160), 60.0)
    wide = replace(falling(0.0001), number_per_m3=0.5, seen_mm=lambda mm: 20.0 + 0.0 * mm)
    covered = coverage(wide, camera, np.full((160, 240), np.inf, np.float32), np.random.default_rng(5))
    assert covered.mean() == pytest.approx(0.5 * 11.0 * np.pi / 4.0 * 20.0**2 * 1e-6, rel=0.15)
    assert covered.max() > 0.8
