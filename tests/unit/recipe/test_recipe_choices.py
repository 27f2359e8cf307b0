"""Choices with weights, and among mappings and lists."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import dump_yaml, load_recipe
from forestgen.recipe.map_files import recipe_hash
from support.error_messages import raises_error

Write = Callable[..., Path]
TEXT = """\
forestgen: 1
seed: 2
species: {oak: ./oak.yaml}
community: {model: lattice, plants: {choice: [{oak: {count: {integers: [1, 9]}}}, {oak: {plants_per_ha: 100}}]}}
site: {altitude_m: {choice: [{uniform: [0, 10]}, 500]}}
sky:
  clouds:
    choice:
      values:
        - {type: noise, cover: {uniform: [0.1, 0.6]}}
        - none
        - {type: noise, cover: {choice: [0.9, 0.8]}, base_m: {uniform: [500, 900]}}
      weights: [1, 1, 2]
cameras:
  - choice:
      - {name: eye, position_m: [40, -4, {uniform: [1.5, 2.0]}]}
      - {name: eye, position_m: [40, 40, {uniform: [30, 60]}], look_at_m: {choice: [[1, 2, 3], [40, 80, 1]]}}
"""


def test_alternatives_and_what_is_drawn_in_them(write: Write) -> None:
    loaded = load_recipe(write(TEXT))
    clouds: Counter[int] = Counter()
    for index in range(200):
        drawn = loaded.draw(index)
        recipe, chosen = drawn.recipe, drawn.draws[("sky", "clouds")]
        clouds[int(chosen or 0)] += 1
        assert recipe.sky.clouds.type == ("none" if chosen == 1 else "noise")
        within = {keys: value for keys, value in drawn.draws.items() if keys[:3] == ("sky", "clouds", "choice")}
        assert len(within) == {0: 1, 1: 0, 2: 2}[int(chosen or 0)]  # of what was not chosen nothing is told
        if chosen == 0:
            assert recipe.sky.clouds.cover == within[("sky", "clouds", "choice", "values", 0, "cover")] <= 0.6
        if chosen == 2:
            assert recipe.sky.clouds.cover in (0.8, 0.9)
            assert 500 <= recipe.sky.clouds.base_m <= 900
        assert recipe.site.altitude_m == 500 or 0 <= recipe.site.altitude_m <= 10
        camera = recipe.cameras[0]
        assert (camera.position_m[2] >= 30) == (drawn.draws[("cameras", 0)] == 1)
        assert ("count" in recipe.community.parameters["plants"]["oak"]) == (drawn.draws[("community", "plants")] == 0)
    assert clouds[2] > clouds[0] + clouds[1] - 40
    assert min(clouds.values()) > 25


def test_a_stored_recipe_holds_what_was_chosen(write: Write, tmp_path: Path) -> None:
    for index in range(6):
        drawn = load_recipe(write(TEXT)).draw(index)
        path = tmp_path / "drawn.yaml"
        path.write_text(dump_yaml(drawn))
        again = load_recipe(path)
        assert again.draw(0).data == drawn.data
        assert again.hash == recipe_hash(drawn.data)


def test_probes_look_into_every_alternative(write: Write) -> None:
    probes = [drawn.data for drawn in load_recipe(write(TEXT)).probes()]
    covers = {probe["sky"]["clouds"].get("cover") for probe in probes}
    assert covers >= {0.1, 0.6, 0.8, 0.9, None}
    assert {probe["cameras"][0]["position_m"][2] for probe in probes} >= {1.5, 2.0, 30, 60}


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("0.1, 0.6", "0.1, 1.6", ":10: sky.clouds.cover"),
        ("500, 900", "500, -900", ":12: sky.clouds.choice.values.2.base_m"),
        ("base_m", "bas_m", ":12: sky.clouds.bas_m"),
        ("[1, 1, 2]", "[1, 1]", ":7: sky.clouds"),
        ("[1, 1, 2]", "[1, 1, 0]", ":7: sky.clouds"),
        ("weights", "wieghts", ":7: sky.clouds"),
        ("{oak: ./oak.yaml}", "{choice: [{oak: ./oak.yaml}]}", ":3: species"),
    ],
)
def test_mistakes(write: Write, old: str, new: str, place: str) -> None:
    with raises_error(RecipeError, place=f"stand.yaml{place}"):
        load_recipe(write(TEXT.replace(old, new)))


def test_of_many_alternatives_each_is_looked_at(write: Write) -> None:
    """Of many numbers some are tried; of mappings any may be the one that is wrong."""
    text = TEXT.replace("{choice: [{uniform: [0, 10]}, 500]}", "{choice: [" + "{uniform: [0, 10]}, " * 70 + "500]}")
    probes = list(load_recipe(write(text)).probes())
    tried = {probe.draws[("site", "altitude_m")] for probe in probes}
    assert tried == set(range(71))


def test_weights_written_as_a_mapping_are_met_with_the_right_form(write: Write) -> None:
    with raises_error(RecipeError, place="plants.season"):
        load_recipe(write(TEXT), ["plants.season={choice: {summer: 3, autumn: 1}}"])


def test_alternatives_can_be_strata_and_have_points(write: Write) -> None:
    text = TEXT + (
        "sampling: {method: sobol, strata: {sky.clouds: 4, cameras.0: all}, "
        "correlations: [{keys: [sky.clouds.choice.values.0.cover, community.plants], rank: 0.5}]}\n"
        "dataset: {splits: {all: 1}}\n"
    )
    loaded = load_recipe(write(text))
    found = Counter((d[("sky", "clouds")], d[("cameras", 0)]) for d in (loaded.draws.values(n) for n in range(8)))
    assert found == {(0, 0): 1, (0, 1): 1, (1, 0): 1, (1, 1): 1, (2, 0): 2, (2, 1): 2}
    assert load_recipe(write(text)).hash != load_recipe(write(TEXT)).hash
