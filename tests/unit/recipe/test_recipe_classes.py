"""Names of `labels.classes`."""

from __future__ import annotations

import jsonschema
import pytest

from forestgen.core.errors import RecipeError
from forestgen.dataset.card import markdown_template
from forestgen.dataset.pack.pack import README_TEMPLATE
from forestgen.recipe.json_schema import recipe_json_schema
from forestgen.recipe.load import load_recipe_data
from support.tiers import few

BAD = [
    "",
    " ",
    " dead",
    "dead ",
    "dead\ttree",
    "dead\ntree",
    "dead\r",
    "\x7fdead",
    "dead\x85tree",
    "a\u2028b",
    "\u3000a",
]


def data(name):
    return {
        "forestgen": 1,
        "species": {"birch": "birch", "spruce": "spruce"},
        "community": {"model": "placed"},
        "labels": {"classes": {name: ["birch"], "rest": ["others"]}},
    }


@pytest.mark.parametrize(
    "name", few(["a, b: {c} [d] #e 'f' \"g\" \\h", "🌲", "no", "dead tree", "Acer × freemanii", "-", "x" * 200], 3)
)
def test_a_class_may_have_any_name(name):
    drawn = load_recipe_data(data(name), "test").draw(0)
    assert list(drawn.recipe.labels.classes) == [name, "rest"]
    jsonschema.validate(data(name), recipe_json_schema())


@pytest.mark.parametrize("name", BAD)
def test_names_that_cannot_be_seen_are_refused(name):
    with pytest.raises(RecipeError) as error:
        load_recipe_data(data(name), "test")
    assert "labels.classes" in error.value.where


def test_a_packs_readme_shows_names_as_they_are():
    names = {"0": "nothing", "1": "<b>bold</b> | *x*"}
    about = {"title": "title", "code": ["code"], "splits": {}, "channels": ["semantic"]}
    text = markdown_template(README_TEMPLATE).render(about, classes={"semantic": names, "categories": names})
    assert r"0 nothing, 1 \<b\>bold\</b\> \| \*x\*" in text
