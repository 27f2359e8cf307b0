"""Recipes in Python: files and mappings, values that replace theirs, errors, and what `validate` answers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from api_recipe import STAND

import forestgen as fg
from forestgen.recipe.assets import recipes_dir
from support.error_messages import raises_error

QUICKSTART = recipes_dir() / "quickstart.yaml"


def test_a_mapping_is_a_recipe_like_its_file(tmp_path: Path) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(json.dumps(STAND))
    from_file, from_mapping = fg.load(path), fg.load(STAND)
    assert from_file.hash == from_mapping.hash
    assert (from_file.name, from_mapping.name) == ("stand", "recipe")
    assert (from_file.images, from_file.seed) == (from_mapping.images, from_mapping.seed) == (2, 3)
    assert fg.load(str(path)).data == from_mapping.data
    assert fg.load(from_mapping.data).hash == from_mapping.hash  # with all defaults written out
    assert repr(from_file) == f"<Recipe {path}: 2 images>"


def test_a_text_is_a_recipe_and_its_errors_have_lines() -> None:
    """Such as that of a frame's `recipe`."""
    recipe = fg.load(STAND)
    again = fg.load(recipe.yaml, set={"seed": 4})
    assert (again.hash, again.seed) == (recipe.set({"seed": 4}).hash, 4)
    assert again.set({"seed": 3}).hash == recipe.hash
    for text in (
        "forestgen: 1\nsite: {size_m: [0, 80]}\n",
        "forestgen: 1\nsite: {",
        "just a word\n",
        "\n",
        "# x\n" * 300_000,
    ):
        with raises_error(fg.RecipeError):
            fg.load(text)


def test_a_mapping_and_its_recipe_do_not_share_values() -> None:
    mapping = json.loads(json.dumps(STAND))
    recipe = fg.load(mapping)
    before = recipe.hash
    mapping["site"]["size_m"][0] = 99
    recipe.data["site"]["size_m"][0] = 99
    assert recipe.data["site"]["size_m"] == [30, 20]
    assert recipe.hash == before


def test_what_is_set_later_is_set_in_what_was_read(tmp_path: Path) -> None:
    mapping, path = json.loads(json.dumps(STAND)), tmp_path / "stand.yaml"
    path.write_text(json.dumps(mapping))
    recipes = fg.load(mapping), fg.load(path)
    mapping["seed"] = 99
    path.write_text(json.dumps(mapping))
    for recipe in recipes:
        assert (recipe.seed, recipe.set({"images": 7}).seed) == (3, 3)
        assert recipe.set({"site.size_m": [40, 20]}).set({"site.size_m": [30, 20]}).hash == recipe.hash


def test_the_class_takes_what_load_takes() -> None:
    assert fg.Recipe(STAND, {"seed": 4}).hash == fg.load(STAND, {"seed": 4}).hash
    assert fg.Recipe(STAND, ["seed=4"]).seed == 4


def test_the_yaml_is_the_same_recipe(tmp_path: Path) -> None:
    path = tmp_path / "again.yaml"
    path.write_text(fg.load(STAND).yaml)
    assert fg.load(path).hash == fg.load(STAND).hash


@pytest.mark.parametrize(
    ("mapping", "texts"),
    [
        ({"sky.turbidity": 5}, ["sky.turbidity=5"]),
        ({"sky.turbidity": np.float64(5)}, ["sky.turbidity=5"]),
        ({"render.samples": np.int64(7)}, ["render.samples=7"]),
        ({"cameras.0.size_px": np.array([64, 48])}, ["cameras.0.size_px=[64, 48]"]),
        ({"cameras.0.size_px": (64, 48)}, ["cameras.0.size_px=[64, 48]"]),
        ({"render.denoise": np.bool_(False)}, ["render.denoise=false"]),
        ({"sky.turbidity": {"uniform": [2, np.float32(4)]}}, ["sky.turbidity={uniform: [2, 4]}"]),
        ({"dataset.description": "a: b # [c]"}, ['dataset.description="a: b # [c]"']),
        ({"seed": 4, "first_image": 9}, ["seed=4", "first_image=9"]),
        ({}, []),
    ],
)
def test_values_are_set_as_on_the_command_line(mapping: Mapping[str, Any], texts: list[str]) -> None:
    assert fg.load(STAND, set=mapping).hash == fg.load(STAND, set=texts).hash == fg.load(STAND).set(mapping).hash


def test_a_text_stays_a_text() -> None:
    for text in ("null", "5", "true", "[1]", "ä\n"):
        assert fg.load(STAND, set={"dataset.description": text}).data["dataset"]["description"] == text


