"""Maps that a recipe names: found beside it, part of its hash by their content, refused when they are others."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest
from recipe_example import SPECIES

from forestgen.core.errors import AssetError
from forestgen.dataset.writer import write_maps
from forestgen.recipe import map_files
from forestgen.recipe.load import dump_yaml, load_recipe
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
species: {oak: ./oak.yaml}
community:
  model: lattice
  plants:
    oak:
      map: maps/meadow.png
    elm:
      map: {file: other.npy, scale: 2}
    map: {count: 3}          # a species may be named so
  keep_out: path.png
"""
CONTENT = {
    "maps/meadow.png": b"\x89PNG\r\n\x1a\n meadow",
    "other.npy": b"\x93NUMPY other",
    "path.png": b"\x89PNG\r\n\x1a\n path",
}


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    folder = tmp_path / "recipes"
    (folder / "maps").mkdir(parents=True)
    (folder / "oak.yaml").write_text(SPECIES)
    for name, content in CONTENT.items():
        (folder / name).write_bytes(content)
    path = folder / "recipe.yaml"
    path.write_text(RECIPE)
    return path


def changed(path: Path, old: str, new: str) -> Path:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    return path


def community(path: Path, *overrides: str) -> dict:
    return load_recipe(path, overrides).draw(0).recipe.community.parameters


def test_every_map_is_known_by_its_content(recipe):
    found = community(recipe)
    assert found["plants"] == {
        "oak": {"map": {"file": "maps/meadow.png", "sha256": sha256(CONTENT["maps/meadow.png"])}},
        "elm": {"map": {"file": "other.npy", "scale": 2, "sha256": sha256(CONTENT["other.npy"])}},
        "map": {"count": 3},
    }
    assert found["keep_out"] == {"file": "path.png", "sha256": sha256(CONTENT["path.png"])}


def test_the_hash_is_of_the_content_wherever_it_lies(recipe):
    before = load_recipe(recipe).hash
    (recipe.parent / "maps" / "meadow.png").rename(recipe.parent / "renamed.png")
    changed(recipe, "map: maps/meadow.png", "map: {file: ../recipes/renamed.png}")
    assert load_recipe(recipe).hash == before
    (recipe.parent / "renamed.png").write_bytes(CONTENT["maps/meadow.png"][:-1] + b"x")
    assert load_recipe(recipe).hash != before


def test_scale_and_the_maps_place_in_the_recipe_are_part_of_the_hash(recipe):
    first = load_recipe(recipe).hash
    assert load_recipe(recipe, ["community.plants.elm.map.scale=3"]).hash != first
    assert load_recipe(recipe, ["community.plants.oak.map=other.npy"]).hash != first


def test_an_override_names_a_map(recipe):
    found = community(recipe, "community.plants.oak.map=path.png", "community.keep_out={file: other.npy}")
    assert found["plants"]["oak"]["map"] == {"file": "path.png", "sha256": sha256(CONTENT["path.png"])}
    assert found["keep_out"]["sha256"] == sha256(CONTENT["other.npy"])


@pytest.mark.parametrize(
    "written", ["{choice: [path.png, maps/meadow.png]}", "{file: {choice: [path.png, maps/meadow.png]}}"]
)
def test_each_image_may_have_another_map_and_the_hash_covers_all(recipe, written):
    changed(recipe, "map: maps/meadow.png", f"map: {written}")
    loaded = load_recipe(changed(recipe, "species:", "images: 20\nspecies:"))
    drawn = {loaded.draw(index).recipe.community.parameters["plants"]["oak"]["map"]["sha256"] for index in range(20)}
    assert drawn == {sha256(CONTENT["path.png"]), sha256(CONTENT["maps/meadow.png"])}
    for name in ("path.png", "maps/meadow.png"):
        (recipe.parent / name).write_bytes(CONTENT[name] + b"x")
        assert load_recipe(recipe).hash != loaded.hash
        (recipe.parent / name).write_bytes(CONTENT[name])
    assert load_recipe(recipe).hash == loaded.hash


def test_no_file_is_read_twice(recipe, monkeypatch):
    read: list[Path] = []
    digest = map_files.file_sha256
    monkeypatch.setattr(map_files, "file_sha256", lambda path, *named: read.append(path) or digest(path, *named))
    loaded = load_recipe(changed(recipe, "species:", "images: 9\nspecies:"))
    for index in range(9):
        loaded.draw(index)
    assert loaded.hash
    assert len(read) == 3


