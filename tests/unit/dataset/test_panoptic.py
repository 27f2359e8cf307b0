from __future__ import annotations

import json

import numpy as np
import pytest
from dataset_shots import SETTINGS, SPECIES, make_shot
from format_shots import LICENSED, all_bytes, awkward_masks, drawn, written
from PIL import Image

from forestgen.core.errors import OutputError
from forestgen.core.parts import Part
from forestgen.dataset.formats import coco, panoptic
from support.error_messages import raises_error

FRAMES = {
    "000001-camera0": make_shot(range(1, 9), seed=1).labelled,
    "000000-camera0": make_shot([*range(1, 12), 70_001, panoptic.MOST_PLANT_ID, 2**24], seed=2).labelled,
}


def rgb2id(colour):
    """The convention of COCO panoptic: 256 G and 65,536 B besides R."""
    return colour.astype(np.int64) @ [1, 256, 256 * 256]


def picture(root, annotation):
    with Image.open(root / "panoptic" / annotation["file_name"]) as image:
        assert image.mode == "RGB"
        return rgb2id(np.asarray(image))


def panoptic_quality(root, truth, found):
    """PQ by category (Kirillov et al. 2019, eq. 1), of pictures against JSON; raises where they disagree."""
    iou_sum, right, wrong, missed = ({category["id"]: 0.0 for category in truth["categories"]} for _ in range(4))
    for one, other in zip(truth["annotations"], found["annotations"], strict=True):
        first, second = picture(root, one), picture(root, other)
        known = [{segment["id"]: segment for segment in entry["segments_info"]} for entry in (one, other)]
        for ids, segments in zip((first, second), known, strict=True):
            areas = dict(zip(*(column.tolist() for column in np.unique(ids, return_counts=True)), strict=True))
            assert areas == {number: segment["area"] for number, segment in segments.items()}
        pairs, common = np.unique(np.stack([first.ravel(), second.ravel()]), axis=1, return_counts=True)
        hit = (set(), set())
        for (a, b), area in zip(pairs.T.tolist(), common.tolist(), strict=True):
            if known[0][a]["category_id"] != known[1][b]["category_id"]:
                continue
            iou = area / (known[0][a]["area"] + known[1][b]["area"] - area)
            if iou > 0.5:
                iou_sum[known[0][a]["category_id"]] += iou
                right[known[0][a]["category_id"]] += 1
                hit[0].add(a)
                hit[1].add(b)
        for segments, matched, tally in zip(known, hit, (missed, wrong), strict=True):
            for number in set(segments) - matched:
                tally[segments[number]["category_id"]] += 1
    return {
        category: iou_sum[category] / (right[category] + 0.5 * wrong[category] + 0.5 * missed[category])
        for category in iou_sum
        if right[category] + wrong[category] + missed[category]
    }


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = written(panoptic, tmp_path_factory.mktemp("panoptic"), FRAMES, LICENSED)
    return json.loads((root / "panoptic.json").read_text()), root


def test_quality_of_the_truth_against_itself_is_1(dataset):
    content, root = dataset
    assert panoptic_quality(root, content, content) == {1: 1.0, 3: 1.0, 4: 1.0, 5: 1.0}
    swapped = json.loads(json.dumps(content))
    thing = next(one for one in swapped["annotations"][0]["segments_info"] if one["category_id"] == 1)
    thing["category_id"] = 3
    assert panoptic_quality(root, content, swapped)[1] < 1.0  # the measure can tell


def test_every_pixel_has_its_segment(dataset):
    content, root = dataset
    for entry in content["annotations"]:
        labelled = FRAMES[entry["file_name"].removesuffix(".png")]
        ids, instance = picture(root, entry), labelled.pixels.instance
        np.testing.assert_array_equal(ids[instance > 0], instance[instance > 0])
        nothing = labelled.pixels.part == Part.NOTHING
        assert (ids[(instance == 0) & nothing] == panoptic.SKY_ID).all()
        assert (ids[(instance == 0) & ~nothing] == panoptic.GROUND_ID).all()
        assert {one["id"] for one in entry["segments_info"]} == set(np.unique(ids).tolist())
        for one in entry["segments_info"]:
            y, x = np.nonzero(ids == one["id"])
            assert one["area"] == len(x)
            assert one["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
            assert one["iscrowd"] == 0


def test_categories_and_images(dataset, tmp_path):
    content, _ = dataset
    found = [(one["id"], one["name"], one["isthing"]) for one in content["categories"]]
    assert found == [(1, "poplar", 1), (2, "spruce", 1), (3, "oak", 1), (4, "ground", 0), (5, "sky", 0)]
    instances = json.loads((written(coco, tmp_path, FRAMES, LICENSED) / "coco.json").read_text())
    for key in ("images", "info", "licenses"):
        assert content[key] == instances[key]
    category = {(one["image_id"], one["plant_id"]): one["category_id"] for one in instances["annotations"]}
    things = {
        (entry["image_id"], one["id"]): one["category_id"]
        for entry in content["annotations"]
        for one in entry["segments_info"]
        if one["category_id"] <= len(SPECIES)
    }
    assert things == category


def test_awkward_masks(tmp_path):
    masks = [mask for mask in awkward_masks() if mask.max() <= panoptic.MOST_PLANT_ID]
    assert len(masks) >= 7
    frames = {f"{i:02d} é'": drawn(mask) for i, mask in enumerate(masks)}
    root = written(panoptic, tmp_path, frames)
    content = json.loads((root / "panoptic.json").read_text())
    assert set(panoptic_quality(root, content, content).values()) == {1.0}
    for mask, entry in zip(masks, content["annotations"], strict=True):
        ids = picture(root, entry)
        np.testing.assert_array_equal(np.where(ids < panoptic.GROUND_ID, ids, 0), mask)


@pytest.mark.parametrize("plant", [panoptic.GROUND_ID, panoptic.SKY_ID, 2**24, 2**32 - 1])
def test_ids_that_do_not_fit_are_refused_before_anything_is_written(tmp_path, plant):
    with raises_error(OutputError, place="panoptic.png"):
        panoptic.FORMAT.write_frame(tmp_path, drawn([[0, plant]]), SETTINGS)
    assert not list(tmp_path.iterdir())
    panoptic.FORMAT.write_frame(tmp_path, drawn([[0, 5]], unseen=[plant]), SETTINGS)  # only what is seen counts


def test_equal_input_equal_bytes(tmp_path, dataset):
    first = all_bytes(dataset[1])
    panoptic.FORMAT.merge(dataset[1], list(FRAMES), LICENSED)
    assert all_bytes(dataset[1]) == first
    assert all_bytes(written(panoptic, tmp_path, dict(reversed(FRAMES.items())), LICENSED)) == first


def test_missing_and_damaged_shards(tmp_path):
    written(panoptic, tmp_path, {"a": drawn([[1]]), "b": drawn([[1]])})
    (tmp_path / "panoptic.json").unlink()
    (tmp_path / "b" / "panoptic.png").unlink()
    with raises_error(OutputError, place="panoptic.png"):
        panoptic.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    (tmp_path / "b" / "panoptic.json").write_text('{"image"')
    with raises_error(OutputError, place="panoptic.json"):
        panoptic.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    assert not (tmp_path / "panoptic.json").exists()