def test_a_single_text_is_one_override() -> None:
    assert fg.load(STAND, set="seed=4").seed == 4


def test_set_makes_another_recipe_and_keeps_what_was_set() -> None:
    first = fg.load(STAND, set={"seed": 4})
    second = first.set({"images": 7}).set(["first_image=2"])
    assert (first.seed, first.images) == (4, 2)
    assert (second.seed, second.images, second.data["first_image"]) == (4, 7, 2)


@pytest.mark.parametrize("value", [float("nan"), np.float64("inf"), object(), {1, 2}, b"x", 1j, np.array([np.nan])])
def test_what_no_recipe_can_hold_is_refused_by_its_key(value: object) -> None:
    with raises_error(fg.RecipeError, place="sky.turbidity") as caught:
        fg.load(STAND, set={"sky.turbidity": value})
    assert caught.value.place == "set: sky.turbidity"


def test_an_error_has_its_parts_and_its_exit_code() -> None:
    with pytest.raises(fg.RecipeError) as caught:
        fg.load(STAND, set={"sky.turbidty": 5})
    error = caught.value
    assert (error.code, error.exit_code) == ("recipe", 2)
    assert str(error.place).endswith("sky.turbidty")
    assert error.hint == "did you mean 'turbidity'?"
    assert "turbidity" in str(error.expected)
    with pytest.raises(fg.RecipeError) as caught:
        fg.load({**STAND, "site": {"size_m": [-1, 2]}})
    assert (caught.value.place, caught.value.got) == ("recipe: site.size_m.0", "-1")
    with pytest.raises(fg.AssetError) as missing:
        fg.load("nix.yaml")
    assert missing.value.place == "nix.yaml"
    with pytest.raises(fg.ForestgenError):
        fg.load({})


def test_a_wrong_device_is_refused_before_any_work(tmp_path: Path) -> None:
    with raises_error(fg.RecipeError, place="device"):
        fg.load(STAND).render(tmp_path / "out", device="vulkan", progress=False)
    assert not list(tmp_path.iterdir())


def test_validate_says_what_a_recipe_makes() -> None:
    recipe = fg.load(STAND, set={"sky.turbidity": {"uniform": [2, 4]}, "cameras.0.name": "eye"})
    found = recipe.validate()
    said = found.as_dict()
    json.dumps(said, allow_nan=False)
    assert said["valid"] is True
    assert {name: said[name] for name in ("recipe", "images", "frames", "terrain", "community", "steps")} == {
        "recipe": "recipe", "images": 2, "frames": 2, "terrain": "flat", "community": "uniform", "steps": found.steps,
    }  # fmt: skip
    assert said["cameras"] == ({"name": "eye", "size_px": (48, 27), "frames": 1},)
    assert said["site_size_m"] == (30.0, 20.0)
    assert said["species"] == ("spruce", "fireweed")
    assert said["drawn"] == ("sky.turbidity",)
    assert said["hash"] == recipe.hash
    assert 0 < said["simulate_bytes"] < said["render_bytes"]
    assert said["notes"] == ()
    text = str(found)
    assert text.startswith("recipe: valid\n")
    for part in ("2 frames: 2 images x 1 camera", "eye, 48 x 27 px", "30 x 20 m, flat", "sky.turbidity", recipe.hash):
        assert part in text


def test_validate_counts_the_frames_of_paths_and_notes_what_is_odd() -> None:
    walk = {"path": {"position_m": [[3, -9, 1.5], [3, -3, 1.5]], "frames": 3}, "size_px": [8, 8], "name": "walk"}
    below = {"position_m": [3, -3, -1], "size_px": [8, 8], "name": "mole", "obstructed": "note"}
    found = fg.load({**STAND, "cameras": [walk, below]}).validate()
    assert [camera.frames for camera in found.cameras] == [3, 1]
    assert found.frames == 2 * 4
    assert found.notes == ("the camera mole stands below the ground",)
    with raises_error(fg.RecipeError, place="community.plants.spruce.radius_m.median"):
        fg.load(STAND, set={"community.plants.spruce.radius_m": -1}).validate()


def test_the_quickstart_is_valid() -> None:
    assert fg.load(QUICKSTART).validate().species == ("fireweed", "poplar", "spruce", "bramble")


@pytest.mark.parametrize(
    ("count", "first", "where"), [(1, 10**30, "first"), (1, 2**64, "first"), (2**64, 1, "count"), (10**30, 0, "count")]
)
def test_images_beyond_all_numbers_are_refused_at_once(count: int, first: int, where: str) -> None:
    with raises_error(fg.RecipeError, place=where):
        fg.load(STAND).frames(count, first=first)
