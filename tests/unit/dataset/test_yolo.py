from __future__ import annotations

import numpy as np
import pytest
from dataset_shots import SETTINGS, make_shot
from format_shots import all_bytes, awkward_masks, drawn, written
from rasterisers import opencv_fill
from ruamel.yaml import YAML
from scipy.ndimage import label

from forestgen.core.errors import OutputError
from forestgen.dataset.formats import yolo
from forestgen.dataset.formats.contours import polygons
from support.error_messages import raises_error

FRAMES = {
    "000001-camera0": make_shot(range(1, 9), seed=1).labelled,
    "000000-camera0": make_shot(range(1, 12), seed=2).labelled,
    "000002-camera0": drawn(np.zeros((40, 60))),
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return written(yolo, tmp_path_factory.mktemp("yolo"), FRAMES)


def lines(root, task, name):
    text = (root / "yolo" / task / "labels" / f"{name}.txt").read_text()
    return [line.split() for line in text.splitlines()]


def ring(line, shape, convert):
    """Pixels of the corners, as a reader makes them whole, in single precision."""
    shares = np.array(line[1:], np.float32).reshape(-1, 2)
    assert (shares > 0).all()
    assert (shares < 1).all()
    return convert(shares * np.array([shape[1], shape[0]], np.float32)).astype(int)


@pytest.mark.parametrize("convert", [np.rint, np.trunc, np.floor])
def test_outlines_are_the_masks_polygons(dataset, convert):
    for name, labelled in FRAMES.items():
        instance = labelled.pixels.instance
        found = lines(dataset, "segmentation", name)
        for (plant, corners), line in zip(polygons(instance).items(), found, strict=True):
            row = np.searchsorted(labelled.population.plant_id, plant)
            assert int(line[0]) == labelled.species[row]
            read = ring(line, instance.shape, convert)
            np.testing.assert_array_equal(read[: len(corners)], corners)
            assert (read[len(corners) :] == corners[-1]).all()


def test_outlines_of_one_piece_fill_to_the_masks(dataset):
    checked = 0
    for name, labelled in FRAMES.items():
        instance = labelled.pixels.instance
        plants = [plant for plant in np.unique(instance) if plant]
        for plant, line in zip(plants, lines(dataset, "segmentation", name), strict=True):
            mask = instance == plant
            if label(mask, np.ones((3, 3)))[1] == 1:
                np.testing.assert_array_equal(opencv_fill(ring(line, mask.shape, np.trunc), mask.shape), mask)
                checked += 1
    assert checked > 2


@pytest.mark.parametrize("number", range(len(awkward_masks())))
def test_awkward_masks(tmp_path, number):
    instance = awkward_masks()[number]
    root = written(yolo, tmp_path, {"é 'x\" y": drawn(instance)})
    found = lines(root, "segmentation", "é 'x\" y")
    assert len(found) == len(np.unique(instance[instance > 0]))
    assert all(len(line) >= 7 and len(line) % 2 for line in found)  # a class and three corners or more


@pytest.mark.parametrize("length", [1, 3, 49, 640, 999, 4096, 65_500])
def test_shares_give_the_pixel_however_they_are_rounded(length):
    shares = yolo._shares(length)
    for kind in (np.float32, np.float64):
        found = np.array(shares, kind) * kind(length)
        for whole in (np.trunc, np.rint):
            np.testing.assert_array_equal(whole(found), np.arange(length))
        assert np.abs(found - np.arange(length) - 0.4).max() < 0.02
    assert 0 < min(map(float, shares)) <= max(map(float, shares)) < 1


def test_boxes(dataset):
    for name, labelled in FRAMES.items():
        views = labelled.views.visible
        rows = np.flatnonzero(views.has_box)
        found = lines(dataset, "boxes", name)
        assert [int(line[0]) for line in found] == labelled.species[rows].tolist()
        height, width = labelled.pixels.instance.shape
        for row, line in zip(rows, found, strict=True):
            cx, cy, w, h = np.array(line[1:], float) * [width, height, width, height]
            np.testing.assert_allclose([cx - w / 2, cy - h / 2, w, h], views.box_px[row], atol=1e-6)


def test_layout_and_names(dataset):
    for task in yolo.TASKS:
        home = dataset / "yolo" / task
        data = YAML(typ="safe").load(home / "data.yaml")
        assert data == {"train": "images", "val": "images", "names": {0: "poplar", 1: "spruce", 2: "oak"}}
        images = sorted(path.stem for path in (home / data["train"]).iterdir())
        assert images == sorted(FRAMES) == sorted(path.stem for path in (home / "labels").iterdir())
        assert lines(dataset, task, "000002-camera0") == []  # no plant: an empty file, not a missing one


def test_names_that_yaml_would_take_for_something_else(tmp_path):
    from dataclasses import replace

    names = ("no", "1e3", "007", "a-b_c")
    yolo.FORMAT.merge(tmp_path, [], replace(SETTINGS, category_names=names))
    data = YAML(typ="safe").load(tmp_path / "yolo" / "boxes" / "data.yaml")
    assert data["names"] == dict(enumerate(names))


def test_equal_input_equal_bytes(tmp_path, dataset):
    first = all_bytes(dataset)
    yolo.FORMAT.merge(dataset, list(reversed(FRAMES)), SETTINGS)
    assert all_bytes(dataset) == first
    assert all_bytes(written(yolo, tmp_path, dict(reversed(FRAMES.items())))) == first


def test_missing_and_damaged_shards(tmp_path):
    written(yolo, tmp_path, {"a": drawn([[1]]), "b": drawn([[1]])})
    shard = tmp_path / "b" / "yolo_boxes.txt"
    shard.write_bytes(shard.read_bytes()[:-3])
    with raises_error(OutputError, place="yolo_boxes.txt"):
        yolo.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    shard.unlink()
    with raises_error(OutputError, place="yolo_boxes.txt"):
        yolo.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    (tmp_path / "b" / "preview.png").unlink()
    with raises_error(OutputError, place="preview.png"):
        yolo.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
