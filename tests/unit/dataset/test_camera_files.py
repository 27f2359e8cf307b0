from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import HEIGHT, SETTINGS, WIDTH, make_camera

from forestgen.core.errors import OutputError
from forestgen.dataset.camera import camera_model, exr_attributes, world_to_ndc
from forestgen.dataset.check.frame_data import camera_of as camera_of_file
from forestgen.dataset.files import write_json
from forestgen.dataset.formats import nerfstudio
from forestgen.labels.channels.surface import camera_position_m
from forestgen.scene.projection import project, projection_of, world_rays
from support.cameras import KINDS, camera_of
from support.error_messages import raises_error


def pixel_surface(camera, rng):
    """World points that the pixels' centres see, (H, W, 3), by the camera's own axes; and the centres, (H, W, 2)."""
    width, height = camera.size_px
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    right, down, forward = np.asarray(camera.world_from_camera).T
    half = np.tan(np.radians(camera.hfov_deg) / 2)  # of the view's width at distance 1
    u, v = (x - width / 2) * 2 * half / width, (y - height / 2) * 2 * half / width
    ray = forward + u[..., None] * right + v[..., None] * down
    depth = rng.uniform(1, 60, (height, width, 1))
    return np.asarray(camera.position_m) + depth * ray, depth[..., 0], np.stack([x, y], axis=-1)


def frames_on_disk(root, cameras, image=0):
    folders = []
    for camera in cameras:
        folder = root / f"{image:06d}-{camera.name}"
        folder.mkdir(parents=True)
        write_json(folder / "camera.json", camera_model(camera))
        folders.append(folder)
    return folders


