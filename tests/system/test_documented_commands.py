"""The examples of README, docs and recipes: each is read, and the command line and Python make equal bytes of it."""

from __future__ import annotations

import ast
import os
import shutil
from pathlib import Path

import pytest
from command_line import run, tiny
from documented import PAGES, ROOT, TUTORIALS, documented, in_python, parsed, python_blocks

import forestgen as fg

OF_A_RUN = ("run/", "report.html", ".forestgen/")  # names that no promise of equal bytes covers
SMALL = ["render.samples=1", "render.denoise=false", "labels.samples=1"]
# Commands on files that a page tells its reader to make, on a cluster, or on an object store.
NEEDS_MORE = ("--engine dask", "s3://", "wood", "meadow.yaml", "--resume ", "stand.yaml", "examples/")


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
    if name in ("render", "batch"):
        cameras = fg.load(ROOT / given["recipe"]).data["cameras"] if (ROOT / given["recipe"]).exists() else [{}]
        sizes = [f"cameras.{number}.size_px=[48,32]" for number in range(len(cameras))]
        words += [word for one in (*SMALL, *sizes) for word in ("--set", one)]
    return " ".join(words)


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands name: recipes, a data set, and two pieces of one."""
    folder = tmp_path_factory.mktemp("documented")
    (folder / "recipes").symlink_to(ROOT / "recipes")
    tiny(folder).rename(folder / "recipe.yaml")
    recipe = fg.load(folder / "recipe.yaml")
    recipe.render(folder / "outputs/forests", count=4, progress=False)
    shutil.copytree(folder / "outputs/forests", folder / "outputs/quickstart")
    for number, names in enumerate((("part-1", "piece-1"), ("part-2", "piece-2"))):
        for name in names:
            recipe.set({"first_image": 2 * number}).render(folder / name, count=2, progress=False)
    return folder


def runnable() -> list[str]:
    return [one for one in documented() if not any(word in one for word in NEEDS_MORE)]


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
