from __future__ import annotations

import contextlib
import io
import json

import numpy as np
import pytest
from dataset_shots import SPECIES, make_shot
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pycocotools import mask
from pycocotools.coco import COCO

from forestgen.core.errors import OutputError
from forestgen.dataset.coco import FrameRecord, coco_dataset, encode_masks
from forestgen.dataset.writer import write_dataset, write_frame
from forestgen.labels.masks import instance_mask


@settings(max_examples=200, deadline=None)
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


@pytest.fixture
def dataset(tmp_path):
    shots = {"000001-camera0": make_shot(range(1, 9), seed=1), "000000-camera0": make_shot(range(1, 12), seed=2)}
    records = [
        write_frame(tmp_path / name, shot.frame, shot.population, SPECIES, "", {}) for name, shot in shots.items()
    ]
    write_dataset(tmp_path, records, SPECIES)
    with contextlib.redirect_stdout(io.StringIO()):
        return shots, COCO(str(tmp_path / "coco.json")), tmp_path


# pycocotools 2.0.11 decodes through an __array__ of NumPy 1's signature.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_masks_areas_and_boxes(dataset):
    shots, coco, _ = dataset
    assert [image["file_name"] for image in coco.loadImgs([1, 2])] == [
        "000000-camera0/preview.png",
        "000001-camera0/preview.png",
    ]
    for image in coco.loadImgs([1, 2]):
        instance = instance_mask(shots[image["file_name"].split("/")[0]].frame.identity.plant_id)
        found = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        assert [one["plant_id"] for one in found] == [plant for plant in np.unique(instance).tolist() if plant]
        for one in found:
            np.testing.assert_array_equal(coco.annToMask(one).astype(bool), instance == one["plant_id"])
            assert one["area"] == mask.area(one["segmentation"]) == (instance == one["plant_id"]).sum()
            assert one["bbox"] == mask.toBbox(one["segmentation"]).tolist()
            assert one["iscrowd"] == 0
            assert isinstance(one["segmentation"]["counts"], str)


def test_ids_and_categories(dataset):
    shots, coco, path = dataset
    content = json.loads((path / "coco.json").read_text())
    ids = [one["id"] for one in content["annotations"]]
    assert ids == list(range(1, len(ids) + 1))
    assert [(one["id"], one["name"]) for one in content["categories"]] == [(1, "poplar"), (2, "spruce"), (3, "oak")]
    assert content["licenses"] == []
    assert "date_created" not in content["info"]
    population = shots["000000-camera0"].population
    for one in coco.loadAnns(coco.getAnnIds(imgIds=1)):
        row = population.plant_id.tolist().index(one["plant_id"])
        species = population.species_names[population.species[row]]
        assert coco.loadCats(one["category_id"])[0]["name"] == species


def test_no_frames_and_an_empty_view():
    assert coco_dataset([], SPECIES)["images"] == []
    empty = coco_dataset([FrameRecord("000000-a", (4, 3), SPECIES, ())], SPECIES)
    assert empty["images"][0] == {"id": 1, "file_name": "000000-a/preview.png", "width": 4, "height": 3}
    assert empty["annotations"] == []


def test_frames_of_other_species_are_refused():
    with pytest.raises(OutputError, match="000000-a"):
        coco_dataset([FrameRecord("000000-a", (4, 3), ("fir",), ())], SPECIES)
