"""The documentation site: it builds without warnings and without a network; what it says of the project is complete."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def build(folder: Path) -> None:
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_site_builds_without_warnings_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    build(tmp_path)
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > 60
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|iframe|link)\b[^>]*?(?:src|href)="(https?:)?//[^"]*"', text)
        assert not loaded, page
    assert "repository/recipes/ecoclimates/drought.yaml.html" in (tmp_path / "ecoclimates.html").read_text("utf-8")


def test_every_runtime_dependency_has_its_licence_listed() -> None:
    text = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")
    direct = text.partition("## Direct dependencies")[2].partition("\n## ")[0]
    listed = set(re.findall(r"^\| ([\w.-]+) \| \S", direct, re.MULTILINE)) - {"package"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert listed == {re.split(r"[^\w.-]", one)[0] for one in project["dependencies"]}
    for names in project["optional-dependencies"].values():
        assert all(re.split(r"[^\w.-]", one)[0] in text for one in names)


def test_the_citation_names_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_readme_is_one_page_with_the_first_two_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 100
    assert "\npip install uv && uv run forestgen render recipes/quickstart.yaml\nuv run pytest -n 3\n" in text
