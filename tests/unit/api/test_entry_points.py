"""Parts of installed packages are found by their entry points; one that is broken harms only those who use it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from api_recipe import STAND

import forestgen as fg
from forestgen.core import registry
from forestgen.dataset.formats.format import known_formats
from support.error_messages import raises_error

MODEL = '''"""Plants of a package."""

from forestgen.community.models.uniform import Uniform


class Meadow(Uniform):
    """Plants."""


MODEL = Meadow()
'''
pytestmark = pytest.mark.usefixtures("registries_as_before")


def install(folder: Path, package: str, points: dict[tuple[str, str], str], **modules: str) -> None:
    """Put a package's metadata with entry points, (kind, name) -> place, and its modules into a folder."""
    about = folder / f"{package}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    groups = [f"[forestgen.{kind}]\n{name} = {path}\n" for (kind, name), path in points.items()]
    (about / "entry_points.txt").write_text("".join(groups), encoding="utf-8")
    for module, text in modules.items():
        (folder / f"{module}.py").write_text(text, encoding="utf-8")


def test_a_part_of_an_installed_package_is_used_without_registering(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "meadows", {("community_model", "meadow"): "meadow_model:MODEL"}, meadow_model=MODEL)
    monkeypatch.syspath_prepend(tmp_path)
    (entry,) = fg.models("meadow")
    assert entry.description == "of the package meadows 1.0"
    assert "meadow_model" not in sys.modules  # a listing imports nothing
    page, keys = entry.page.split("\n\nKeys\n----\n")
    assert page == "Plants of a package."
    assert "step_yr: " in keys
    assert "meadow" in json.dumps(fg.schema())
    assert not registry.registrations()  # who only looks does not use it
    assert len(fg.load(STAND, set={"community.model": "meadow"}).simulate(progress=False)) == 42
    (sent,) = registry.registrations()
    assert (sent.kind, sent.name, sent.path) == ("community model", "meadow", "meadow_model:MODEL")


BROKEN = {
    ("community_model", "torn"): "torn_parts:MODEL",
    ("plant_generator", "torn"): "torn_parts.absent:GENERATOR",
    ("dataset_format", "torn"): "no_such_module:FORMAT",
    ("competition_model", "torn"): "no place",
    ("label_channel", "torn"): "torn_parts:CHANNEL",
}


def test_a_broken_package_is_named_to_those_who_use_it_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "torn", BROKEN, torn_parts="1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with raises_error(fg.RecipeError, place="community.model"):
        fg.load(STAND, set={"community.model": "torn"}).validate()
    with raises_error(fg.RecipeError, place="labels.channels.0"):
        fg.load(STAND, set={"labels.channels": ["torn"]}).validate()
    for kind, name in BROKEN:
        (entry,) = fg.models(name, kind=kind)
        with raises_error(fg.RecipeError):
            assert entry.page
    assert len(fg.load(STAND).simulate(progress=False)) == 42
    fg.schema()
    assert "torn" not in {one.name for one in known_formats()}


def test_a_name_of_two_packages_is_neithers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("heaths", "meadows"):
        install(tmp_path, package, {("community_model", "meadow"): f"{package}:MODEL"}, **{package: MODEL})
    monkeypatch.syspath_prepend(tmp_path)
    with raises_error(fg.RecipeError, place="community.model"):
        fg.load(STAND, set={"community.model": "meadow"}).simulate(progress=False)


def test_no_package_takes_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "torn", {("community_model", "uniform"): "torn_parts:MODEL"}, torn_parts="1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    (entry,) = fg.models("uniform")
    assert "torn" not in entry.description
    assert len(fg.load(STAND).simulate(progress=False)) == 42


def test_entry_points_are_not_read_where_all_names_are_shipped() -> None:
    """Nor by `--help`."""
    code = (
        "import forestgen as fg; from forestgen.core import registry; from typer.testing import CliRunner\n"
        "from forestgen.cli import app\n"
        f"fg.load({STAND!r}).validate(); assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "assert registry._entry_points.cache_info().misses == 0\n"
        "fg.models(); assert registry._entry_points.cache_info().misses > 0\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
