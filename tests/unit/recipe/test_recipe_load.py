from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import dump_yaml, load_recipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.recipe.schema import Recipe
from forestgen.recipe.sources import dotted, parse_yaml
from support.error_messages import raises_error

Write = Callable[..., Path]
MINIMAL = "forestgen: 1\nspecies: {oak: ./oak.yaml}\ncommunity: {model: lattice}\n"


def test_defaults_make_a_short_recipe_complete(write: Write) -> None:
    drawn = load_recipe(write(MINIMAL)).draw(0)
    recipe = drawn.recipe
    assert recipe.seed == 0
    assert [camera.name for camera in recipe.cameras] == ["camera0"]
    assert recipe.cameras[0].position_m == (50.0, 2.0, 1.7)
    assert recipe.cameras[0].height_above_ground
    assert drawn.species["oak"].plant.parameters == {"leaves": 12}
    assert (drawn.folder / "oak.yaml").is_file()


def test_shorthands_overrides_and_merging(write: Write) -> None:
    drawn = load_recipe(
        write(), ["site.terrain.amplitude_m=2", "cameras.0.size_px=[64, 32]", "species.elm.plant={leaves: 3}"]
    )
    recipe = drawn.draw(0).recipe
    assert recipe.site.terrain.kind == "rolling"
    assert recipe.site.terrain.amplitude_m == 2
    assert recipe.sky.clouds.type == "noise"
    assert recipe.cameras[0].size_px == (64, 32)
    assert recipe.cameras[1].name == "camera1"
    assert recipe.species["elm"].ecology.growth_m_per_yr == 0.1
    assert recipe.species["elm"].ecology.max_radius_m == 2.5
    assert recipe.species["elm"].plant.generator == "pole"
    assert recipe.species["elm"].plant.parameters == {"leaves": 3}
    assert recipe.species["oak"].ecology.growth_m_per_yr == 0.06


def test_override_reaches_the_default_camera_and_an_empty_section(write: Write) -> None:
    recipe = load_recipe(write(MINIMAL + "render:\n"), ["cameras.0.size_px=[64,32]", "render.samples=4"]).draw(0).recipe
    assert recipe.cameras[0].size_px == (64, 32)
    assert recipe.render.samples == 4


def test_another_generator_leaves_the_files_keys_behind(write: Write) -> None:
    drawn = load_recipe(write(), ["species.oak.plant={generator: cone, angle: 3}"]).draw(0)
    assert drawn.data["species"]["oak"]["plant"] == {"generator": "cone", "angle": 3}
    assert "set='species" in drawn.where("species", "oak", "plant", "generator")
    assert "leaves" not in drawn.data["species"]["oak"]["plant"]


def test_height_is_the_height_at_the_mature_radius(write: Write) -> None:
    species = load_recipe(write(), ["species.elm.height_m=24"]).draw(0).species["elm"]
    assert species.height_m is None
    assert float(species.allometry.height(species.ecology.max_radius_m)) == pytest.approx(24, rel=1e-12)
    assert species.mature_height_m == pytest.approx(24, rel=1e-12)


def test_places(write: Write, tmp_path: Path) -> None:
    loaded = load_recipe(write(), ["species.elm.ecology.shade_tolerance=0.5"])
    drawn = loaded.draw(0)
    recipe, species = tmp_path / "stand.yaml", tmp_path / "oak.yaml"
    assert drawn.where("site", "size_m") == f"{recipe}:5: site.size_m"
    assert drawn.where("cameras", 1, "size_px") == f"{recipe}:21: cameras.1.size_px"
    assert drawn.where("cameras", 0, "kind") == f"{recipe}:20: cameras.0.kind"
    assert drawn.where("species", "elm") == f"{recipe}:9: species.elm"
    assert drawn.where("species", "elm", "ecology", "growth_m_per_yr").startswith(f"{recipe}:13: ")
    assert drawn.where("species", "elm", "ecology", "max_radius_m").startswith(f"{species}:4: ")
    assert drawn.where("species", "elm", "plant", "leaves").startswith(f"{species}:13: ")
    assert drawn.where("species", "elm", "ecology", "shade_tolerance").startswith("`set='species.elm.ecology.shade_")


@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**63 - 1), index=st.integers(0, 10**6))
def test_a_stored_drawn_recipe_gives_the_same_image_again(write: Write, seed: int, index: int) -> None:
    drawn = load_recipe(write(), [f"seed={seed}"]).draw(index)
    text = dump_yaml(drawn)
    path = drawn.folder / "drawn.yaml"
    path.write_text(text)
    reloaded = load_recipe(path)
    again = reloaded.draw(0)
    assert again.data == drawn.data
    assert again.recipe == drawn.recipe
    assert (again.image_seed, again.image_index) == (drawn.image_seed, index)
    assert dump_yaml(again) == text
    assert reloaded.hash == recipe_hash(drawn.data) == recipe_hash(again.data)
    assert Recipe.model_validate(drawn.data) == drawn.recipe


