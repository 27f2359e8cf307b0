"""Occlusion boundaries on scenes whose outlines are known: planes and cylinders, by their equations."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.core.frames import look_at
from forestgen.labels.channels.boundaries import occlusion_boundaries
from forestgen.render.frame import Surface
from forestgen.scene.spec import Camera

WIDTH, HEIGHT = 64, 48


def camera(position=(0.0, -10.0, 0.0), target=(0.0, 0.0, 0.0), hfov_deg=50.0):
    return Camera("c", position, look_at(np.array(position), np.array(target)), (WIDTH, HEIGHT), hfov_deg)


def rays(view):
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    along = np.stack([x / view.focal_px, y / view.focal_px, np.ones_like(x)], axis=-1)
    return along @ view.world_from_camera.T  # of depth 1


def plane(view, point, normal, inside=lambda position: np.ones(position.shape[:2], bool)):
    """Depth (inf: missed), normal and a mask of a plane, cut to where `inside` holds."""
    ray, normal = rays(view), np.asarray(normal, float) / np.linalg.norm(normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (np.asarray(point, float) - view.position_m) @ normal / (ray @ normal)
        position = view.position_m + ray * depth[..., None]
        hit = (depth > 0) & inside(position)
    return np.where(hit, depth, np.inf), np.broadcast_to(normal, ray.shape)


def cylinder(view, radius_m, low_m, high_m):
    """An upright one about the z axis, its outer side."""
    ray, origin = rays(view), np.asarray(view.position_m)
    a, b = (ray[..., :2] ** 2).sum(-1), ray[..., :2] @ origin[:2]
    root = b**2 - a * (origin[:2] @ origin[:2] - radius_m**2)
    depth = np.where(root >= 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    position = origin + ray * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    normal = position * [1, 1, 0] / radius_m
    high = (position[..., 2] >= low_m) & (position[..., 2] <= high_m)
    return np.where(high & (depth > 0), depth, np.inf), normal


def boundaries(view, *things):
    """Of the nearest of all things, and which of them each pixel sees (-1: sky)."""
    depth = np.stack([one[0] for one in things])
    nearest = np.argmin(depth, axis=0)
    z = np.take_along_axis(depth, nearest[None], axis=0)[0]
    normal = np.take_along_axis(np.stack([one[1] for one in things]), nearest[None, ..., None], axis=0)[0]
    seen = np.isfinite(z)
    empty = np.zeros((HEIGHT, WIDTH))
    surface = Surface(
        plant_id=empty.astype(np.uint32), part=empty.astype(np.uint8), exemplar=empty.astype(np.uint32),
        face=empty.astype(np.uint32), depth_m=z.astype(np.float32), distance_m=z.astype(np.float32),
        position_m=np.zeros((HEIGHT, WIDTH, 3), np.float32),
        normal=np.where(seen[..., None], normal, 0).astype(np.float32),
        shading_normal=np.zeros((HEIGHT, WIDTH, 3), np.float32), albedo=np.zeros((HEIGHT, WIDTH, 3), np.float32),
        sun_visible=seen,
    )  # fmt: skip
    return occlusion_boundaries(surface, view), np.where(seen, nearest, -1)


def rim(mask):
    """Pixels of a mask with a neighbour outside it."""
    padded = np.pad(mask, 1, mode="edge")
    outside = ~padded
    return mask & (outside[:-2, 1:-1] | outside[2:, 1:-1] | outside[1:-1, :-2] | outside[1:-1, 2:])


def square(half_m):
    return lambda position: (np.abs(position[..., [0, 2]]) < half_m).all(-1)


@pytest.mark.parametrize("gap_m", [0.02, 1.0, 50.0])
def test_a_square_before_a_wall_is_bounded_by_its_rim(gap_m):
    view = camera()
    found, seen = boundaries(view, plane(view, (0, 0, 0), (0, 1, 0), square(2)), plane(view, (0, gap_m, 0), (0, 1, 0)))
    front = seen == 0
    assert 100 < front.sum() < front.size - 100
    np.testing.assert_array_equal(found, rim(front))


@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 80, 85])
@pytest.mark.parametrize("turn_deg", [0, 35, 90, 180])
def test_a_plane_has_none_however_grazing(tilt_deg, turn_deg):
    """The tilt is of the view at the image's middle; where the plane ends at the horizon it ends at the sky."""
    view, tilt, turn = camera(hfov_deg=6.0), np.radians(tilt_deg), np.radians(turn_deg)
    normal = (np.sin(tilt) * np.sin(turn), -np.cos(tilt), np.sin(tilt) * np.cos(turn))
    found, seen = boundaries(view, plane(view, (0, 0, 0), normal))
    assert (seen == 0).all()
    assert not found.any()


