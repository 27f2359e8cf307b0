"""Windows hold everything that can be seen of a plant; full boxes are those of all its vertices."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.geometry.mesh import Hull, hull_of
from forestgen.render.amodal import BEYOND, outlines
from forestgen.scene.projection import project
from forestgen.scene.spec import Camera
from support.cameras import camera_of
from support.scenes import camera_at, random_transforms, simple_tree
from support.tiers import few

SIZE_PX = (64, 36)
NEAR_M = 1e-3
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


def seen_from(points: np.ndarray, transform: np.ndarray, camera: Camera) -> np.ndarray:
    """Points of one instance along the camera's axes."""
    world = points @ transform[:, :3].T + transform[:, 3]
    return (world - np.asarray(camera.position_m)) @ camera.world_from_camera


def blocks(count: int, around_m: tuple[float, float, float], rng: np.random.Generator) -> tuple[Hull, np.ndarray]:
    """Blocks of all sizes and turns, some over the camera, some around it."""
    cube = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    edges = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(cube[a] - cube[b]).sum() == 1])
    transform = np.zeros((count, 3, 4))
    transform[:, :, :3] = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] * 2 ** rng.uniform(-2, 3, (count, 1, 3))
    transform[:, :, 3] = np.asarray(around_m) + rng.normal(size=(count, 3)) * 2 ** rng.uniform(0, 4, (count, 1))
    return Hull(cube, edges), transform


@pytest.mark.parametrize("kind", few(["fisheye", "thin lens", "whole fisheye", "panorama", "orthographic"], 2))
def test_boxes_of_all_kinds_hold_every_point_of_the_hull_and_touch_it(kind):
    rng = np.random.default_rng(11)
    about = {"hfov_deg": 360.0} if kind == "whole fisheye" else {}
    place, size_px = (10.0, -9.0, 3.0), np.array([96, 64])
    camera = camera_of(kind.removeprefix("whole "), (96, 64), place, (12.0, 10.0, 4.0), **about)
    hull, transform = blocks(400, place, rng)
    found = outlines(hull, transform, camera)
    share = np.linspace(0, 1, 2001)[:, None]
    weight = rng.dirichlet(np.full(8, 0.3), 4000)
    loose, wide, missed = [], 0, 0
    for row in range(400):
        corner = seen_from(hull.vertices_m, transform[row], camera)
        on_edges = np.concatenate([corner[a] + share * (corner[b] - corner[a]) for a, b in hull.edges])
        inner = weight @ corner
        if kind == "thin lens":
            if corner[:, 2].min() < 0.5:
                continue
            lens = camera.lens
            angle = rng.random(len(inner)) * 2 * np.pi
            disc = lens.aperture_radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            x, y = ((inner[:, k] - disc[:, k]) / inner[:, 2] + disc[:, k] / lens.focus_m for k in range(2))
            at = np.clip(np.stack([x, y], axis=1) * camera.focal_px + size_px / 2, -BEYOND * size_px, BEYOND * size_px)
            seen, edge_at = np.ones(len(x), dtype=bool), at
        else:
            (at, seen), (edge_at, edge_seen) = (pixels_of(camera, points) for points in (inner, on_edges))
            edge_at = edge_at[edge_seen | (camera.projection == "fisheye")]
        if not seen.any():
            missed += 1
            continue
        left, top, right, bottom = np.nan_to_num(found.full_box_px[row], nan=1e9)
        x, y, width, height = found.window_px[row]
        shown = at[seen & (at >= 0).all(axis=1) & (at < size_px).all(axis=1)]
        pixel = np.floor(shown) - [x, y]
        assert ((pixel >= 0) & (pixel < [width, height])).all()
        assert (at[seen] >= np.array([left, top]) - 1e-6).all()
        assert (at[seen] <= np.array([right, bottom]) + 1e-6).all()
        if right - left > 96 - 1e-9 or kind == "thin lens" or len(edge_at) == 0:
            wide += 1
            continue
        own = np.array([*edge_at.min(axis=0), *edge_at.max(axis=0)])
        loose.append(np.abs(own - [left, top, right, bottom]).max())
    if kind != "thin lens":
        assert len(loose) > 60
        assert np.quantile(loose, 0.95) < 0.01
        assert max(loose) < 10, "hulls at the tears, where a pixel is next to nothing"
    assert missed < 300


def pixels_of(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = project(camera, points)
    return np.stack([found.x_px, found.y_px], axis=-1), found.in_front


def test_panorama_boxes_are_as_wide_as_the_image_at_the_seam_and_over_the_poles():
    place = (0.0, 0.0, 2.0)
    camera = camera_of("panorama", (360, 180), place)
    hull, _ = blocks(1, place, np.random.default_rng(1))
    transform = np.tile(np.eye(4)[:3], (5, 1, 1))
    transform[:, :, 3] = np.add(place, [[0, 9, 0], [0, -9, 0], [0.6, -9, 0], [0.2, 0.1, 9], [0.2, 0.1, -9]])
    box = outlines(hull, transform, camera).full_box_px
    half = np.degrees(np.arctan(0.5 / 8.5))
    np.testing.assert_allclose(box[0], [180 - half, 90 - half, 180 + half, 90 + half], atol=0.02)
    assert box[1, [0, 2]].tolist() == [0, 360]
    assert box[2, 0] > 0
    assert box[2, 2] < 360
    assert box[3, [0, 1, 2]].tolist() == [0, 0, 360]
    assert box[3, 3] < 10
    assert box[4, [0, 2, 3]].tolist() == [0, 360, 180]


def test_a_camera_inside_of_a_hull_sees_it_in_all_directions():
    place = (0.0, 0.0, 2.0)
    hull, _ = blocks(1, place, np.random.default_rng(1))
    transform = np.eye(4)[None, :3].copy()
    transform[:, :, 3] = np.add(place, 0.49)  # near a corner
    for camera, box in (
        (camera_of("panorama", (64, 32), place), [0, 0, 64, 32]),
        (camera_of("fisheye", (64, 64), place), [-32, -32, 96, 96]),
    ):
        found = outlines(hull, transform, camera)
        assert found.window_px.tolist() == [[0, 0, *camera.size_px]]
        np.testing.assert_allclose(found.full_box_px[0], box, atol=1e-9)
