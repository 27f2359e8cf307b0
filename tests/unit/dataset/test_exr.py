from __future__ import annotations

import json

import numpy as np
import pytest
from dataset_shots import HEIGHT, WIDTH, make_camera, make_shot

from forestgen.core.errors import OutputError
from forestgen.dataset import exr
from forestgen.dataset.camera import camera_from_world, intrinsics, screen_window_width, world_to_camera, world_to_ndc
from forestgen.dataset.exr import read_exr, read_exr_attributes, write_exr
from forestgen.labels.pixels import pixel_labels

POINTS = (
    np.random.default_rng(0).uniform(-5, 5, (50, 3)) + np.array([3.0, -4.0, 12.0]) + 40 * np.array([0.6, 0.7, -0.2])
)


def labels_of(shot):
    identity, population = shot.frame.identity, shot.population
    return pixel_labels(identity.plant_id, identity.part, population.plant_id, population.species)


def written(path, shot, **attributes):
    write_exr(path, shot.frame, labels_of(shot), attributes)
    return path


def test_every_value_survives(tmp_path, wide_shot):
    parts = read_exr(written(tmp_path / "a.exr", wide_shot))
    labels, frame = labels_of(wide_shot), wide_shot.frame
    assert list(parts) == [
        "radiance", "radiance.denoised", "radiance.variance", "depth", "normal", "position", "identity", "coverage",
    ]  # fmt: skip
    for name, channels, values in [
        ("radiance", "RGB", frame.radiance.mean),
        ("radiance.denoised", "RGB", frame.radiance.denoised),
        ("radiance.variance", "RGB", frame.radiance.variance),
        ("depth", "Z", frame.identity.depth_m[..., None]),
        ("normal", "XYZ", frame.identity.normal),
        ("position", "XYZ", frame.identity.position_m),
    ]:
        assert set(parts[name]) == set(channels)
        for i, channel in enumerate(channels):
            assert parts[name][channel].dtype == np.float32
            np.testing.assert_array_equal(parts[name][channel], values[..., i])
    for name in ("plant_id", "part", "semantic"):
        assert parts["identity"][name].dtype == np.uint32
    np.testing.assert_array_equal(parts["identity"]["plant_id"], labels.instance)
    np.testing.assert_array_equal(parts["identity"]["part"], labels.part)
    np.testing.assert_array_equal(parts["identity"]["semantic"], labels.semantic)
    assert labels.instance.max() > 2**31
    for rank in range(4):
        np.testing.assert_array_equal(parts["coverage"][f"rank{rank}.id"], labels.ranks.plant_id[..., rank])
        np.testing.assert_array_equal(parts["coverage"][f"rank{rank}.coverage"], labels.ranks.coverage[..., rank])


def test_without_denoising(tmp_path):
    assert "radiance.denoised" not in read_exr(written(tmp_path / "a.exr", make_shot([1, 2], denoised=False)))


def test_attributes(tmp_path, shot):
    header = read_exr_attributes(written(tmp_path / "a.exr", shot, recipe_hash="abc", seed="7"))
    camera = shot.frame.camera
    assert header["forestgen/recipe_hash"] == "abc"
    assert header["forestgen/seed"] == "7"
    model = json.loads(header["forestgen/camera"])
    np.testing.assert_array_equal(model["K"], intrinsics(camera))
    np.testing.assert_array_equal(model["camera_from_world"], camera_from_world(camera))
    np.testing.assert_array_equal(header["worldToCamera"], world_to_camera(camera))
    np.testing.assert_array_equal(header["worldToNDC"], world_to_ndc(camera))
    assert header["chromaticities"] == pytest.approx(exr.REC709_CHROMATICITIES)
    assert header["pixelAspectRatio"] == 1.0
    assert header["screenWindowWidth"] == pytest.approx(2 * np.tan(np.radians(27.5)))
    assert header["screenWindowCenter"].tolist() == [0, 0]
    assert not {"capDate", "owner", "comments"} & set(header)


def test_equal_input_gives_equal_bytes_whatever_the_threads(tmp_path, shot):
    import OpenEXR

    before = OpenEXR.global_thread_count()
    contents = []
    try:
        for i, threads in enumerate((before, 0, 1, 4)):
            OpenEXR.set_global_thread_count(threads)
            contents.append(written(tmp_path / f"{i}.exr", shot, b="2", a="1").read_bytes())
    finally:
        OpenEXR.set_global_thread_count(before)
    assert len(set(contents)) == 1


def test_a_failure_is_an_output_error(tmp_path, shot):
    with pytest.raises(OutputError, match="missing"):
        written(tmp_path / "missing" / "a.exr", shot)


def test_openexr_matrices_agree_with_the_opencv_camera():
    camera = make_camera()
    homogeneous = np.column_stack([POINTS, np.ones(len(POINTS))])
    in_camera = (camera_from_world(camera) @ homogeneous.T).T[:, :3]
    assert in_camera[:, 2].min() > 0
    pixel = in_camera @ intrinsics(camera).T
    pixel = pixel[:, :2] / pixel[:, 2:]

    renderman = homogeneous @ world_to_camera(camera).astype(float)  # row vectors; y up, z forward
    np.testing.assert_allclose(renderman[:, :3], in_camera * [1, -1, 1], atol=1e-4)
    assert np.linalg.det(world_to_camera(camera)[:3, :3]) == pytest.approx(-1, abs=1e-5)

    ndc = homogeneous @ world_to_ndc(camera).astype(float)
    np.testing.assert_allclose(ndc[:, :2] / ndc[:, 3:] * [WIDTH, HEIGHT], pixel, atol=1e-3)

    # The screen window, at distance 1: x = ±width/2 at the image's left and right borders.
    x = renderman[:, 0] / renderman[:, 2] / screen_window_width(camera)
    np.testing.assert_allclose((x + 0.5) * WIDTH, pixel[:, 0], atol=1e-3)


def test_the_camera_axis_meets_the_image_centre():
    camera = make_camera()
    ahead = np.asarray(camera.position_m) + 10 * camera.world_from_camera[:, 2]
    row = np.array([*ahead, 1.0]) @ world_to_ndc(camera).astype(float)
    np.testing.assert_allclose(row[:2] / row[3], [0.5, 0.5], atol=1e-5)
    row = np.array([*(ahead + np.array([0.0, 0.0, 1.0])), 1.0]) @ world_to_ndc(camera).astype(float)
    assert row[1] / row[3] < 0.5  # up in the world is up in the picture: a smaller y
