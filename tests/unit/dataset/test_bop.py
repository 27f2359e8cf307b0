from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import SETTINGS, make_shot
from format_shots import all_bytes, awkward_masks, drawn, written
from PIL import Image

from forestgen.core.errors import OutputError
from forestgen.dataset.camera import camera_from_world
from forestgen.dataset.formats import bop
from forestgen.scene.projection import projection_of
from support.error_messages import raises_error

FRAMES = {
    "000003-b": make_shot(range(1, 9), seed=1).labelled,
    "000001-b": make_shot([*range(1, 12), 2**32 - 1, 2**32 - 2], seed=2).labelled,
    "000001-a": make_shot(range(1, 7), seed=3).labelled,
}
PLACES = {"000001-a": (0, 0), "000001-b": (0, 1), "000003-b": (1, 0)}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return written(bop, tmp_path_factory.mktemp("bop"), FRAMES)


def scene_of(root, number):
    scene = root / "bop" / "train_pbr" / f"{number:06d}"
    return scene, *(json.loads((scene / f"{name}.json").read_text()) for name in bop.SCENE_FILES)


def grey(path):
    with Image.open(path) as image:
        return image.mode, np.asarray(image)


def test_scenes_hold_the_cameras_of_a_drawn_recipe(dataset):
    for name, (scene, image) in PLACES.items():
        home, camera, gt, info = scene_of(dataset, scene)
        assert camera[str(image)]["frame"] == name
        assert set(camera) == set(gt) == set(info) == {str(i) for s, i in PLACES.values() if s == scene}
        assert (home / "rgb" / f"{image:06d}.png").read_bytes() == (dataset / name / "preview.png").read_bytes()


def test_masks_and_counts(dataset):
    for name, (scene, image) in PLACES.items():
        labelled = FRAMES[name]
        home, _, gt, info = scene_of(dataset, scene)
        _, depth = grey(home / "depth" / f"{image:06d}.png")
        instance = labelled.pixels.instance
        plants = [plant for plant in np.unique(instance).tolist() if plant]
        assert [one["plant_id"] for one in gt[str(image)]] == plants
        for number, (plant, one) in enumerate(zip(plants, info[str(image)], strict=True)):
            mode, whole = grey(home / "mask" / f"{image:06d}_{number:06d}.png")
            _, seen = grey(home / "mask_visib" / f"{image:06d}_{number:06d}.png")
            assert mode == "L"
            assert set(np.unique(whole).tolist()) <= {0, 255}
            np.testing.assert_array_equal(seen == 255, instance == plant)
            assert not ((seen > 0) & (whole == 0)).any()
            for mask, count, box in ((whole, "px_count_all", "bbox_obj"), (seen, "px_count_visib", "bbox_visib")):
                y, x = np.nonzero(mask)
                assert one[count] == len(x)
                assert one[box] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
            assert one["visib_fract"] == one["px_count_visib"] / one["px_count_all"]
            assert one["px_count_valid"] == ((whole > 0) & (depth > 0)).sum()


def test_camera_and_poses_project_the_stem_base(dataset):
    for name, (scene, image) in PLACES.items():
        labelled = FRAMES[name]
        _, camera, gt, _ = scene_of(dataset, scene)
        entry = camera[str(image)]
        k = np.array(entry["cam_K"]).reshape(3, 3)
        np.testing.assert_array_equal(k, projection_of(labelled.frame.camera).intrinsics(labelled.frame.camera))
        pose = camera_from_world(labelled.frame.camera)
        point = np.array([1.0, 2.0, 3.0])
        ours = pose[:3, :3] @ point + pose[:3, 3]
        theirs = np.array(entry["cam_R_w2c"]).reshape(3, 3) @ (point * 1000) + entry["cam_t_w2c"]
        np.testing.assert_allclose(theirs, ours * 1000, rtol=1e-12)
        for one in gt[str(image)]:
            row = np.searchsorted(labelled.population.plant_id, one["plant_id"])
            base = np.array(one["cam_t_m2c"])
            np.testing.assert_allclose(k @ base / base[2], [*labelled.views.keypoint_px[row, 0], 1.0], rtol=1e-9)
            rotation = np.array(one["cam_R_m2c"]).reshape(3, 3)
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
            assert one["obj_id"] == labelled.measures.exemplar[row] + 1


