"""Boundaries, motion and keypoints in images of all kinds of cameras, of surfaces that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.labels.channels.boundaries import occlusion_boundaries
from forestgen.labels.channels.motion import motion_px
from forestgen.labels.labelled import project
from forestgen.render.frame import Surface
from forestgen.render.identity.surface import empty_surface
from forestgen.scene import projection
from forestgen.scene.spec import Camera, Instances
from support.cameras import KINDS, camera_of

NOBODY = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
PLACE = (1.0, 2.0, 3.0)
SIZE = (48, 36)


def camera(kind: str, **about) -> Camera:
    return camera_of(kind, SIZE, PLACE, (3.0, 12.0, 1.0), **{"width_m": 3.0, **about})


def planes(view: Camera, walls: list[tuple[np.ndarray, float]]) -> Surface:
    """The nearest of planes n . p = d, world, that rays of the camera meet in front of them."""
    rays, surface = projection.world_rays(view), empty_surface(SIZE[1], SIZE[0])
    start = np.broadcast_to(rays.origin_m, rays.direction.shape)
    nearest, normal = np.full(rays.valid.shape, np.inf), np.zeros((*rays.valid.shape, 3))
    for n, d in walls:
        with np.errstate(divide="ignore"):
            t = (d - start @ n) / (rays.direction @ n)
        closer = (t > 0) & (t < nearest) & rays.valid
        nearest[closer] = t[closer]
        normal[closer] = n
    facing = np.sign(np.einsum("hwk,hwk->hw", normal, rays.direction))[..., None]
    own = rays.direction @ view.world_from_camera[:, 2]
    depth = nearest if projection.projection_of(view).depth_is_distance else nearest * own
    depth = np.where(np.isfinite(nearest), depth, np.inf)
    return replace(
        surface,
        distance_m=nearest.astype(np.float32),
        depth_m=depth.astype(np.float32),
        normal=(-facing * normal).astype(np.float32),
    )


GROUND = (np.array([0.0, 0.0, 1.0]), 0.0)
SLOPE = (np.array([0.6, -0.64, 0.48]), -9.0)


@pytest.mark.parametrize("kind", KINDS)
def test_one_plane_and_two_that_meet_hide_nothing(kind):
    """In a corner the nearer plane ends where the other begins; the sky alone is hidden."""
    view = camera(kind)
    for walls in ([GROUND], [GROUND, SLOPE]):
        surface = planes(view, walls)
        assert np.isfinite(surface.depth_m).any()
        found = occlusion_boundaries(surface, view)
        sky = np.isinf(surface.depth_m)
        beside = np.zeros_like(sky)
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            beside |= np.roll(sky, step, axis=axis)
        assert not (found & ~beside).any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_nearer_half_hides_the_other_along_its_border(kind):
    view = camera(kind)
    surface = planes(view, [GROUND])
    near = planes(view, [(np.array([0.0, 0.0, 1.0]), 1.5)])
    solid = np.isfinite(surface.depth_m) & np.isfinite(near.depth_m)
    front = solid & (np.arange(SIZE[0]) < 24)
    mixed = {
        name: np.where(front[..., None] if values.ndim == 3 else front, getattr(near, name), values)
        for name, values in (
            ("depth_m", surface.depth_m),
            ("distance_m", surface.distance_m),
            ("normal", surface.normal),
        )
    }
    found = occlusion_boundaries(replace(surface, **mixed), view)
    both = solid[:, 23] & solid[:, 24]
    assert both.any()
    assert found[both, 23].all()
    assert not found[both, 24][1:-1].all()


def test_boundaries_look_across_a_panoramas_seam_and_not_across_a_fisheyes_circle():
    view = camera_of("panorama", SIZE, PLACE)
    surface = planes(view, [GROUND])
    depth = surface.depth_m.copy()
    low = np.isfinite(depth[:, 0])
    depth[low, 0] /= 2
    found = occlusion_boundaries(replace(surface, depth_m=depth, distance_m=depth), view)
    assert found[low, 0].all()
    without = depth.copy()
    without[:, 1] = depth[:, 0]
    without[:, 2:24] = depth[:, [0]]
    found = occlusion_boundaries(replace(surface, depth_m=without, distance_m=without), view)
    assert found[low, 0].all(), "only its neighbour beyond the seam is further away"
    whole = camera_of("fisheye", SIZE, PLACE, (1.0, 2.001, -9.0), hfov_deg=120.0)
    assert np.isinf(planes(whole, [GROUND]).depth_m).any()
    assert not occlusion_boundaries(planes(whole, [GROUND]), whole).any()


@pytest.mark.parametrize("kind", KINDS)
def test_what_stands_still_moves_by_the_cameras(kind):
    view = camera(kind)
    then = camera_of(kind, SIZE, (1.3, 2.2, 3.1), (3.5, 12.0, 1.2), width_m=3.0)
    surface = planes(view, [GROUND])
    motion = motion_px(view, surface, NOBODY, then, NOBODY)
    rays = projection.world_rays(view)
    solid = np.isfinite(surface.depth_m)
    point = rays.origin_m + rays.direction * np.where(solid, surface.distance_m, 0).astype(float)[..., None]
    away = np.where(solid[..., None], point - then.position_m, rays.direction * 1e9)
    at = projection.project(then, away @ then.world_from_camera)
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    across = at.x_px - x
    if kind == "panorama":
        across = (across + 24) % 48 - 24
    known = at.in_front & rays.valid & (solid | (kind != "orthographic"))
    assert (np.isnan(motion[..., 0]) == ~known).mean() > 0.999
    kept = known & ~np.isnan(motion[..., 0])
    assert kept.sum() > 100
    np.testing.assert_allclose(motion[kept], np.stack([across, at.y_px - y], axis=-1)[kept], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_still_camera_moves_nothing(kind):
    view = camera(kind)
    motion = motion_px(view, planes(view, [GROUND]), NOBODY, view, NOBODY)
    known = ~np.isnan(motion)
    assert known.any()
    np.testing.assert_allclose(motion[known], 0.0, atol=2e-5)


def test_keypoints_are_where_the_camera_sees_them_or_nowhere():
    points = np.array([[3.0, 12.0, 1.0], [-1.0, -8.0, 5.0]])  # ahead, and straight behind
    for kind in KINDS:
        at = project(camera(kind), points)
        np.testing.assert_allclose(at[0], [24, 18], atol=1e-9)
        if kind == "panorama":
            assert at[1, 0] % 48 == pytest.approx(0, abs=1e-6)
        else:
            assert np.isnan(at[1]).all()
