"""Gap fractions of images whose canopy is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.parts import Part
from forestgen.labels.gap_fraction import gap_fraction_of, looks_up
from forestgen.render.frame import Identity
from forestgen.render.identity import sample_offsets
from support.cameras import camera_of

UP = camera_of("fisheye", (200, 200), (0.0, 0.0, 1.0), (0.0, 1e-6, 9.0))
OFFSETS = sample_offsets(4)


def zenith_rad(camera=UP) -> np.ndarray:
    """(H, W, S) of the samples, by their radius."""
    width, height = camera.size_px
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    x, y = column[..., None] + OFFSETS[:, 0] - width / 2, row[..., None] + OFFSETS[:, 1] - height / 2
    return np.hypot(x, y) / (width / 2) * np.radians(camera.hfov_deg / 2)


def image_of(gap: np.ndarray, plant: int = 7) -> Identity:
    """Plants where there is no gap."""
    part = np.where(gap, Part.NOTHING, Part.LEAF).astype(np.uint8)
    return Identity(np.where(gap, 0, plant).astype(np.uint32), part)


def test_an_open_sky_has_no_leaves_and_a_closed_one_no_gap():
    theta = zenith_rad()
    found = gap_fraction_of(UP, image_of(np.ones(theta.shape, dtype=bool)))
    assert (found.gap_fraction == 1).all()
    assert (found.effective_lai, found.hinge_lai, found.openness) == (0.0, 0.0, 1.0)
    assert found.samples.sum() == (theta < np.pi / 2).sum()
    closed = gap_fraction_of(UP, image_of(np.zeros(theta.shape, dtype=bool)))
    assert (closed.gap_fraction == 0).all()
    assert closed.openness == 0
    assert np.isfinite(closed.effective_lai)
    assert closed.effective_lai > 5


@pytest.mark.parametrize("lai", [0.5, 2.0])
def test_leaves_of_all_angles_give_their_area_index(lai):
    """P = exp(-L / (2 cos theta)), of leaves like the surface of a sphere."""
    theta = zenith_rad()
    gap = np.random.default_rng(3).random(theta.shape) < np.exp(-lai / 2 / np.maximum(np.cos(theta), 1e-3))
    found = gap_fraction_of(UP, image_of(gap))
    middle = np.radians(0.5 * (found.edges_deg[1:] + found.edges_deg[:-1]))
    expected = np.exp(-lai / 2 / np.cos(middle))
    spread = np.sqrt(expected * (1 - expected) / found.samples)
    assert (np.abs(found.gap_fraction - expected)[:15] < 4 * spread[:15] + 0.01 * lai).all()
    assert found.effective_lai == pytest.approx(lai, rel=0.05)
    assert found.hinge_lai == pytest.approx(lai, rel=0.05)


def test_rings_of_a_step_are_exact_and_openness_is_solid_angle():
    theta = zenith_rad()
    found = gap_fraction_of(UP, image_of(theta < np.radians(40)))
    assert found.gap_fraction.tolist() == [1.0] * 8 + [0.0] * 10
    assert found.openness == pytest.approx(1 - np.cos(np.radians(40)), rel=2e-3)


def test_ground_and_what_is_outside_of_the_circle_do_not_count():
    theta = zenith_rad()
    image = image_of(theta < np.radians(40))
    plant, part = image.plant_id, image.part
    hidden = (theta > np.radians(50)) & (theta < np.radians(60))
    plant[hidden], part[hidden] = 0, Part.GROUND
    outside = theta > np.pi / 2
    plant[outside], part[outside] = 0, Part.NOTHING
    found = gap_fraction_of(UP, image)
    assert found.samples[10:12].tolist() == [0, 0]
    assert np.isnan(found.gap_fraction[10])
    assert np.isnan(found.hinge_lai)
    assert np.isfinite(found.effective_lai)
    narrow = replace(UP, hfov_deg=100.0)
    inner = gap_fraction_of(narrow, image_of(np.ones(theta.shape, dtype=bool)))
    assert (inner.samples > 0).tolist() == [True] * 10 + [False] * 8


def test_only_fisheyes_that_look_up_have_one():
    level = camera_of("fisheye", (20, 20), (0.0, 0.0, 1.0))
    assert looks_up(UP)
    for camera in (level, camera_of("panorama", (20, 20), (0.0, 0.0, 1.0), (0.0, 1e-6, 9.0))):
        assert not looks_up(camera)
        with pytest.raises(ValueError, match="straight up"):
            gap_fraction_of(camera, image_of(np.ones((20, 20, 4), dtype=bool)))
    fields = gap_fraction_of(UP, image_of(np.ones((200, 200, 4), dtype=bool))).as_dict()
    assert fields["gap_fraction"] == [1.0] * 18
    assert fields["effective_lai"] == 0
