"""Recipes whose densities are pictures: what an author writes, what is refused, what travels with the images."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from command_line import run, tree
from PIL import Image
from ruamel.yaml import YAML

from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.recipe.json_schema import recipe_json_schema

RECIPE = """\
forestgen: 1
seed: 3
site: {size_m: [6, 4], terrain: flat, ground: soil_wet}
species: {fireweed: }
community:
  model: deformation_kernel
  plants:
    fireweed:
      count: 40
      map: meadow.png
  keep_out: {file: path.png}
plants: {exemplars_per_species: 1}
cameras: [{position_m: [3, -3, 1.5], look_at_m: [3, 2, 0.5], size_px: [48, 27]}]
render: {samples: 1, denoise: false}
labels: {samples: 1}
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """Plants in the eastern half, none on a path from west to east."""
    folder = tmp_path / "recipes"
    folder.mkdir()
    density, path = np.zeros((20, 30), np.uint8), np.zeros((20, 30), np.uint8)
    density[:, 15:] = 200
    path[9:11] = 255
    Image.fromarray(density).save(folder / "meadow.png")
    Image.fromarray(path).save(folder / "path.png")
    (folder / "stand.yaml").write_text(RECIPE)
    return folder / "stand.yaml"


def painted(path: Path, row: int, col: int, value: int) -> None:
    """Change one pixel."""
    with Image.open(path) as image:
        stored = np.array(image)
    stored[row, col] = value
    Image.fromarray(stored).save(path)


def hash_of(recipe: Path) -> str:
    answer = run("validate", recipe)
    assert answer.code == 0, answer.err
    return next(line.split()[1] for line in answer.out.splitlines() if line.startswith("  hash "))


def test_the_hash_is_of_the_pixels_and_not_of_the_name(recipe: Path) -> None:
    first = hash_of(recipe)
    (recipe.parent / "meadow.png").rename(recipe.parent / "other.png")
    recipe.write_text(RECIPE.replace("meadow.png", "./other.png"))
    assert hash_of(recipe) == first
    painted(recipe.parent / "other.png", 3, 20, 201)
    assert hash_of(recipe) != first


@pytest.mark.slow
def test_an_output_folder_holds_the_maps_that_its_recipes_need(recipe: Path, tmp_path: Path) -> None:
    recipe.write_text(RECIPE.replace("seed: 3", "seed: 3\nimages: 2"))
    assert run("render", recipe, "-o", tmp_path / "first").code == 0
    written = tree(tmp_path / "first")
    maps = {name: content for name, content in written.items() if name.startswith("train/maps/")}
    assert set(maps.values()) == {(recipe.parent / name).read_bytes() for name in ("meadow.png", "path.png")}
    listed = json.loads(written["train/manifest.json"] or b"")["files"]
    assert {name.removeprefix("train/") for name in maps} < set(listed)

    elsewhere = tmp_path / "elsewhere"
    shutil.move(tmp_path / "first", elsewhere)
    shutil.rmtree(recipe.parent)
    assert run("render", elsewhere / "train" / "000001-camera0" / "recipe.yaml", "-o", tmp_path / "again").code == 0
    again = tree(tmp_path / "again")
    assert {name: again[name] for name in maps} == maps
    frame = {name: content for name, content in written.items() if name.startswith("train/000001-camera0")}
    assert len(frame) > 5
    assert {name: again[name] for name in frame} == frame


@pytest.mark.slow
def test_plants_stand_where_the_map_lets_them(recipe: Path, tmp_path: Path) -> None:
    import pyarrow.parquet

    recipe.write_text(RECIPE.replace("count: 40", "count: 90"))
    assert run("simulate", recipe, "-o", tmp_path / "out").code == 0
    table = pyarrow.parquet.read_table(tmp_path / "out" / "history.parquet").to_pydict()
    x, y = np.array(table["x_m"]), np.array(table["y_m"])
    assert len(x) > 20
    assert x.min() > 3 - 0.2  # half a pixel more: values are straight between the middles of pixels
    assert not np.any((y > 1.8) & (y < 2.2))


@pytest.fixture(scope="module")
def community() -> jsonschema.Draft202012Validator:
    """The JSON Schema of the community section, of one model for speed."""
    own = COMMUNITY_MODELS.load("deformation_kernel").Parameters.model_json_schema()
    schema = recipe_json_schema({"deformation_kernel": own})
    return jsonschema.Draft202012Validator({"$defs": schema["$defs"], "$ref": "#/$defs/Community"})


@pytest.mark.parametrize("written", [
    "meadow.png", "[[0, 1], [1, 0.5]]", "{file: meadow.png, scale: 3, invert: true, fit: stretch, smooth: false}",
    "{choice: [meadow.png, path.png]}", "{file: {choice: [meadow.png, path.png]}, scale: {uniform: [1, 2]}}",
    "{rows: [[1, 0]], fit: stretch}", "null",
])  # fmt: skip
def test_editors_and_the_loader_admit_the_same_forms(
    recipe: Path, community: jsonschema.Draft202012Validator, written: str
) -> None:
    text = RECIPE.replace("map: meadow.png", f"map: {written}")
    assert community.is_valid(YAML(typ="safe").load(text)["community"])
    recipe.write_text(text)
    hash_of(recipe)


@pytest.mark.parametrize("written", ["7", "[1, 2]", "{fil: meadow.png}", "{file: meadow.png, fit: tight}", "[[-1]]"])
def test_editors_and_the_loader_refuse_the_same_forms(
    recipe: Path, community: jsonschema.Draft202012Validator, written: str
) -> None:
    text = RECIPE.replace("map: meadow.png", f"map: {written}")
    assert not community.is_valid(YAML(typ="safe").load(text)["community"])
    recipe.write_text(text)
    run("validate", recipe).refused(2)


def picture_of(folder: Path, name: str, values: np.ndarray) -> None:
    Image.fromarray(values).save(folder / name)


def test_bad_maps_are_refused_with_their_line(recipe: Path) -> None:
    folder = recipe.parent
    picture_of(folder, "dark.png", np.zeros((20, 30), np.uint8))
    picture_of(folder, "square.png", np.ones((30, 30), np.uint8))
    picture_of(folder, "holes.tif", np.full((20, 30), np.nan, np.float32))
    picture_of(folder, "below.tif", np.full((20, 30), -1, np.float32))
    (folder / "cut.png").write_bytes((folder / "meadow.png").read_bytes()[:60])
    (folder / "notes.png").write_text("not a picture")
    np.save(folder / "cube.npy", np.ones((2, 2, 2)))
    for name in ("dark.png", "square.png", "holes.tif", "below.tif", "cut.png", "notes.png", "cube.npy", "medow.png"):
        recipe.write_text(RECIPE.replace("map: meadow.png", f"map: {name}"))
        run("validate", recipe).refused(2)
        assert run("validate", recipe, "--set", "community.plants.fireweed.map=meadow.png").code == 0
