"""All images of a data set share what its files say once."""

from __future__ import annotations

from forestgen.core.errors import RecipeError
from forestgen.dataset.settings import check_one_data_set, class_map, data_set_of
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

BASE = """forestgen: 1
images: 4
species: {poplar: , spruce: }
community: {model: multiset_lsystem, program: succession}
"""


def loaded(tmp_path, text):
    (tmp_path / "r.yaml").write_text(BASE + text)
    return load_recipe(tmp_path / "r.yaml")


def test_settings_are_the_recipes(tmp_path):
    recipe = loaded(
        tmp_path,
        "labels: {classes: {wood: [trunk, branch], rest: [others]}}\n"
        "dataset: {formats: [yolo], contributor: me, licence: {name: CC0, url: here}, depth_unit_m: 0.001}\n",
    )
    settings = data_set_of(recipe.draw(0))
    assert settings.class_names == ("nothing", "ground", "wood", "rest")
    assert settings.species_names == ("poplar", "spruce")
    assert (settings.category_names, settings.species_category) == (("rest",), (0, 0))
    assert (settings.formats, settings.contributor, settings.depth_unit_m) == (("yolo",), "me", 0.001)
    assert (settings.licence_name, settings.licence_url) == ("CC0", "here")
    assert class_map(recipe.draw(0)).own_names == ("wood", "rest")


def test_images_that_agree_pass(tmp_path):
    recipe = loaded(tmp_path, "sky: {turbidity: {uniform: [2, 4]}}\n")
    settings = data_set_of(recipe.draw(0))
    for drawn in [*recipe.probes(), recipe.draw(3)]:
        check_one_data_set(drawn, settings)


def test_a_distribution_in_them_is_refused_with_its_place(tmp_path):
    recipe = loaded(tmp_path, "dataset:\n  depth_unit_m: {uniform: [0.001, 0.01]}\n")
    settings = data_set_of(recipe.draw(0))
    ends = list(recipe.probes())[1:]
    with raises_error(RecipeError, place="dataset.depth_unit_m") as caught:
        check_one_data_set(ends[0], settings)
    assert "r.yaml:6" in str(caught.value.where)
