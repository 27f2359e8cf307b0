"""Windows hold everything that can be seen of a plant; full boxes are those of all its vertices."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.geometry.hull import Hull, hull_of
from forestgen.render.windows import BEYOND, NEAR_M, outlines
from forestgen.scene.spec import Camera
from forestgen.testing.scenes import camera_at, random_transforms, simple_tree

SIZE_PX = (64, 36)
CAMERA = camera_at((10.0, -9.0, 3.0), (12.0, 10.0, 4.0), SIZE_PX)


@pytest.fixture(scope="module")
def tree():
    exemplar = simple_tree("kind0", 6.0, 400, np.random.default_rng(2))
    meshes = [organ.mesh for organ in exemplar.organs]
    return hull_of(meshes), np.concatenate([mesh.vertices_m.astype(np.float64) for mesh in meshes])


def projected(points: np.ndarray, transform: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions of all points of one instance, and their depths, term by term."""
    world = points @ transform[:, :3].T + transform[:, 3]
    right, down, forward = camera.world_from_camera.T
    there = world - camera.position_m
    z = there @ forward
    focal = SIZE_PX[0] / 2 / np.tan(np.radians(camera.hfov_deg / 2))
    with np.errstate(divide="ignore"):
        return np.stack([there @ right, there @ down], axis=1) / z[:, None] * focal + np.array(SIZE_PX) / 2, z


def test_full_boxes_are_those_of_all_vertices(tree):
    hull, points = tree
    transform = random_transforms(200, 20.0, np.random.default_rng(3))
    found = outlines(hull, transform, CAMERA)
    for row in range(200):
        at, depth = projected(points, transform[row], CAMERA)
        assert (depth > NEAR_M).all()
        expected = np.concatenate([at.min(axis=0), at.max(axis=0)])
        np.testing.assert_allclose(found.full_box_px[row], expected, atol=1e-9)


def test_windows_hold_all_vertices_that_the_image_shows(tree):
    """Plants everywhere: in front of the camera, beside it, around it and behind it."""
    hull, points = tree
    rng = np.random.default_rng(4)
    transform = random_transforms(600, 20.0, rng)
    transform[:, :2, 3] = rng.normal(scale=4, size=(600, 2)) + CAMERA.position_m[:2]
    found = outlines(hull, transform, CAMERA)
    behind, shown = 0, 0
    for row in range(600):
        at, depth = projected(points, transform[row], CAMERA)
        visible = at[(depth > 0) & (at >= 0).all(axis=1) & (at < SIZE_PX).all(axis=1)]
        x, y, width, height = found.window_px[row]
        pixel = np.floor(visible) - [x, y]
        assert ((pixel >= 0) & (pixel < [width, height])).all()
        front = np.clip(at[depth > NEAR_M], -BEYOND * np.array(SIZE_PX), BEYOND * np.array(SIZE_PX))
        if len(front):
            left, top, right, bottom = found.full_box_px[row]
            assert (front >= np.array([left, top]) - 1e-6).all()
            assert (front <= np.array([right, bottom]) + 1e-6).all()
        behind += (depth < 0).any() and (depth > 0).any()
        shown += len(visible) > 0
    assert behind > 50
    assert shown > 100
    assert np.isfinite(found.full_box_px).any()
    assert np.nanmax(np.abs(found.full_box_px[:, ::2])) <= BEYOND * SIZE_PX[0]


def test_a_plant_around_the_camera_may_be_anywhere_and_one_behind_it_is_nowhere():
    cube = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    edges = np.array([(a, b) for a in range(8) for b in range(a)])
    transform = np.zeros((2, 3, 4))
    transform[:, :, :3] = np.eye(3)
    transform[0, :, 3] = CAMERA.position_m
    transform[1, :, 3] = CAMERA.position_m - 5 * CAMERA.world_from_camera[:, 2]
    found = outlines(Hull(cube, edges), transform, CAMERA)
    assert found.window_px.tolist() == [[0, 0, *SIZE_PX], [0, 0, 0, 0]]
    assert np.isnan(found.full_box_px[1]).all()
    limit = BEYOND * np.array(SIZE_PX)
    np.testing.assert_array_equal(found.full_box_px[0], [*-limit, *limit])


def test_an_exemplar_without_triangles_is_nowhere():
    found = outlines(hull_of([]), random_transforms(3, 20.0, np.random.default_rng(1)), CAMERA)
    assert not found.window_px.any()
    assert np.isnan(found.full_box_px).all()
