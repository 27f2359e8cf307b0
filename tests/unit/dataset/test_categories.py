"""COCO, panoptic and YOLO number plants by labels.classes where a recipe has them; classes.json tells the numbers."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from dataset_shots import CLASSES, SETTINGS, SPECIES
from format_shots import drawn, written
from PIL import Image
from ruamel.yaml import YAML
from yaml import safe_load

from forestgen.core.errors import OutputError
from forestgen.dataset.exr import read_exr_attributes
from forestgen.dataset.formats import coco, panoptic, yolo
from forestgen.dataset.writer import write_dataset, write_frame
from forestgen.recipe.classes import PLANT_PARTS, ClassMap
from support.error_messages import raises_error
from support.tiers import few

MASK = np.array([[1, 1, 0, 2], [3, 3, 0, 2]])  # plants 1 and 3 are oaks, 2 is a poplar
ODD = 'herb "x", {é}: #1 \\ 🌲'
CASES = {
    "names with blanks": ({"conifer tree": ("spruce",), ODD: ("oak", "poplar")}, ("conifer tree", ODD), (2, 2)),
    "two species": ({"wood": ("trunk",), "tree": ("oak", "poplar"), "fir": ("spruce",)}, ("tree", "fir"), (1, 1)),
    "others": ({"conifer": ("spruce",), "rest": ("others",)}, ("conifer", "rest"), (2, 2)),
    "parts alone": ({"parts": PLANT_PARTS, "broad": ("oak",)}, ("broad", "poplar", "spruce"), (1, 2)),
}


def settings_of(classes, **more):
    names, index = classes.instance_categories
    own = {"class_names": classes.names, "category_names": names, "species_category": tuple(index.tolist())}
    return replace(SETTINGS, **own, **more)


@pytest.mark.parametrize("case", few(CASES))
def test_categories_follow_the_classes(case, tmp_path):
    rules, names, (oak, poplar) = CASES[case]
    classes = ClassMap(SPECIES, rules)
    frames, settings = {"a": drawn(MASK, classes=classes)}, settings_of(classes)
    instances = json.loads((written(coco, tmp_path, frames, settings) / "coco.json").read_text())
    assert [(one["id"], one["name"]) for one in instances["categories"]] == list(enumerate(names, start=1))
    found = [(one["plant_id"], one["category_id"], one["species"]) for one in instances["annotations"]]
    assert found == [(1, oak, "oak"), (2, poplar, "poplar"), (3, oak, "oak")]

    content = json.loads((written(panoptic, tmp_path, frames, settings) / "panoptic.json").read_text())
    listed = [(one["id"], one["name"], one["isthing"]) for one in content["categories"]]
    ground = len(names) + 1
    assert listed[: len(names)] == [(i, name, 1) for i, name in enumerate(names, start=1)]
    assert listed[len(names) :] == [(ground, "ground", 0), (ground + 1, "sky", 0)]
    segments = [one["category_id"] for one in content["annotations"][0]["segments_info"]]
    assert segments == [oak, poplar, oak, ground, ground + 1]

    home = written(yolo, tmp_path, frames, settings) / "yolo"
    for task in ("boxes", "segmentation"):
        lines = (home / task / "labels" / "a.txt").read_text().splitlines()
        assert [int(line.split()[0]) + 1 for line in lines] == [oak, poplar, oak]
        for read in (YAML(typ="safe").load, safe_load):  # trainers take the second
            assert read((home / task / "data.yaml").read_text("utf-8"))["names"] == dict(enumerate(names))


def test_frames_of_other_classes_are_not_merged(tmp_path):
    one, other = (ClassMap(SPECIES, {"a": ("oak", held), "b": ("others",)}) for held in ("poplar", "spruce"))
    for module in (coco, panoptic):
        written(module, tmp_path, {"x": drawn(MASK, classes=one)}, settings_of(one))
        for settings in (settings_of(other), SETTINGS):
            with raises_error(OutputError):
                module.FORMAT.merge(tmp_path, ["x"], settings)


def test_a_class_a_species_changes_nothing(tmp_path):
    same = ClassMap(SPECIES, {name: (name,) for name in SPECIES})
    assert settings_of(same) == SETTINGS == settings_of(CLASSES)
    shards = []
    for name, classes in (("a", CLASSES), ("b", same)):
        written(coco, tmp_path / name, {"x": drawn(MASK, classes=classes)})
        shards.append((tmp_path / name / "x" / "annotations.json").read_bytes())
    assert shards[0] == shards[1]
    assert "categories" not in json.loads(shards[0])


def test_the_legend_names_all_numbers(tmp_path):
    classes = ClassMap(SPECIES, CASES["parts alone"][0])
    labelled = drawn(MASK, classes=classes)
    settings = settings_of(classes, formats=())
    write_frame(tmp_path / "x", labelled, "", {}, settings)
    write_dataset(tmp_path, [tmp_path / "x"], settings)
    legend = json.loads((tmp_path / "classes.json").read_text())
    assert legend["semantic"] == {"0": "nothing", "1": "ground", "2": "parts", "3": "broad"}
    assert legend["categories"] == {"1": "broad", "2": "poplar", "3": "spruce"}
    assert (legend["part"]["0"], legend["part"]["12"], len(legend["part"])) == ("nothing", "surroundings", 15)
    with Image.open(tmp_path / "x" / "semantic.png") as image:
        assert json.loads(image.text["classes"]) == legend["semantic"]
        colours = np.asarray(image.convert("RGB"))
    for number, colour in legend["semantic_colours"].items():
        assert (colours[labelled.pixels.semantic == int(number)] == colour).all()
    header = read_exr_attributes(tmp_path / "x" / "frame.exr")
    assert json.loads(header["forestgen/classes"]) == legend["semantic"]
    assert json.loads(header["forestgen/parts"]) == legend["part"]
