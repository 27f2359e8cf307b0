from __future__ import annotations

import json

import pytest
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.recipe.dataset import Dataset
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import load_recipe
from forestgen.recipe.registries import DATASET_FORMATS
from support.error_messages import raises_error


def test_all_formats_and_a_licence():
    made = Dataset(formats=("yolo", "coco"), licence={"name": "CC BY 4.0"}, contributor='Ü "x"')
    assert made.formats == ("yolo", "coco")
    assert made.licence.url == ""


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"formats": ("coco", "yolo", "coco")}, "each one once"),
        ({"formats": ("voc",)}, "unknown dataset format: expected one of bop, coco, "),
        ({"formats": (7,)}, "valid string"),
        ({"licence": {"name": ""}}, "at least 1"),
        ({"licence": {"url": "https://x.org"}}, "name"),
        ({"depth_unit_m": 0.0}, "greater than 0"),
        ({"depth_unit_m": float("nan")}, "finite"),
        ({"point_stride": 0}, "greater than or equal to 1"),
    ],
)
def test_mistakes(section, words):
    with pytest.raises(ValidationError, match=words):
        Dataset(**section)


def test_an_unknown_format_has_its_line_and_what_was_meant(tmp_path):
    recipe = tmp_path / "stand.yaml"
    recipe.write_text(
        "forestgen: 1\nspecies: {birch: }\ncommunity: {model: placed}\ndataset:\n  formats: [coco, panoptics]\n"
    )
    with raises_error(RecipeError, place="dataset.formats.1") as refused:
        load_recipe(recipe)
    error = refused.value
    assert "stand.yaml:5: dataset.formats.1" in str(error.where)
    assert (error.got, error.hint) == ("'panoptics'", "did you mean 'panoptic'?")


def test_the_json_schema_names_the_formats():
    places = recipe_json_schema()["$defs"]["Dataset"]["properties"]["formats"]
    assert all(f'"{name}"' in json.dumps(places) for name in DATASET_FORMATS)


@pytest.mark.parametrize("name", ["ground", "Sky", "nothing"])
def test_what_is_no_plant_names_no_species(name, tmp_path):
    recipe = tmp_path / "stand.yaml"
    recipe.write_text(f"forestgen: 1\nspecies:\n  {name}: {{from: spruce}}\ncommunity: {{model: placed}}\n")
    with raises_error(RecipeError) as refused:
        load_recipe(recipe).draw(0)
    assert "stand.yaml:3" in str(refused.value.where)