def test_a_stored_recipe_takes_its_maps_along(recipe, tmp_path):
    """Written with an image, moved, loaded again: the same recipe; and stored again the same bytes."""
    drawn = load_recipe(recipe).draw(0)
    texts = []
    folder, data = recipe.parent, drawn.data
    for number in (1, 2):
        root = tmp_path / f"run{number}"
        (root / "000000-camera0").mkdir(parents=True)
        stored = write_maps(root, data, folder)
        text = dump_yaml(type(drawn)(**{**drawn.__dict__, "data": stored}))
        (root / "000000-camera0" / "recipe.yaml").write_text(text)
        texts.append(text)
        assert sorted(one.name for one in (root / "maps").iterdir()) == sorted(
            f"{sha256(content)[:16]}{Path(name).suffix}" for name, content in CONTENT.items()
        )
        shutil.rmtree(folder)
        moved = (tmp_path / f"moved{number}").absolute()
        root.rename(moved)
        again = load_recipe(moved / "000000-camera0" / "recipe.yaml")
        folder, data = again.path.parent, again.draw(0).data
        folder_content = {one.read_bytes() for one in (moved / "maps").iterdir()}
        assert folder_content == set(CONTENT.values())
    assert texts[0] == texts[1]
    assert "/recipes/" not in texts[0]


def test_a_recipe_without_maps_has_no_folder_of_them(tmp_path):
    data = {"community": {"model": "lattice", "plants": {"oak": {"map": [[1]]}}}}
    assert write_maps(tmp_path, data, tmp_path) == data
    assert not list(tmp_path.iterdir())


def test_a_map_that_changes_while_images_are_made_is_refused(recipe, tmp_path):
    drawn = load_recipe(recipe).draw(0)
    (recipe.parent / "path.png").write_bytes(CONTENT["path.png"] + b"x")
    with raises_error(AssetError, place="path.png"):
        write_maps(tmp_path, drawn.data, recipe.parent)


def test_a_map_of_other_content_is_refused(recipe):
    changed(recipe, "keep_out: path.png", f"keep_out: {{file: path.png, sha256: {sha256(b'other')}}}")
    with raises_error(AssetError, place="community.keep_out.file") as caught:
        load_recipe(recipe)
    assert sha256(CONTENT["path.png"])[:16] in str(caught.value)


@pytest.mark.parametrize(("old", "new"), [
    ("maps/meadow.png", "maps/medow.png"),
    ("other.npy", "no/other.npy"),
    ("path.png", "maps"),
    ("path.png", "/dev/zero"),
    ("path.png", "n" * 300),
    ("path.png", "{choice: [path.png, none.png]}")
])  # fmt: skip
def test_a_missing_map_is_named(recipe, old, new):
    changed(recipe, old, new)
    with raises_error(AssetError):
        load_recipe(recipe)


def test_a_map_in_the_folder_where_the_user_is(recipe, tmp_path, monkeypatch):
    (tmp_path / "here.png").write_bytes(b"x")
    monkeypatch.chdir(tmp_path)
    with raises_error(AssetError, place="community.plants.oak.map"):
        load_recipe(recipe, ["community.plants.oak.map=here.png"])


def test_a_shipped_map_is_no_recipe(tmp_path, monkeypatch):
    from forestgen.recipe import assets

    (tmp_path / "meadow.png").touch()
    (tmp_path / "meadow.yaml").touch()
    monkeypatch.setattr(assets, "recipes_dir", lambda: tmp_path)
    assert assets.list_assets("recipes") == ["meadow"]


def test_the_file_of_another_packages_part_is_part_of_the_hash_and_goes_along(recipe, tmp_path):
    """Wherever it stands; here below a key of a community model, and among a list of its sections."""
    (recipe.parent / "wind.csv").write_text("m,m_per_s\n10,3\n")
    (recipe.parent / "soil.json").write_text("[1]")
    given = ["community.storms=[{profile: {file: wind.csv}}]", "community.layers={file: soil.json}"]
    before = load_recipe(recipe, given)
    drawn = before.draw(0)
    profile = drawn.data["community"]["storms"][0]["profile"]
    assert profile == {"file": "wind.csv", "sha256": sha256(b"m,m_per_s\n10,3\n")}
    assert map_files.RecipeFile(**profile).path(recipe.parent) == recipe.parent / "wind.csv"
    stored = write_maps(tmp_path / "run", drawn.data, recipe.parent)
    assert stored["community"]["layers"]["file"] == f"../maps/{sha256(b'[1]')[:16]}.json"
    assert (tmp_path / "run" / "maps" / f"{profile['sha256'][:16]}.csv").exists()
    (recipe.parent / "wind.csv").write_text("m,m_per_s\n10,4\n")
    assert load_recipe(recipe, given).hash != before.hash
    with raises_error(AssetError):
        map_files.RecipeFile(**profile).path(recipe.parent)