def test_draws_are_independent_of_each_other_and_of_order(write: Write) -> None:
    loaded = load_recipe(write())
    forward = [loaded.draw(i).data for i in range(4)]
    backward = [loaded.draw(i).data for i in reversed(range(4))]
    assert forward == backward[::-1]
    assert len({data["sky"]["turbidity"] for data in forward}) == 4
    fewer = load_recipe(write(), ["sky.sun.elevation_deg=30", "species.elm.height_m={normal: [20, 1]}"])
    for i in range(4):
        assert fewer.draw(i).data["sky"]["turbidity"] == forward[i]["sky"]["turbidity"]
        assert fewer.draw(i).data["community"] == forward[i]["community"]
    assert load_recipe(write(), ["seed=8"]).draw(0).data["sky"] != forward[0]["sky"]


def test_draws_of_recipes_without_sampling_stay_as_they_are(write: Write) -> None:
    # Data sets have been made with these values.
    loaded = load_recipe(write())
    pinned = {
        0: [21.58111617556858, 194, 3.4077847526849174, 45.547424250595185, 40],
        1: [25.321324588417127, 292, 3.886671470479859, 21.725639969638287, 60],
        9: [27.20422508489365, 246, 4.862493791682137, 42.2910478247802, 60],
    }
    for index, values in pinned.items():
        assert list(loaded.draw(index).draws.values()) == values
    assert [loaded.draw(index).image_seed for index in (0, 1)] == [3998831901039839721, 231922648405703313]


def test_first_image_shifts_the_images(write: Write) -> None:
    loaded, later = load_recipe(write()), load_recipe(write(), ["first_image=5"])
    assert later.draw(1).data == loaded.draw(6).data
    assert later.draw(1).image_seed == loaded.draw(6).image_seed
    with raises_error(RecipeError):
        loaded.draw(-1)


def test_a_recipe_with_other_data_draws_from_these(write: Write) -> None:
    loaded = load_recipe(write())
    before = loaded.draw(0).recipe.render.samples
    other = replace(loaded, data={**loaded.data, "render": {"samples": before + 1}})
    assert other.draw(0).recipe.render.samples == before + 1
    assert loaded.draw(0).recipe.render.samples == before


def test_probes_cover_the_ends(write: Write) -> None:
    probes = [drawn.data for drawn in load_recipe(write()).probes()]
    assert {data["community"]["steps"] for data in probes} >= {100, 300}
    assert {data["sky"]["turbidity"] for data in probes} >= {2.0, 3.0, 6.0}


def test_hash_is_of_content_not_of_writing(write: Write) -> None:
    before = load_recipe(write()).hash
    assert load_recipe(write(RECIPE_REORDERED)).hash == before
    assert load_recipe(write(), ["seed=8"]).hash != before
    assert load_recipe(write(), ["species.elm.height_m={uniform: [18, 31]}"]).hash != before
    species = (load_recipe(write()).path.parent / "oak.yaml").read_text()
    assert load_recipe(write(species=species + "# a comment\n")).hash == before
    assert load_recipe(write(species=species.replace("0.98", "0.97"))).hash != before


RECIPE_REORDERED = """\
seed: 7.0
labels: {samples: 16}
cameras:
  - {look_at_m: [60, 70, 8.0], name: main, position_m: [60, 2, 1.7], hfov_deg: {choice: [40.0, 60]}}
  - {size_px: [320, 180], name: camera1}
species:
  oak: {from: ./oak.yaml}
  elm: {from: ./oak.yaml, ecology: {growth_m_per_yr: 0.10}, height_m: {uniform: [18.0, 30]}}
site: {terrain: {kind: rolling, amplitude_m: 0.80}, size_m: [120, 80]}
community: {program: succession, model: lattice, steps: {integers: [100, 300]}}
sky: {turbidity: {normal: {mean: 3, sd: 1, low: 2, high: 6}}, clouds: {type: noise},
      sun: {azimuth_deg: 140, elevation_deg: {uniform: [20, 60]}}}
forestgen: 1
"""


def test_hash_knows_the_order_of_species() -> None:
    assert recipe_hash({"species": {"oak": 1, "elm": 2}}) != recipe_hash({"species": {"elm": 2, "oak": 1}})


def test_hash_of_numbers() -> None:
    assert recipe_hash({"a": 1, "b": [0.0]}) == recipe_hash({"b": [-0.0], "a": 1.0})
    assert recipe_hash({"a": 1}) != recipe_hash({"a": "1"})
    assert recipe_hash({"a": 1}) != recipe_hash({"a": 1.0000000001})


