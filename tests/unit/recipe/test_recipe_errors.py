"""Every way to get a recipe wrong ends in an error of ours that says where, expected and got."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recipe_example import RECIPE

from forestgen.core.errors import AssetError, ForestgenError, RecipeError
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

Write = Callable[..., Path]
HEAD = "forestgen: 1\nspecies: {oak: ./oak.yaml}\ncommunity: {model: lattice}\n"
BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"# only a comment\n",
        b"null\n",
        b"[1, 2]\n",
        b"just text\n",
        b"a: [1\n",
        b"a: 1\n\tb: 2\n",
        b"a: *nowhere\n",
        b"a: 1\n---\nb: 1\n",
        b"a: \x01\n",
        b"\x89PNG\r\n\x1a\n\x00",
        "größe: 1\n".encode("latin-1"),
        b"\xff\xfea\x00:\x00",
        b"seed: 1\nseed: 2\n",
        b"a: {b: 1, b: 2}\n",
        b"true: 2\n",
        b"? [a]\n: 2\n",
        b"a: !!python/object:os.system x\n",
        b"a: !mine x\n",
        b"a: &a [*a]\n",
        b"a: " + b"[" * 5000,
        b"a: " + b"[" * 60 + b"]" * 60,
        BOMB.encode(),
        b"a: .nan\n",
        b"a: -.inf\n",
        b"a: " + b"9" * 5000,
        b"a: 0x" + b"f" * 5000,
        b'a: "\\ud800"\n',
        b"<<: 3\n",
        b"#" * 10_000_001,
        b"seed: 3\n",
        b"forestgen: 2\n",
        b"forestgen: true\n",
        b"forestgen: {uniform: [1, 2]}\n",
    ],
    ids=lambda value: None if isinstance(value, str) else repr(value[:20]),
)
def test_unreadable_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with raises_error(RecipeError, AssetError) as caught:
        load_recipe(path)
    assert caught.value.exit_code == 2


def test_places_that_are_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("missing.yaml", "", "x" * 5000, "nul\0"):
        with pytest.raises((RecipeError, AssetError)):
            load_recipe(tmp_path / name)
    with raises_error(AssetError):
        load_recipe(tmp_path)
    (tmp_path / "shipped.yaml").write_text(HEAD)
    monkeypatch.setattr("forestgen.recipe.assets.recipes_dir", lambda: tmp_path)
    monkeypatch.setattr("forestgen.recipe.load.recipes_dir", lambda: tmp_path)
    with raises_error(AssetError, place="shipped"):
        load_recipe("shipped")


def test_duplicate_keys_name_both_lines(tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("forestgen: 1\nseed: 1\nimages: 2\nseed: 2\n")
    with raises_error(RecipeError, place="twice.yaml:4"):
        load_recipe(path)


@pytest.mark.parametrize(
    "override",
    [
        "site.size_m=[0, 5]",
        "site.size_m=[6000, 5]",
        "site.size_m=[5]",
        "site.size_m=[5, 6, 7]",
        "site.size_m=5",
        "site.size_m=['5', 6]",
        "site.size_m=[true, 6]",
        "site.terrain=hills",
        "site.terrain={kin: flat}",
        "sede=3",
        "seed=-1",
        "seed=1.5",
        "seed={uniform: [1, 2]}",
        "images=0",
        "species={}",
        "species=3",
        "species.a b=poplar",
        "species.oak=3",
        "species.elm={height_m: 3}",
        "species.oak={from: 3}",
        "species.oak={from: ./none.yaml}",
        "species.oak={from: poplr}",
        "species.elm.frm=oak",
        "species.elm.height_m=500",
        "species.elm.ecology.old_age_survival=1.5",
        "species.elm.allometry.width_m.scale=0",
        "species.oak={from: ./oak.yaml, allometry: {height_m: {scale: 900}}}",
        "species.elm.materials.leaf.reflectance=[0.95, 0, 0]",
        "species.elm.plant.generator=3",
        "community=null",
        "community={steps: 3}",
        "sky.sun.elevation_deg=-91",
        "sky.turbidity=11",
        "sky.clouds=altostratus",
        "cameras=[]",
        "cameras=3",
        "cameras.0.size_px=[7, 100]",
        "cameras.0.size_px=[100000, 100]",
        "cameras.0.look_at_m=[60, 2, 1.7]",
        "cameras.0.name=a/b",
        "cameras.1.name=MAIN",
        "cameras.7.name=x",
        "cameras.x.name=x",
        "render.samples=0",
        "render.samples=1e9",
        "render.denoise=yes",
        "labels.samples=15",
        "render.samples={uniform: [1, 4]}",
        "render.samples={integers: [0, 4]}",
        "sky.turbidity={uniform: [9, 10.5]}",
        "sky.turbidity={choice: [3, 3, 3, 3, 3, 3, 3, 30]}",
        "sky.turbidity={normal: [3]}",
        "sky.turbidity={normal: [3, 0]}",
        "sky.turbidity={normal: {mean: 3, sd: 1, low: 90}}",
        "sky.turbidity={unifrom: [3, 4]}",
        "sky.turbidity={lognormal: [-3, 1]}",
        "sky.turbidity={uniform: [4, 3]}",
        "sky.turbidity={choice: []}",
        "sky.turbidity={choice: [[3]]}",
        "sky={uniform: [1, 2]}",
        "species={choice: [1, 2]}",
        "seed.x=3",
        "seed",
        "=3",
        "a..b=3",
        "seed=[",
        "seed={a: 1, a: 2}",
        "forestgen=9",
    ],
)
def test_bad_values(write: Write, override: str) -> None:
    with raises_error(RecipeError, AssetError) as caught:
        load_recipe(write(), [override])
    message = str(caught.value)
    for jargon in ("Input should", "pydantic", "validation error", "type="):
        assert jargon not in message


def test_several_mistakes_in_one_message_with_their_lines(write: Write, tmp_path: Path) -> None:
    path = write(
        RECIPE, ("[120, 80]", "[120, -5]"), ("seed: 7", "seeds: 7"), ("./oak.yaml\n  elm", "./oak.yaml\n  elm")
    )
    (tmp_path / "oak.yaml").write_text((tmp_path / "oak.yaml").read_text().replace("2.5", "0"))
    with raises_error(RecipeError, place="seeds"):
        load_recipe(path)


def test_many_mistakes_are_cut(write: Write) -> None:
    with raises_error(RecipeError, place="wrong0") as caught:
        load_recipe(write(), [f"wrong{i}=1" for i in range(75)])
    assert str(caught.value).count("unknown key") == 50
    assert len(caught.value.errors) == 75


def test_a_bad_species_file_is_an_assets_error(write: Write) -> None:
    with raises_error(AssetError, place="oak.yaml:2"):
        load_recipe(write(species="a: 1\na: 2\n"))


def test_an_unbounded_draw_outside_the_schema_says_how_to_bound_it(write: Write) -> None:
    loaded = load_recipe(write(), ["sky.turbidity={normal: [2, 0.5]}"])
    with raises_error(RecipeError, place="sky.turbidity"):
        [loaded.draw(i) for i in range(500)]


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
KEYS = [
    "seed", "site", "site.size_m", "site.size_m.0", "site.terrain", "species", "species.oak", "species.elm.height_m",
    "species.elm.plant", "species.oak.materials.x", "community", "community.x", "sky.clouds", "cameras", "cameras.0",
    "cameras.1.position_m", "render", "labels.samples", "forestgen", "images", "first_image",
]  # fmt: skip


A_CHANGE = given(key=st.sampled_from(KEYS), value=VALUES, text=st.text(max_size=20), as_text=st.booleans())
THE_SAME = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


@settings(THE_SAME, max_examples=50)
@A_CHANGE
def test_no_value_makes_a_traceback(write: Write, key: str, value: object, text: str, as_text: bool) -> None:
    no_traceback(write, key, value, text, as_text)


@pytest.mark.slow
@settings(THE_SAME, max_examples=600)
@A_CHANGE
def test_none_of_many_values_makes_a_traceback(write: Write, key: str, value: object, text: str, as_text: bool) -> None:
    no_traceback(write, key, value, text, as_text)


def no_traceback(write: Write, key: str, value: object, text: str, as_text: bool) -> None:
    try:
        loaded = load_recipe(write(), [f"{key}={text if as_text else value!r}"])
    except ForestgenError:
        return
    assert len(loaded.hash) == 64
