from __future__ import annotations

from pathlib import Path

import pytest

from forestgen.core.errors import AssetError
from forestgen.recipe import assets
from support.error_messages import raises_error


def test_shipped_species_are_found_and_listed() -> None:
    names = assets.list_assets("species")
    assert "poplar" in names
    assert names == sorted(names)
    assert assets.find_asset("species", "poplar") == assets.scenes_dir() / "species" / "poplar.yaml"
    assert assets.list_assets("nothing of the kind") == []


def test_a_path_is_relative_to_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("a: 1\n")
    assert assets.find_asset("species", "own.yaml", folder=tmp_path) == tmp_path / "own.yaml"
    assert assets.find_asset("species", "./own.yaml", folder=tmp_path) == tmp_path / "./own.yaml"
    assert assets.find_asset("species", str(tmp_path / "own.yaml")) == tmp_path / "own.yaml"
    for missing in ("./other.yaml", "other.yaml", "a/b", "nul\0/x"):
        with raises_error(AssetError):
            assets.find_asset("species", missing, folder=tmp_path)


def test_a_missing_name_lists_what_exists() -> None:
    with raises_error(AssetError, place="species.x.from"):
        assets.find_asset("species", "popler", where="a.yaml:3: species.x.from")


def test_an_installed_wheel_has_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets, "PACKAGE", tmp_path / "forestgen")
    with raises_error(AssetError):
        assets.scenes_dir()
    installed = tmp_path / "forestgen" / "_data" / "scenes"
    installed.mkdir(parents=True)
    assert assets.scenes_dir() == installed
    assert assets.list_assets("species") == []


def test_recipes_in_folders_are_listed_and_found(tmp_path: Path) -> None:
    names = assets.list_assets("recipes")
    assert names.index("quickstart") < names.index("reproductions/domination_test")
    path = assets.recipes_dir() / "reproductions" / "domination_test.yaml"
    assert assets.find_asset("recipes", "reproductions/domination_test") == path
    (tmp_path / "reproductions").mkdir()
    own = tmp_path / "reproductions" / "domination_test"
    own.write_text("a: 1\n")
    assert assets.find_asset("recipes", "reproductions/domination_test", folder=tmp_path) == own
