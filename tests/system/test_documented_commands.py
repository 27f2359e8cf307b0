"""The examples of README, docs and recipes: each is read, and the command line and Python make equal bytes of it."""

from __future__ import annotations

import ast
import os
import shutil
from pathlib import Path
from unittest.mock import create_autospec

import pytest
from command_line import run, tiny
from documented import PAGES, ROOT, TUTORIALS, documented, in_python, parsed, python_blocks
from test_recipes import COARSE
from test_recipes import SMALL as COARSE_OF_ALL

import forestgen as fg
from forestgen.api.plants import grow_files

OF_A_RUN = ("run/", "report.html", ".forestgen/")  # names that no promise of equal bytes covers
SMALL = ["render.samples=1", "render.denoise=false", "labels.samples=1"]
NEEDS_MORE = ("--engine dask", "s3://")  # a cluster, an object store
# Files that a page's reader has: recipes of that name, and what commands before made of them.
READERS_RECIPES = {
    "stand.yaml": "community: {model: multiset_lsystem, program: succession, steps: 300}",
    "wood.yaml": "community: {model: branch_modules, steps: 96, initial_plants: 12, temperature_c: 8, "
    "precipitation_mm_per_yr: 750}",
    "meadow.yaml": "community: {model: kernel_growth, steps: 12, kernels: {poplar: inhibition}}",
}
READERS_RECIPE = """\
forestgen: 1
seed: 7
site: {{size_m: [20, 20]}}
species: {{poplar: , birch: }}
{community}
cameras: [{{position_m: [10, 1, 1.7], look_at_m: [10, 10, 2], size_px: [48, 32]}}]
"""
BEFORE = (
    "stand.yaml -o young --set community.steps=60",
    "wood.yaml -o wood --set community.history_modules=true",
    "recipes/branch_modules.yaml -o stand --set community.history_modules=true --set community.steps=20",
)


@pytest.mark.parametrize("command", documented((*PAGES, *TUTORIALS)))
def test_every_documented_command_is_one(command: str) -> None:
    name, _ = parsed(command)
    assert name


@pytest.mark.parametrize(("page", "code"), list(python_blocks()), ids=lambda value: value if len(value) < 40 else "")
def test_documented_python_names_what_there_is(page: str, code: str) -> None:
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "fg":
            assert hasattr(fg, node.attr), f"{page}: fg.{node.attr}"


def files_of(folder: Path) -> dict[str, bytes]:
    found = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    kept = {name: path for name, path in found.items() if not any(f"{one}" in name for one in OF_A_RUN)}
    return {name: path.read_bytes() for name, path in kept.items() if path.name != "manifest.json" or "train" in name}


def small(command: str, folder: Path) -> str:
    """The command with few and small images, its recipe a path from `folder`."""
    name, given = parsed(command)
    words = command.split()
    if "--count" in words:
        words[words.index("--count") + 1] = "2"
    if "--first" in words:
        words[words.index("--first") + 1] = str(min(2, given["first"]))
    if name == "simulate" and given["recipe"].parent.name == "ecoclimates":
        coarse = (*COARSE_OF_ALL, *COARSE[f"ecoclimates/{given['recipe'].stem}"])
        plain = [one.replace(", ", ",") for one in (*coarse, "site.terrain=flat") if ": " not in one]
        words += [word for one in plain for word in ("--set", one)]
    if name == "simulate" and "recipes/branch_modules.yaml" in words:
        words[-1] = "community.steps=24" if "community.steps=40" in words else words[-1]
        words += [] if "community.steps=24" in words else ["--set", "community.steps=20"]
    if name in ("render", "batch"):
        cameras = fg.load(folder / given["recipe"]).data["cameras"]
        sizes = [f"cameras.{number}.size_px=[48,32]" for number in range(len(cameras))]
        words += [word for one in (*SMALL, *sizes) for word in ("--set", one)]
    return " ".join(words)


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands name: recipes, a data set, and two pieces of one."""
    folder = tmp_path_factory.mktemp("documented")
    for name in ("recipes", "examples"):
        (folder / name).symlink_to(ROOT / name)
    for name, community in READERS_RECIPES.items():
        (folder / name).write_text(READERS_RECIPE.format(community=community), encoding="utf-8")
    tiny(folder).rename(folder / "recipe.yaml")
    recipe = fg.load(folder / "recipe.yaml")
    recipe.render(folder / "outputs/forests", count=4, progress=False)
    for name in ("quickstart", "young_stand"):
        shutil.copytree(folder / "outputs/forests", folder / "outputs" / name)
    for number, names in enumerate((("part-1", "piece-1"), ("part-2", "piece-2"))):
        for name in names:
            recipe.set({"first_image": 2 * number}).render(folder / name, count=2, progress=False)
    before = Path.cwd()
    os.chdir(folder)
    try:
        for command in BEFORE:
            answer = run("simulate", *command.split())
            assert answer.code == 0, answer.err
    finally:
        os.chdir(before)
    return folder


def runnable() -> list[str]:
    return [one for one in documented() if not any(word in one for word in NEEDS_MORE)]


@pytest.mark.parametrize("command", runnable())
def test_python_has_each_documented_command_and_argument(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fast: only the names and the number of arguments; the test below runs them."""
    for name in ("recipes", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    for name, community in READERS_RECIPES.items():
        (tmp_path / name).write_text(READERS_RECIPE.format(community=community), encoding="utf-8")
    tiny(tmp_path).rename(tmp_path / "recipe.yaml")
    monkeypatch.chdir(tmp_path)
    called = {}
    for owner, names in (
        (fg.Recipe, ("render", "batch", "simulate", "stand", "weather")),
        (fg, ("merge", "verify", "doctor")),
    ):
        for name in names:
            called[name] = create_autospec(getattr(owner, name))
            monkeypatch.setattr(owner, name, called[name])
    called["plant"], data_set = create_autospec(grow_files), create_autospec(fg.Dataset)
    called["pack"], called["report"] = data_set.return_value.pack, data_set.return_value.report
    monkeypatch.setattr("documented.grow_files", called["plant"])
    monkeypatch.setattr(fg, "Dataset", data_set)
    in_python(command)
    assert [name for name, one in called.items() if one.called] == [parsed(command)[0]]


@pytest.mark.slow
@pytest.mark.parametrize("command", runnable())
def test_the_command_line_and_python_make_equal_bytes(command: str, prepared: Path, tmp_path: Path) -> None:
    made = {}
    for way in ("command", "python"):
        folder = tmp_path / way
        shutil.copytree(prepared, folder, symlinks=True)
        before, home = files_of(folder), Path.cwd()
        os.chdir(folder)
        try:
            wanted = small(command, folder)
            if parsed(wanted)[0] in ("render", "batch", "merge", "pack", "simulate") and parsed(wanted)[1]["out"]:
                shutil.rmtree(parsed(wanted)[1]["out"], ignore_errors=True)
            if way == "command":
                answer = run(*wanted.split()[1:])
                assert answer.code == 0, answer.err
            else:
                in_python(wanted)
        finally:
            os.chdir(home)
        after = files_of(folder)
        made[way] = {name: content for name, content in after.items() if before.get(name) != content}
    assert made["command"].keys() == made["python"].keys()
    differing = [name for name in made["command"] if made["command"][name] != made["python"][name]]
    assert not differing
