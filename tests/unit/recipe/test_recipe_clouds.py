"""The keys of clouds: each type's own, and what is said of the others'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.load import dump_yaml, load_recipe
from forestgen.recipe.registries import CLOUD_SOURCES
from support.error_messages import raises_error

Write = Callable[..., Path]
SIMULATED = [name for name in CLOUD_SOURCES if hasattr(CLOUD_SOURCES.load(name), "conditions")]
NOISE = {"cover": 0.35, "base_m": 900.0, "thickness_m": 350.0, "extinction_per_m": 0.05, "extent_m": 8000.0}


@pytest.mark.parametrize("kind", [*SIMULATED, "noise", "none"])
def test_a_type_alone_is_enough(write: Write, kind: str) -> None:
    drawn = load_recipe(write(), [f"sky.clouds={kind}"]).draw(0)
    assert drawn.recipe.sky.clouds.type == kind
    assert drawn.data["sky"]["clouds"] == {"type": kind, **(NOISE if kind == "noise" else {})}


def test_what_is_stored_with_an_image_gives_it_again(write: Write, tmp_path: Path) -> None:
    (tmp_path / "dawn.csv").write_text("height_m,temperature_c\n0,10\n5000,-20\n")
    story = (
        "sky.clouds={time_s: {sequence: [60, 600]}, story: [{at_s: 0, type: fog, sounding: dawn.csv}, "
        "{at_s: 300, type: cumulus, emission: {heat_w_per_m2: {uniform: [50, 90]}, vapour_g_per_m2_s: 0.1}}]}"
    )
    loaded = load_recipe(write(), [story])
    drawn = loaded.draw(1)
    clouds = drawn.recipe.sky.clouds
    assert clouds.type == "fog"
    assert clouds.time_s == 600
    assert clouds.story is not None
    assert clouds.story[0].sounding is not None
    assert clouds.story[0].sounding.sha256 is not None
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(drawn))
    assert load_recipe(again).draw(0).recipe.sky.clouds == clouds
    (tmp_path / "dawn.csv").write_text("height_m,temperature_c\n0,11\n5000,-20\n")
    assert load_recipe(write(), [story]).hash != loaded.hash
    with raises_error(AssetError, place="sky.clouds.story.0.sounding.file"):
        load_recipe(again)


def test_where_the_type_is_drawn_none_has_no_keys_of_its_own(write: Write) -> None:
    loaded = load_recipe(write(), ["sky.clouds={type: {choice: [noise, none]}, cover: {uniform: [0.2, 0.4]}}"])
    assert {loaded.draw(index).recipe.sky.clouds.type for index in range(20)} == {"noise", "none"}


@pytest.mark.parametrize(
    "clouds",
    [
        "{type: cumulus, cover: 0.4}",
        "{type: noise, emission: {heat_w_per_m2: 9}}",
        "{type: noise, time_s: 60}",
        "{type: fog, file: a.nc}",
        "{type: file}",
        "{type: cumulus, wind_m_per_s: -1}",
        "{type: cumulus, sounding: {lapse_rate_k_per_km: 40}}",
        "{type: cumulus, sounding: {lapse_rate: 4}}",
        "{type: cumulus, sounding: nowhere.csv}",
        "{type: cumulus, emission: {latent_w_per_m2: 9, vapour_g_per_m2_s: 1}}",
        "{type: cumulus, domain: {extent_m: 5}}",
        "{type: fog, story: [{at_s: 0, type: cumulus}]}",
        "{story: [{at_s: 5, type: fog}]}",
        "{story: [{at_s: 0, type: fog}, {at_s: 0, type: fog}]}",
        "{type: fog, story: [{at_s: 0, type: noise}]}",
        "{story: [{at_s: 0, type: fog}], wind_m_per_s: 3}",
        "{story: []}",
        "{story: 3}",
        "cirrostratus",
        "{type: none, cover: 7}",
        "{type: none, covr: 0.7}",
    ],
)
def test_mistakes_are_told_with_their_place(write: Write, clouds: str) -> None:
    with raises_error(RecipeError, AssetError):
        load_recipe(write(), [f"sky.clouds={clouds}"])


def test_a_file_of_another_kind_holds_no_sky(write: Write) -> None:
    recipe = write()
    with raises_error(RecipeError, place="sky.clouds.file"):
        load_recipe(recipe, [f"sky.clouds={{type: file, file: {recipe.name}}}"])


def test_a_sequence_gives_each_image_its_own(write: Write) -> None:
    loaded = load_recipe(write(), ["sky.clouds={type: fog, time_s: {sequence: [1, 2, 5]}}"])
    assert [loaded.draw(index).recipe.sky.clouds.time_s for index in range(4)] == [1, 2, 5, 1]
    later = load_recipe(write(), ["sky.clouds={type: fog, time_s: {sequence: [1, 2, 5]}}", "first_image=2"])
    assert later.draw(0).recipe.sky.clouds.time_s == 5
    with raises_error(RecipeError, place="sky.clouds.time_s"):
        load_recipe(write(), ["sky.clouds={type: fog, time_s: {sequence: [1, -2]}}"])
    with raises_error(RecipeError, place="sky.clouds.time_s"):
        load_recipe(write(), ["sky.clouds={type: fog, time_s: {sequence: []}}"])