class Lattice(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    program: dict[str, str]  # the loader replaces a program's name by its text
    steps: int = 10


def test_parse_validates_a_models_own_keys(write: Write) -> None:
    drawn = load_recipe(write()).draw(0)
    parsed = drawn.parse(Lattice, drawn.recipe.community.parameters, ("community",))
    assert 100 <= parsed.steps <= 300
    assert parsed.program["name"] == "succession.lsys"
    assert "lsystem: succession" in parsed.program["text"]
    bad = load_recipe(write(), ["community.step=3", "community.steps={uniform: [1, 2]}"]).draw(0)
    with raises_error(RecipeError, place="community.steps"):
        bad.parse(Lattice, bad.recipe.community.parameters, ("community",))
    assert dotted(("a", 0, "b")) == "a.0.b"


def test_anchors_and_merge_keys_are_welcome(write: Write) -> None:
    text = MINIMAL + "sky: &sky {turbidity: 4}\ncameras: [&a {name: x, hfov_deg: 30}, {<<: *a, name: y}]\n"
    recipe = load_recipe(write(text)).draw(0).recipe
    assert [(c.name, c.hfov_deg) for c in recipe.cameras] == [("x", 30), ("y", 30)]


def test_all_images_have_one_stand_where_the_recipe_says_so(write: Write) -> None:
    own = [load_recipe(write()).draw(index).image_seed for index in range(3)]
    assert len(set(own)) == 3
    override = "site.altitude_m={sequence: [0, 10, 20]}"
    loaded = load_recipe(write(), ["same_stand=true", override])
    drawn = [loaded.draw(index) for index in range(3)]
    assert [one.image_seed for one in drawn] == [own[0]] * 3
    assert [one.recipe.site.altitude_m for one in drawn] == [0.0, 10.0, 20.0]
    later = load_recipe(write(), ["same_stand=true", override, "first_image=2"]).draw(0)
    assert (later.image_seed, later.image_index, later.recipe.site.altitude_m) == (own[0], 2, 20.0)


def test_the_shipped_story_has_one_stand_and_eight_skies() -> None:
    loaded = load_recipe(Path(__file__).parents[3] / "recipes" / "weather_story.yaml")
    drawn = [loaded.draw(index) for index in range(loaded.images)]
    assert len({one.image_seed for one in drawn}) == 1
    assert len({one.recipe.sky.clouds.time_s for one in drawn}) == 8


def test_text_that_was_parsed_before_is_given_anew_each_time() -> None:
    first, sources = parse_yaml("a: [1, {b: 2}]", "one")
    first["a"][1]["b"] = 3
    sources.drop(("a",))
    again, places = parse_yaml("a: [1, {b: 2}]", "one")
    assert again == {"a": [1, {"b": 2}]}
    assert str(places.place(("a", 1, "b"))) == "one:1"
    assert str(parse_yaml("a: 1", "other")[1].place(("a",))) == "other:1"


def _species(write: Write, entry: str, *overrides: str) -> dict[str, object]:
    text = f"forestgen: 1\nspecies: {{{entry}}}\ncommunity: {{model: lattice}}\n"
    found: dict[str, object] = load_recipe(write(text), overrides).draw(0).data["species"]
    return found


def test_keys_of_a_shipped_species_alone_take_the_rest_from_it(write: Write) -> None:
    short = _species(write, "pine: {height_m: 20, ecology: {shade_tolerance: 0.3}}")
    assert short == _species(write, "pine: {from: pine, height_m: 20, ecology: {shade_tolerance: 0.3}}")
    assert _species(write, "pine: ", "species.pine.height_m=20") == _species(write, "pine: {height_m: 20}")
    assert _species(write, "pine: {from: spruce}") != _species(write, "pine: {}") == _species(write, "pine: ")
    drawn = load_recipe(write(MINIMAL.replace("{oak: ./oak.yaml}", "{pine: {height_m: {uniform: [20, 22]}}}"))).draw(0)
    assert 20 <= drawn.species["pine"].mature_height_m <= 22


def test_keys_of_a_species_that_nobody_knows_are_not_enough(write: Write) -> None:
    with raises_error(RecipeError, place="species.pinus.ecology"):
        _species(write, "pinus: {height_m: 20}")


def test_a_whole_species_under_a_shipped_name_stays_its_own(write: Write) -> None:
    whole = (write().parent / "oak.yaml").read_text().replace("\n", "\n    ")
    path = write(MINIMAL.replace("{oak: ./oak.yaml}", f"\n  oak:\n    {whole}"))
    assert load_recipe(path).draw(0).data["species"]["oak"]["plant"] == {"generator": "pole", "leaves": 12}


def test_a_number_of_a_grid_may_be_drawn(write: Write) -> None:
    """The classes keep a grid in another form than the recipe: the whole grid stands as written."""
    drawn = {"kind": "map", "map": [[0, 1], [{"uniform": [3, 4]}, 2]]}
    loaded = load_recipe(write(MINIMAL), ["site.terrain={kind: map, map: [[0, 1], [{uniform: [3, 4]}, 2]]}"])
    assert loaded.complete["site"]["terrain"]["map"] == drawn["map"]
    assert 3 <= loaded.draw(0).recipe.site.terrain.map.rows[1][0] <= 4
    assert len(loaded.hash) == 64
