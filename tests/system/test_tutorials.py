"""The tutorials, from their first block to their last: files are saved, commands and code run."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from documented import ROOT, TUTORIALS, commands_of

from support.plugin import PLUGIN, install_plugin

_BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_PRINTED = {  # among what the code of each page prints
    "detector_data_set": "4 frames in ('train', 'val')",
    "first_forest": "'poplar': ",
    "plugin": "expected  a number of at least 0.5",
    "remote_sensing_bands": "NDVI 0.35",
}


def blocks(page: Path) -> list[tuple[str, str, str]]:
    """Language, title and text of each fenced block."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_from_its_first_block_to_its_last(page: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(install_plugin(tmp_path)), "MPLBACKEND": "agg"}
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    programs: list[str] = []  # a block that imports begins one; others go on in it, as the cells of a notebook do
    for language, title, text in blocks(page):
        if title:
            path = tmp_path / title
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        elif language == "sh":
            for command in commands_of(text):
                _done([sys.executable, "-P", "-m", *shlex.split(command)], tmp_path, environment)  # as the script does
        elif language == "python" and text.startswith("import "):
            programs.append(text)
        elif language == "python":
            programs[-1] += text
    printed = "".join(_done([sys.executable, "-c", program], tmp_path, environment) for program in programs)
    assert _PRINTED[page.stem] in printed


def _done(words: list[str], folder: Path, environment: dict[str, str]) -> str:
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_models_of_the_tutorial_are_the_files_of_the_example() -> None:
    shown = {title: text for _, title, text in blocks(ROOT / "docs" / "tutorials" / "plugin.md") if title}
    assert {*shown} == {"forestgen_plantation/__init__.py", "forestgen_plantation/riverside.py"}
    for title, text in shown.items():
        assert text == (PLUGIN / title).read_text(encoding="utf-8")
        assert len(text.splitlines()) < 60
    page = (ROOT / "docs" / "tutorials" / "plugin.md").read_text(encoding="utf-8")
    for text in shown.values():
        assert f"{len(text.splitlines())} lines" in page


def test_each_module_of_the_example_has_an_entry_point_that_the_tutorial_shows() -> None:
    groups = tomllib.loads((PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    (shown,) = (text for language, _, text in blocks(ROOT / "docs" / "tutorials" / "plugin.md") if language == "toml")
    assert groups == tomllib.loads(shown)["project"]["entry-points"]
    named = {path.partition(":")[0] for group in groups.values() for path in group.values()}
    files = (PLUGIN / "forestgen_plantation").glob("*.py")
    assert named == {f"forestgen_plantation.{file.stem}".removesuffix(".__init__") for file in files}


def test_the_notebook_of_the_example_has_the_cells_of_the_tutorial() -> None:
    cells = json.loads((PLUGIN / "plantation.ipynb").read_text(encoding="utf-8"))["cells"]
    written = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    page = blocks(ROOT / "docs" / "tutorials" / "plugin.md")
    assert written == [text.rstrip() for language, title, text in page if language == "python" and not title][:4]
    assert not any(cell.get("outputs") for cell in cells)