def test_ground_seen_by_a_walker_has_none_but_the_horizon():
    view = camera((0.0, -10.0, 1.7), (0.0, 10.0, 1.2))
    found, seen = boundaries(view, plane(view, (0, 0, 0), (0, 0, 1)))
    assert (seen == -1).any()
    np.testing.assert_array_equal(found, rim(seen == 0))


def test_a_trunk_hides_at_its_sides_and_not_where_it_stands():
    view = camera((0.0, -10.0, 1.7), (0.0, 0.0, 0.3))
    trunk = cylinder(view, 0.8, 0.0, 50.0)
    ground, wall = plane(view, (0, 0, 0), (0, 0, 1)), plane(view, (0, 9, 0), (0, 1, 0))
    found, seen = boundaries(view, trunk, ground, wall)
    is_trunk = seen == 0
    bottom = np.flatnonzero(is_trunk.any(axis=1))[-1]
    assert bottom < HEIGHT - 3
    sides = is_trunk & ~(np.roll(is_trunk, 1, axis=1) & np.roll(is_trunk, -1, axis=1))
    expected = sides.copy()
    foot = slice(bottom - 3, bottom + 1)  # the trunk's rounded foot stands on the ground: a contact at the sides too
    np.testing.assert_array_equal(found[: bottom - 3], expected[: bottom - 3])
    assert not (found[foot] & ~sides[foot]).any()
    assert not found[bottom + 1 :].any()
    assert not found[:, seen[0] == 2][~is_trunk[:, seen[0] == 2]].any()  # where ground and wall meet


def test_facets_that_no_centre_sees_make_none():
    """Ground in waves of narrow facets, none of which hides another: tangent planes alone would mark a row."""
    view = camera((0.0, -10.0, 2.0), (0.0, 10.0, -9.0), hfov_deg=30.0)
    edges = np.arange(-10.0, 3.0, 0.05)
    heights = 0.1 * np.sin(edges * 2)
    facets = []
    for low, high, z0, z1 in zip(edges[:-1], edges[1:], heights[:-1], heights[1:], strict=True):
        within = lambda position, low=low, high=high: (position[..., 1] >= low) & (position[..., 1] < high)  # noqa: E731
        facets.append(plane(view, (0, low, z0), (0, z0 - z1, high - low), within))
    found, seen = boundaries(view, *facets)
    assert len(np.unique(seen)) > 10
    assert not (found & ~rim(seen >= 0)).any()


@pytest.mark.parametrize("fold_deg", [20, 90, 160])
def test_folds_have_none_inwards_and_outwards(fold_deg):
    view, half = camera(hfov_deg=30.0), np.radians(fold_deg / 2)
    for sign in (1, -1):  # a roof's ridge towards the camera, a valley
        sides = []
        for side in (-1, 1):
            normal = (side * np.cos(half), -sign * np.sin(half), 0.0)
            sides.append(plane(view, (0, 0, 0), normal, lambda position, side=side: position[..., 0] * side >= 0))
        found, seen = boundaries(view, *sides)
        visible = seen >= 0
        assert {0, 1} <= set(seen.ravel().tolist())
        assert not (found & ~rim(visible)).any()


def test_the_farther_side_is_never_marked():
    view = camera()
    found, seen = boundaries(
        view, plane(view, (0, -3, 0), (0.4, 1, 0.2), square(1)), plane(view, (0, 4, 0), (0.3, 1, 0))
    )
    assert found[seen == 0].any()
    assert not found[seen == 1].any()


def test_a_face_without_normal_stands_across_the_view():
    view = camera()
    near, far = plane(view, (0, 0, 0), (0, 1, 0), square(2)), plane(view, (0, 5, 0), (0, 1, 0))
    found, seen = boundaries(view, (near[0], np.zeros_like(near[1])), far)
    np.testing.assert_array_equal(found, rim(seen == 0))
