"""Every way to get a recipe wrong ends in an error of ours that says where, expected and got."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recipe_example import RECIPE

from forestgen.core.errors import AssetError, ForestgenError, RecipeError
from forestgen.recipe.load import load_recipe

Write = Callable[..., Path]
HEAD = "forestgen: 1\nspecies: {oak: ./oak.yaml}\ncommunity: {model: lattice}\n"
BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "text is empty"),
        (b"# only a comment\n", "text is empty"),
        (b"null\n", "text is empty"),
        (b"[1, 2]\n", "not a mapping"),
        (b"just text\n", "not a mapping"),
        (b"a: [1\n", "not valid YAML"),
        (b"a: 1\n\tb: 2\n", "not valid YAML"),
        (b"a: *nowhere\n", "not valid YAML"),
        (b"a: 1\n---\nb: 1\n", "not valid YAML"),
        (b"a: \x01\n", "not a text file"),
        (b"\x89PNG\r\n\x1a\n\x00", "not a text file"),
        ("größe: 1\n".encode("latin-1"), "not a text file"),
        (b"\xff\xfea\x00:\x00", "not a text file"),
        (b"seed: 1\nseed: 2\n", "stands twice"),
        (b"a: {b: 1, b: 2}\n", "stands twice"),
        (b"1: 2\n", "a key must be text"),
        (b"? [a]\n: 2\n", "a key must be text"),
        (b"a: !!python/object:os.system x\n", "tag is not allowed"),
        (b"a: !mine x\n", "tag is not allowed"),
        (b"a: &a [*a]\n", "nested too deeply"),
        (b"a: " + b"[" * 5000, "nested too deeply"),
        (b"a: " + b"[" * 60 + b"]" * 60, "nested too deeply"),
        (BOMB.encode(), "too many values by aliases"),
        (b"a: .nan\n", "bad value"),
        (b"a: -.inf\n", "bad value"),
        (b"a: " + b"9" * 5000, "not a number"),
        (b"a: 0x" + b"f" * 5000, "bad value"),
        (b'a: "\\ud800"\n', "not a text"),
        (b"<<: 3\n", "takes a mapping"),
        (b"#" * 10_000_001, "too large"),
        (b"seed: 3\n", "unknown version"),
        (b"forestgen: 2\n", "newer forestgen"),
        (b"forestgen: true\n", "unknown version"),
        (b"forestgen: {uniform: [1, 2]}\n", "unknown version"),
    ],
    ids=lambda value: None if isinstance(value, str) else repr(value[:20]),
)
def test_unreadable_files(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with pytest.raises((RecipeError, AssetError)) as caught:
        load_recipe(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert caught.value.exit_code == 2


def test_places_that_are_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("missing.yaml", "", "x" * 5000, "nul\0"):
        with pytest.raises((RecipeError, AssetError)):
            load_recipe(tmp_path / name)
    with pytest.raises(AssetError, match="folder"):
        load_recipe(tmp_path)
    (tmp_path / "shipped.yaml").write_text(HEAD)
    monkeypatch.setattr("forestgen.recipe.assets.recipes_dir", lambda: tmp_path)
    monkeypatch.setattr("forestgen.recipe.load.recipes_dir", lambda: tmp_path)
    with pytest.raises(AssetError, match=re.escape(f"{tmp_path / 'shipped.yaml'}")):
        load_recipe("shipped")


def test_duplicate_keys_name_both_lines(tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("forestgen: 1\nseed: 1\nimages: 2\nseed: 2\n")
    with pytest.raises(RecipeError) as caught:
        load_recipe(path)
    assert f"{path}:4: " in str(caught.value)
    assert f"{path}:2" in str(caught.value)


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("site.size_m=[0, 5]", ["site.size_m.0", "a number greater than 0"]),
        ("site.size_m=[6000, 5]", ["at most 5000"]),
        ("site.size_m=[5]", ["site.size_m", "a list of 2 entries", "[5]"]),
        ("site.size_m=[5, 6, 7]", ["a list of 2 entries"]),
        ("site.size_m=5", ["a list", "5"]),
        ("site.size_m=['5', 6]", ["a number", "remove the quotes"]),
        ("site.size_m=[true, 6]", ["a number", "true"]),
        ("site.terrain=hills", ["site.terrain.kind", "one of flat, map, rolling", "'hills'"]),
        ("site.terrain={kin: flat}", ["unknown key 'kin'", "did you mean 'kind'"]),
        ("sede=3", ["unknown key 'sede'", "did you mean 'seed'"]),
        ("seed=-1", ["seed", "at least 0"]),
        ("seed=1.5", ["a whole number"]),
        ("seed={uniform: [1, 2]}", ["may not be a distribution"]),
        ("images=0", ["at least 1"]),
        ("species={}", ["species", "at least 1 entry"]),
        ("species=3", ["a mapping"]),
        ("species.a b=poplar", ["name"]),
        ("species.oak=3", ["species.oak", "a mapping"]),
        ("species.elm={height_m: 3}", ["'ecology' is missing", "from: NAME"]),
        ("species.oak={from: 3}", ["name or path of a species file"]),
        ("species.oak={from: ./none.yaml}", ["species.oak.from", "none.yaml"]),
        ("species.oak={from: poplr}", ["did you mean 'poplar'", "spruce"]),
        ("species.elm.frm=oak", ["unknown key 'frm'", "did you mean 'from'"]),
        ("species.elm.height_m=500", ["at most 200"]),
        ("species.elm.ecology.old_age_survival=1.5", ["at most 1"]),
        ("species.elm.allometry.width_m.scale=0", ["greater than 0"]),
        ("species.oak={from: ./oak.yaml, allometry: {height_m: {scale: 900}}}", ["mature height", "at most 200"]),
        ("species.elm.materials.leaf.reflectance=[0.95, 0, 0]", ["more light leaves", "0.95 + 0.1 in red"]),
        ("species.elm.plant.generator=3", ["text"]),
        ("community=null", ["community"]),
        ("community={steps: 3}", ["'model' is missing"]),
        ("sky.sun.elevation_deg=0", ["greater than 0"]),
        ("sky.turbidity=11", ["at most 10"]),
        ("sky.clouds=altostratus", ["sky.clouds.type", "cumulus", "noise, none", "did you mean 'stratus'"]),
        ("cameras=[]", ["at least 1 entry"]),
        ("cameras=3", ["a list"]),
        ("cameras.0.size_px=[7, 100]", ["at least 8"]),
        ("cameras.0.size_px=[100000, 100]", ["at most 16384"]),
        ("cameras.0.look_at_m=[60, 2, 1.7]", ["looks at itself"]),
        ("cameras.0.name=a/b", ["letters, digits"]),
        ("cameras.1.name=MAIN", ["two cameras of one name"]),
        ("cameras.7.name=x", ["no such entry"]),
        ("cameras.x.name=x", ["no such entry"]),
        ("render.samples=0", ["at least 1"]),
        ("render.samples=1e9", ["at most 65536"]),
        ("render.denoise=yes", ["true or false"]),
        ("labels.samples=15", ["a square number"]),
        ("render.samples={uniform: [1, 4]}", ["{integers: [a, b]}"]),
        ("render.samples={integers: [0, 4]}", ["at least 1"]),
        ("sky.turbidity={uniform: [9, 10.5]}", ["at most 10", "from {uniform: [9, 10.5]}"]),
        ("sky.turbidity={choice: [3, 3, 3, 3, 3, 3, 3, 30]}", ["at most 10"]),
        ("sky.turbidity={normal: [3]}", ["bad distribution", "mean"]),
        ("sky.turbidity={normal: [3, 0]}", ["sd greater than 0"]),
        ("sky.turbidity={normal: {mean: 3, sd: 1, low: 90}}", ["mass"]),
        ("sky.turbidity={unifrom: [3, 4]}", ["did you mean {uniform"]),
        ("sky.turbidity={lognormal: [-3, 1]}", ["median greater than 0"]),
        ("sky.turbidity={uniform: [4, 3]}", ["low at most high"]),
        ("sky.turbidity={choice: []}", ["1 to 10000"]),
        ("sky.turbidity={choice: [[3]]}", ["a number", "[3], from {choice: [[3]]}"]),
        ("sky={uniform: [1, 2]}", ["a mapping"]),
        ("species={choice: [1, 2]}", ["a mapping"]),
        ("seed.x=3", ["no key 'x'"]),
        ("seed", ["key.path=value"]),
        ("=3", ["key.path=value"]),
        ("a..b=3", ["key.path=value"]),
        ("seed=[", ["not valid YAML"]),
        ("seed={a: 1, a: 2}", ["stands twice"]),
        ("forestgen=9", ["newer forestgen"]),
    ],
)
def test_bad_values(write: Write, override: str, parts: list[str]) -> None:
    with pytest.raises((RecipeError, AssetError)) as caught:
        load_recipe(write(), [override])
    message = str(caught.value)
    for part in (*parts, "set='" + override[:40]):
        assert part in message
    for jargon in ("Input should", "pydantic", "validation error", "type="):
        assert jargon not in message


def test_several_mistakes_in_one_message_with_their_lines(write: Write, tmp_path: Path) -> None:
    path = write(
        RECIPE, ("[120, 80]", "[120, -5]"), ("seed: 7", "seeds: 7"), ("./oak.yaml\n  elm", "./oak.yaml\n  elm")
    )
    (tmp_path / "oak.yaml").write_text((tmp_path / "oak.yaml").read_text().replace("2.5", "0"))
    with pytest.raises(RecipeError) as caught:
        load_recipe(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:3: seeds: unknown key 'seeds'")
    assert f"\n\n{path}:5: site.size_m.1: bad value\n  expected  a number greater than 0\n  got       -5\n\n" in message
    assert message.endswith("\n\n4 errors")
    assert "oak.yaml:4: species.oak.ecology.max_radius_m" in message
    assert "oak.yaml:4: species.elm.ecology.max_radius_m" in message


def test_many_mistakes_are_cut(write: Write) -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe(write(), [f"wrong{i}=1" for i in range(75)])
    assert str(caught.value).count("unknown key") == 50
    assert str(caught.value).endswith("... and 25 more\n\n75 errors")
    assert len(caught.value.errors) == 75


def test_a_bad_species_file_is_an_assets_error(write: Write) -> None:
    with pytest.raises(AssetError, match=r"oak\.yaml:2"):
        load_recipe(write(species="a: 1\na: 2\n"))


def test_an_unbounded_draw_outside_the_schema_says_how_to_bound_it(write: Write) -> None:
    loaded = load_recipe(write(), ["sky.turbidity={normal: [2, 0.5]}"])
    with pytest.raises(RecipeError, match="truncate the distribution") as caught:
        [loaded.draw(i) for i in range(500)]
    assert "from {normal: [2, 0.5]}" in str(caught.value)


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
