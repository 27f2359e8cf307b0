from __future__ import annotations

import pytest
from pydantic import ValidationError

from forestgen.core.errors import RecipeError
from forestgen.recipe.dataset import Dataset
from forestgen.recipe.load import load_recipe


def test_all_formats_and_a_licence():
    made = Dataset(formats=("yolo", "coco"), licence={"name": "CC BY 4.0"}, contributor='Ü "x"')
    assert made.formats == ("yolo", "coco")
    assert made.licence.url == ""


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"formats": ("coco", "yolo", "coco")}, "each format once"),
        ({"formats": ("voc",)}, "'coco'"),
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


def test_bop_without_amodal_names_the_channels(tmp_path):
    (tmp_path / "r.yaml").write_text(
        "forestgen: 1\nspecies: {birch: }\ncommunity: {model: uniform, count: 2}\n"
        "labels: {channels: [sun, cloud]}\ndataset: {formats: [bop]}\n"
    )
    with pytest.raises(RecipeError, match="amodal masks") as caught:
        load_recipe(tmp_path / "r.yaml").check()
    assert "r.yaml:4" in str(caught.value.where)
    assert caught.value.got == "sun, cloud"
    assert "leave bop out" in str(caught.value.hint)


@pytest.mark.parametrize("name", ["ground", "Sky", "nothing"])
def test_what_is_no_plant_names_no_species(name, tmp_path):
    recipe = tmp_path / "stand.yaml"
    recipe.write_text(f"forestgen: 1\nspecies:\n  {name}: {{from: spruce}}\ncommunity: {{model: placed}}\n")
    with pytest.raises(RecipeError, match="what is no plant") as refused:
        load_recipe(recipe).draw(0)
    assert "stand.yaml:3" in str(refused.value.where)
