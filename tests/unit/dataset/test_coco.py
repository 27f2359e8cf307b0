from __future__ import annotations

import contextlib
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import SETTINGS, SPECIES, make_shot
from format_shots import LICENSED, all_bytes, awkward_masks, drawn, written
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pycocotools import mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from forestgen.core.errors import OutputError
from forestgen.core.parts import Part
from forestgen.dataset.formats import coco
from forestgen.dataset.formats.coco import encode_masks
from support.error_messages import raises_error

# pycocotools 2.0.11 decodes through an __array__ of NumPy 1's signature.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@settings(max_examples=100, deadline=None)
@given(
    hnp.arrays(
        np.uint32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9),
        elements=st.sampled_from([0, 1, 2, 2**32 - 1]),
    )
)
def test_codes_equal_pycocotools_own(instance):
    codes = encode_masks(instance)
    assert set(codes) == set(np.unique(instance).tolist()) - {0}
    for plant, code in codes.items():
        own = mask.encode(np.asfortranarray(instance == plant, dtype=np.uint8))
        assert code == {"size": list(instance.shape), "counts": own["counts"].decode()}


def loaded(root):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(str(root / "coco.json"))


FRAMES = {
    "000001-camera0": make_shot(range(1, 9), seed=1).labelled,
    "000000-camera0": make_shot(range(1, 12), seed=2).labelled,
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = written(coco, tmp_path_factory.mktemp("coco"), FRAMES, LICENSED)
    return loaded(root), root


def annotations_of(dataset):
    """(labelled frame, row, annotation) of all annotations."""
    for image in dataset.loadImgs(dataset.getImgIds()):
        labelled = FRAMES[image["file_name"].split("/")[0]]
        for one in dataset.loadAnns(dataset.getAnnIds(imgIds=image["id"])):
            yield labelled, labelled.population.plant_id.tolist().index(one["plant_id"]), one


def test_masks_areas_and_boxes(dataset):
    assert [image["file_name"] for image in dataset[0].loadImgs([1, 2])] == [
        "000000-camera0/preview.png",
        "000001-camera0/preview.png",
    ]
    for image in dataset[0].loadImgs([1, 2]):
        instance = FRAMES[image["file_name"].split("/")[0]].pixels.instance
        assert (image["height"], image["width"]) == instance.shape
        found = dataset[0].loadAnns(dataset[0].getAnnIds(imgIds=image["id"]))
        assert [one["plant_id"] for one in found] == [plant for plant in np.unique(instance).tolist() if plant]
        for one in found:
            np.testing.assert_array_equal(dataset[0].annToMask(one).astype(bool), instance == one["plant_id"])
            assert one["area"] == mask.area(one["segmentation"]) == (instance == one["plant_id"]).sum()
            assert one["bbox"] == mask.toBbox(one["segmentation"]).tolist()
            assert one["iscrowd"] == 0
            assert isinstance(one["segmentation"]["counts"], str)


def test_amodal_masks_hold_the_visible_ones(dataset):
    larger = 0
    for labelled, row, one in annotations_of(dataset[0]):
        whole = mask.decode(one["amodal_segmentation"]).astype(bool)
        assert not (mask.decode(one["segmentation"]).astype(bool) & ~whole).any()
        assert one["amodal_area"] == whole.sum() == labelled.views.amodal_pixels[row]
        assert one["amodal_bbox"] == mask.toBbox(one["amodal_segmentation"]).tolist()
        assert one["visible_fraction"] == labelled.views.visible_fraction[row]
        assert one["truncation"] == labelled.views.truncation[row]
        left, top, right, bottom = labelled.views.full_box_px[row]
        assert one["full_bbox"] == [left, top, right - left, bottom - top]
        larger += one["amodal_area"] > one["area"]
    assert larger > 3


def test_keypoints_follow_coco(dataset):
    category = dataset[0].loadCats(1)[0]
    assert category["keypoints"] == ["stem_base", "tip", "crown_centre"]
    assert all(1 <= end <= 3 for pair in category["skeleton"] for end in pair)
    states = set()
    for labelled, row, one in annotations_of(dataset[0]):
        points = np.array(one["keypoints"]).reshape(3, 3)
        np.testing.assert_array_equal(points[:, 2], labelled.views.keypoint_state[row])
        known = points[:, 2] > 0
        assert one["num_keypoints"] == known.sum()
        np.testing.assert_array_equal(points[known, :2], labelled.views.keypoint_px[row][known])
        assert (points[~known] == 0).all()
        states |= set(points[:, 2])
    assert {0, 1} <= states


def test_measures_and_ids(dataset):
    content = json.loads((dataset[1] / "coco.json").read_text())
    ids = [one["id"] for one in content["annotations"]]
    assert ids == list(range(1, len(ids) + 1))
    assert [(one["id"], one["name"]) for one in content["categories"]] == [(1, "poplar"), (2, "spruce"), (3, "oak")]
    nulls = 0
    for labelled, row, one in annotations_of(dataset[0]):
        population = labelled.population
        species = population.species_names[population.species[row]]
        assert dataset[0].loadCats(one["category_id"])[0]["name"] == species == one["species"]
        assert (one["height_m"], one["age_yr"]) == (population.height_m[row], population.age_yr[row])
        assert one["status"] == ["growing", "dominated", "mature", "dead"][population.status[row]]
        assert one["distance_m"] == labelled.views.distance_m[row]
        dbh = labelled.measures.dbh_m[row]
        assert one["dbh_m"] == (None if np.isnan(dbh) else dbh)
        nulls += one["dbh_m"] is None
    assert nulls


def test_licence_and_contributor_come_from_the_recipe(dataset):
    content = json.loads((dataset[1] / "coco.json").read_text())
    assert content["info"] == {
        "contributor": LICENSED.contributor,
        "description": LICENSED.description,
        "version": "1",
    }
    assert content["licenses"] == [{"id": 1, "name": "CC BY 4.0", "url": LICENSED.licence_url}]
    assert {image["license"] for image in content["images"]} == {1}
    assert {image["camera"] for image in content["images"]} == {f"{name}/camera.json" for name in FRAMES}


def test_no_licence_is_no_entry(tmp_path):
    content = json.loads((written(coco, tmp_path, {"a": drawn([[0, 1]])}) / "coco.json").read_text())
    assert content["licenses"] == []
    assert "license" not in content["images"][0]


def test_stems_are_the_trunk_pixels(tmp_path):
    instance = np.array([[1, 1, 2], [1, 1, 2], [0, 1, 3]], np.uint32)
    part = np.where(instance > 0, Part.LEAF, Part.GROUND)
    part[:, 1] = Part.TRUNK
    part[2, 2] = Part.TRUNK
    root = written(coco, tmp_path, {"a": drawn(instance, part)})
    first, second, third = json.loads((root / "coco.json").read_text())["annotations"]
    stem = mask.decode(first["stem_segmentation"]).astype(bool)
    np.testing.assert_array_equal(stem, (instance == 1) & (part == Part.TRUNK))
    assert "stem_segmentation" not in second
    assert third["stem_segmentation"] == third["segmentation"]


@pytest.mark.parametrize("number", range(len(awkward_masks())))
def test_awkward_masks(tmp_path, number):
    instance = awkward_masks()[number]
    root = written(coco, tmp_path, {"é 'x\" y": drawn(instance, unseen=[77])})
    dataset = loaded(root)
    found = dataset.loadAnns(dataset.getAnnIds())
    assert [one["plant_id"] for one in found] == [plant for plant in np.unique(instance).tolist() if plant]
    for one in found:
        np.testing.assert_array_equal(dataset.annToMask(one).astype(bool), instance == one["plant_id"])
        assert not ((instance == one["plant_id"]) & ~mask.decode(one["amodal_segmentation"]).astype(bool)).any()
    assert (root / dataset.loadImgs(1)[0]["file_name"]).is_file()


def test_amodal_runs_that_fill_columns(tmp_path):
    labelled = drawn(np.full((3, 4), 5, np.uint32))
    one = json.loads((written(coco, tmp_path, {"a": labelled}) / "coco.json").read_text())["annotations"][0]
    assert one["amodal_segmentation"] == one["segmentation"]


def test_without_amodal_masks_their_fields_are_absent(tmp_path):
    labelled = replace(FRAMES["000000-camera0"], amodal=None)
    found = json.loads((written(coco, tmp_path, {"a": labelled}) / "coco.json").read_text())["annotations"]
    assert found
    absent = {"amodal_segmentation", "amodal_bbox", "amodal_area", "visible_fraction", "full_bbox", "truncation"}
    assert not any(absent & set(one) for one in found)


def test_equal_input_equal_bytes(tmp_path, dataset):
    first = all_bytes(dataset[1])
    coco.FORMAT.merge(dataset[1], [dataset[1] / name for name in reversed(FRAMES)], LICENSED)
    assert all_bytes(dataset[1]) == first
    assert all_bytes(written(coco, tmp_path, dict(reversed(FRAMES.items())), LICENSED)) == first


def evaluated(dataset, kind, found):
    with contextlib.redirect_stdout(io.StringIO()):
        results = dataset.loadRes([dict(one) for one in found])  # it adds fields
        judge = COCOeval(dataset, results, kind)
        if kind == "keypoints":
            judge.params.kpt_oks_sigmas = np.full(3, 0.05)
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return judge.stats


@pytest.mark.parametrize("kind", ["segm", "bbox", "keypoints"])
def test_cocoeval_of_the_truth_against_itself_is_1(dataset, kind):
    field = {"segm": "segmentation", "bbox": "bbox", "keypoints": "keypoints"}[kind]
    keys = ("image_id", "category_id", field)
    found = [
        {**{key: one[key] for key in keys}, "score": 0.9}
        for _, _, one in annotations_of(dataset[0])
        if kind != "keypoints" or one["num_keypoints"]
    ]
    assert len(found) >= 3
    assert evaluated(dataset[0], kind, found)[0] == pytest.approx(1.0, abs=1e-12)
    assert evaluated(dataset[0], kind, found[1:])[0] < 0.99  # the measure can tell


def test_no_frames(tmp_path):
    coco.FORMAT.merge(tmp_path, [], SETTINGS)
    content = json.loads((tmp_path / "coco.json").read_text())
    assert content["images"] == content["annotations"] == []
    assert [one["name"] for one in content["categories"]] == list(SPECIES)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(path.read_bytes()[:-9]),
        lambda path: path.write_bytes(b"\xff\x00"),
        lambda path: path.write_text("[]"),
        lambda path: path.write_text('{"annotations": [1], "image": {}, "species": []}'),
        lambda path: path.write_text('{"annotations": [], "image": {}, "species": ["fir"]}'),
    ],
)
def test_damaged_shards_are_named_and_nothing_is_left(tmp_path, damage):
    written(coco, tmp_path, {"a": drawn([[1]]), "b": drawn([[1]])})
    (tmp_path / "coco.json").unlink()
    damage(tmp_path / "b" / "annotations.json")
    with raises_error(OutputError, place="annotations.json"):
        coco.FORMAT.merge(tmp_path, ["a", "b"], SETTINGS)
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_a_merge_holds_one_frame_in_memory(tmp_path):
    import tracemalloc

    shard = {"annotations": [{"area": 1, "note": "x" * 1000}] * 200, "image": {"height": 1, "width": 1}}
    for i in range(30):
        (tmp_path / f"{i:06d}-a").mkdir()
        (tmp_path / f"{i:06d}-a" / "annotations.json").write_text(json.dumps({**shard, "species": list(SPECIES)}))
    tracemalloc.start()
    coco.FORMAT.merge(tmp_path, [f"{i:06d}-a" for i in range(30)], SETTINGS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (tmp_path / "coco.json").stat().st_size > 5e6
    assert peak < 1.5e6
