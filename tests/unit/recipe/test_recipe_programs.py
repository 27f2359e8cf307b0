"""A plant's L-system program: found beside the file that names it, part of the recipe and of its hash."""

from __future__ import annotations

from pathlib import Path

import pytest
from recipe_example import SPECIES

from forestgen.core.errors import AssetError
from forestgen.recipe.load import dump_yaml, load_recipe
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
species:
  weed: {from: ./kinds/weed.yaml}
  other: {from: ./kinds/weed.yaml, plant: {program: ./own.lsys}}
  shipped: {from: ./kinds/weed.yaml, plant: {program: koch}}
community: {model: lattice}
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    (tmp_path / "kinds").mkdir()
    plant = "  generator: turtle\n  program: ./mine.lsys\n"
    (tmp_path / "kinds" / "weed.yaml").write_text(SPECIES.replace("  generator: pole\n  leaves: 12\n", plant))
    (tmp_path / "kinds" / "mine.lsys").write_text("axiom: F\n")
    (tmp_path / "own.lsys").write_text("axiom: FF\n")
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE)
    return path


def programs(path: Path) -> dict[str, dict[str, str]]:
    return {name: one.plant.parameters["program"] for name, one in load_recipe(path).draw(0).species.items()}


def test_a_program_lies_beside_the_file_that_names_it(recipe):
    found = programs(recipe)
    assert found["weed"] == {"name": "mine.lsys", "text": "axiom: F\n"}
    assert found["other"] == {"name": "own.lsys", "text": "axiom: FF\n"}
    assert found["shipped"]["name"] == "koch.lsys"
    assert "axiom" in found["shipped"]["text"]


def test_a_drawn_recipe_holds_its_programs(recipe, tmp_path):
    loaded = load_recipe(recipe)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "drawn.yaml").write_text(dump_yaml(loaded.draw(0)))
    again = load_recipe(elsewhere / "drawn.yaml")
    assert programs(elsewhere / "drawn.yaml") == programs(recipe)
    assert again.hash == load_recipe(recipe).hash


def test_the_hash_covers_the_program(recipe):
    before = load_recipe(recipe).hash
    (recipe.parent / "kinds" / "mine.lsys").write_text("axiom: G\n")
    assert load_recipe(recipe).hash != before


@pytest.mark.parametrize(("old", "new", "place"), [
    ("./own.lsys", "./none.lsys", "recipe.yaml:4: species.other.plant.program"),
    ("koch", "kohc", "recipe.yaml:5: species.shipped.plant.program"),
])  # fmt: skip
def test_a_missing_program_is_named(recipe, old, new, place):
    recipe.write_text(RECIPE.replace(old, new))
    with raises_error(AssetError, place=place):
        load_recipe(recipe)


def test_a_species_files_missing_program_is_named(recipe):
    (recipe.parent / "kinds" / "mine.lsys").unlink()
    with raises_error(AssetError, place="plant.program"):
        load_recipe(recipe)