def test_linear_maps_of_plants_that_are_stretched_and_lean(tmp_path):
    rng = np.random.default_rng(4)
    labelled = FRAMES["000001-a"]
    n = len(labelled.population)
    transform = rng.normal(size=(n, 3, 4)) + np.eye(3, 4) * 3
    base = transform[:, :, 3].copy()
    measures = replace(labelled.measures, world_from_exemplar=transform, stem_base_m=base)
    root = written(bop, tmp_path, {"a": replace(labelled, measures=measures)})
    pose = camera_from_world(labelled.frame.camera)
    for one in scene_of(root, 0)[2]["0"]:
        row = np.searchsorted(labelled.population.plant_id, one["plant_id"])
        point = rng.normal(size=3)  # of the exemplar, metres
        ours = pose[:3] @ [*(transform[row] @ [*point, 1.0]), 1.0]
        matrix = np.array(one["cam_A_m2c"]).reshape(3, 3)
        np.testing.assert_allclose(matrix @ (point * 1000) + one["cam_t_m2c"], ours * 1000, rtol=1e-9)
        np.testing.assert_allclose(np.reshape(one["cam_R_m2c"], (3, 3)), bop.nearest_rotation(matrix), atol=1e-12)


def test_the_nearest_rotation():
    rng = np.random.default_rng(0)
    for _ in range(50):
        rotation = bop.nearest_rotation(rng.normal(size=(3, 3)))
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        stretch = np.diag(rng.uniform(0.5, 2.0, 3))
        np.testing.assert_allclose(bop.nearest_rotation(rotation @ stretch), rotation, atol=1e-12)


def test_depth_is_in_millimetres_by_its_scale(dataset):
    home, camera, _, _ = scene_of(dataset, 0)
    mode, steps = grey(home / "depth" / "000000.png")
    depth = FRAMES["000001-a"].frame.surface.depth_m
    assert mode == "I;16"
    assert (steps[~np.isfinite(depth)] == 0).all()
    known = np.isfinite(depth)
    scale = camera["0"]["depth_scale"]
    assert np.abs(steps[known] * scale - depth[known] * 1000).max() <= scale * 0.501


def test_what_lies_beyond_the_depth_picture_has_no_depth(tmp_path):
    labelled = drawn(np.full((4, 4), 3))
    root = written(bop, tmp_path, {"a": labelled}, replace(SETTINGS, depth_unit_m=1e-6))
    home, _, _, info = scene_of(root, 0)
    assert (grey(home / "depth" / "000000.png")[1] == 0).all()
    assert info["0"][0]["px_count_valid"] == 0


def test_awkward_masks(tmp_path):
    masks = awkward_masks()
    root = written(bop, tmp_path, {f"é' {i:02d}-a": drawn(mask, unseen=[77]) for i, mask in enumerate(masks)})
    for number, instance in enumerate(masks):
        home, _, gt, info = scene_of(root, number)
        assert [one["plant_id"] for one in gt["0"]] == [plant for plant in np.unique(instance).tolist() if plant]
        assert len(info["0"]) == len(gt["0"]) == len(list((home / "mask").iterdir()))
        for i, one in enumerate(gt["0"]):
            seen = grey(home / "mask_visib" / f"000000_{i:06d}.png")[1]
            np.testing.assert_array_equal(seen > 0, instance == one["plant_id"])


def test_equal_input_equal_bytes(tmp_path, dataset):
    first = all_bytes(dataset)
    bop.FORMAT.merge(dataset, list(FRAMES), SETTINGS)
    assert all_bytes(dataset) == first
    assert all_bytes(written(bop, tmp_path, dict(reversed(FRAMES.items())))) == first


def test_missing_and_damaged_shards(tmp_path):
    written(bop, tmp_path, {"a": drawn([[1]]), "b": drawn([[1]])})
    (tmp_path / "b" / "bop" / "mask" / "000000.png").unlink()
    with raises_error(OutputError, place="000000.png"):
        bop.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    (tmp_path / "b" / "bop" / "shard.json").write_text('{"scene_gt": 3}')
    with raises_error(OutputError, place="shard.json"):
        bop.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