def test_camera_json_projects_surfaces_to_pixel_centres(tmp_path):
    camera = replace(make_camera(), sequence="walk", time_s=0.25)
    points, depth, centres = pixel_surface(camera, np.random.default_rng(1))
    write_json(tmp_path / "camera.json", camera_model(camera))
    read = json.loads((tmp_path / "camera.json").read_text())
    pose, k = np.array(read["camera_from_world"]), np.array(read["K"])
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(seen[..., 2], depth, rtol=1e-9)
    pixel = seen @ k.T
    np.testing.assert_allclose(pixel[..., :2] / pixel[..., 2:], centres, atol=1e-8)
    np.testing.assert_allclose(np.array(read["world_from_camera"]) @ pose, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(np.array(read["world_from_camera"])[:3, 3], read["position_m"])
    assert read["size_px"] == [WIDTH, HEIGHT]
    assert read["distortion"] == [0.0] * 5
    assert (read["sequence"], read["time_s"]) == ("walk", 0.25)
    np.testing.assert_allclose(camera_position_m(depth.astype(np.float32), camera), seen, rtol=1e-5, atol=1e-5)


def test_a_still_camera_has_no_sequence(tmp_path):
    write_json(tmp_path / "camera.json", camera_model(make_camera()))
    assert json.loads((tmp_path / "camera.json").read_text())["sequence"] is None


def test_transforms_project_surfaces_to_pixel_centres(tmp_path):
    """By nerfstudio's own convention: the camera looks along -z, y is up, a pixel's centre lies at +0.5."""
    turned = replace(make_camera("b", (33, 47)), position_m=(-7.0, 2.5, 1.5), sequence="walk", time_s=0.5)
    cameras = [make_camera("a"), turned]
    settings = replace(SETTINGS, formats=("nerfstudio", "depth_png"), depth_unit_m=0.02)
    folders = frames_on_disk(tmp_path, cameras)
    nerfstudio.FORMAT.merge(tmp_path, folders[::-1], settings)
    read = json.loads((tmp_path / "transforms.json").read_text())
    assert read["camera_model"] == "OPENCV"
    assert read["depth_unit_scale_factor"] == 0.02
    assert [frame["file_path"] for frame in read["frames"]] == ["000000-a/preview.png", "000000-b/preview.png"]
    assert [frame["depth_file_path"] for frame in read["frames"]] == ["000000-a/depth.png", "000000-b/depth.png"]
    assert [frame.get("time") for frame in read["frames"]] == [None, 0.5]
    for camera, frame in zip(cameras, read["frames"], strict=True):
        points, depth, centres = pixel_surface(camera, np.random.default_rng(2))
        world_from_camera = np.array(frame["transform_matrix"])
        assert np.linalg.det(world_from_camera[:3, :3]) == pytest.approx(1)
        seen = (points - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        np.testing.assert_allclose(-seen[..., 2], depth, rtol=1e-9)
        x = frame["fl_x"] * seen[..., 0] / -seen[..., 2] + frame["cx"]
        y = frame["fl_y"] * -seen[..., 1] / -seen[..., 2] + frame["cy"]
        np.testing.assert_allclose(np.stack([x, y], axis=-1), centres, atol=1e-8)
        assert (frame["w"], frame["h"]) == camera.size_px
        assert [frame[name] for name in ("k1", "k2", "p1", "p2")] == [0.0] * 4


def test_each_image_is_a_scene_of_its_own(tmp_path):
    folders = [
        *frames_on_disk(tmp_path, [make_camera("a"), make_camera("b")], 3),
        *frames_on_disk(tmp_path, [make_camera("a")], 12),
    ]
    nerfstudio.FORMAT.merge(tmp_path, folders, SETTINGS)
    names = {path.name for path in tmp_path.glob("*.json")}
    assert names == {"transforms-000003.json", "transforms-000012.json"}
    read = json.loads((tmp_path / "transforms-000003.json").read_text())
    assert len(read["frames"]) == 2
    assert "depth_unit_scale_factor" not in read
    assert not any("depth_file_path" in frame for frame in read["frames"])
    first = (tmp_path / "transforms-000003.json").read_bytes()
    nerfstudio.FORMAT.merge(tmp_path, folders[::-1], SETTINGS)
    assert (tmp_path / "transforms-000003.json").read_bytes() == first


def test_a_missing_or_damaged_camera_is_an_output_error(tmp_path):
    folders = frames_on_disk(tmp_path, [make_camera("a"), make_camera("b")])
    (folders[1] / "camera.json").write_text('{"K": 3}')
    with raises_error(OutputError, place="camera.json"):
        nerfstudio.FORMAT.merge(tmp_path, folders, SETTINGS)
    shutil.rmtree(folders[0])
    with raises_error(OutputError, place="camera.json"):
        nerfstudio.FORMAT.merge(tmp_path, folders, SETTINGS)


def test_a_missing_folder_is_an_output_error(tmp_path):
    with raises_error(OutputError, place="camera.json"):
        write_json(tmp_path / "missing" / "camera.json", camera_model(make_camera()))


@pytest.mark.parametrize("kind", KINDS)
def test_the_checker_reads_every_model_as_it_is_written(kind, tmp_path):
    """Its formulas are its own: rays, starts, projections, circle."""
    camera = camera_of(kind, (40, 30), (3.0, 4.0, 5.0), (8.0, 20.0, 3.0))
    write_json(tmp_path / "camera.json", camera_model(camera))
    read = camera_of_file(json.loads((tmp_path / "camera.json").read_text()), "camera.json")
    seen = world_rays(camera)
    start = np.broadcast_to(seen.origin_m, seen.direction.shape) - np.asarray(camera.position_m)
    np.testing.assert_allclose(read.starts((40, 30)), start, atol=1e-9)
    rays = read.pixel_rays((40, 30))
    np.testing.assert_allclose(rays / np.linalg.norm(rays, axis=-1, keepdims=True), seen.direction, atol=1e-12)
    np.testing.assert_array_equal(read.geometry.sees((40, 30)), seen.valid)
    rng = np.random.default_rng(1)
    point = rng.normal(size=(5000, 3)) * 10
    at, (pixel, depth) = project(camera, point), read.geometry.project(point)
    np.testing.assert_array_equal(depth > 0, at.in_front)
    kept = at.in_front
    np.testing.assert_allclose(pixel[kept], np.stack([at.x_px, at.y_px], axis=-1)[kept], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(depth[kept], at.depth_m[kept], rtol=1e-12)
    surface = rng.uniform(1, 60, (30, 40)).astype(np.float32)
    own = (rays * surface[..., None] + read.starts((40, 30))) @ camera.world_from_camera
    np.testing.assert_allclose(camera_position_m(surface, camera), own, rtol=1e-5, atol=1e-5)


def test_an_orthographic_cameras_matrix_maps_the_world_to_the_image():
    camera = camera_of("orthographic", (40, 30), (3.0, 4.0, 5.0), (8.0, 20.0, 3.0))
    point = np.asarray(camera.position_m) + np.random.default_rng(1).normal(size=(50, 3)) * 10
    found = np.column_stack([point, np.ones(50)]) @ world_to_ndc(camera).astype(float)
    at = project(camera, (point - camera.position_m) @ camera.world_from_camera)
    np.testing.assert_allclose(found[:, :2] * [40, 30], np.stack([at.x_px, at.y_px], axis=1), atol=1e-3)
    np.testing.assert_allclose(found[:, 3], 1.0, atol=1e-6)
    assert exr_attributes(camera)["screenWindowWidth"] == 20.0
    assert "worldToNDC" not in exr_attributes(camera_of("fisheye", (40, 30), (0.0, 0.0, 0.0)))
    assert projection_of(camera).intrinsics(camera) is None


def opengl_ray(transforms, frame, x_px, y_px):
    """World direction of a pixel as nerfstudio makes it: x right, y up, z backward."""
    u, v = (x_px - frame["cx"]) / frame["fl_x"], -(y_px - frame["cy"]) / frame["fl_y"]
    if transforms["camera_model"] == "EQUIRECTANGULAR":
        theta, phi = -np.pi * u, np.pi * (0.5 - v)
        own = np.array([-np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)])
    elif transforms["camera_model"] == "OPENCV_FISHEYE":
        theta = np.hypot(u, v)
        own = np.array([u * np.sin(theta) / theta, v * np.sin(theta) / theta, -np.cos(theta)])
    else:
        own = np.array([u, v, -1.0]) / np.sqrt(u * u + v * v + 1)
    return np.array(frame["transform_matrix"])[:3, :3] @ own


def test_nerfstudio_has_a_file_for_each_model_and_its_rays_are_ours(tmp_path):
    kinds = ("perspective", "fisheye", "panorama")
    place = (3.0, 4.0, 5.0)
    cameras = [replace(camera_of(kind, (40, 30), place, (8.0, 20.0, 3.0)), name=kind) for kind in kinds]
    folders = frames_on_disk(tmp_path, cameras)
    nerfstudio.FORMAT.merge(tmp_path, folders, SETTINGS)
    names = {"perspective": "-pinhole", "fisheye": "", "panorama": "-equirectangular"}
    for camera in cameras:  # by their folders' names, the fisheye is the first
        content = json.loads((tmp_path / f"transforms{names[camera.name]}.json").read_text())
        (frame,) = content["frames"]
        rays = world_rays(camera)
        for row, column in ((3, 12), (20, 30), (14, 19)):
            got = opengl_ray(content, frame, column + 0.5, row + 0.5)
            np.testing.assert_allclose(got, rays.direction[row, column], atol=1e-9)
    parallel = frames_on_disk(tmp_path / "o", [camera_of("orthographic", (40, 30), place)])
    with raises_error(OutputError, place="camera.json"):
        nerfstudio.FORMAT.merge(tmp_path / "o", parallel, SETTINGS)
