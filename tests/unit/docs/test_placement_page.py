"""Every recipe of docs/placement.md is accepted, and every picture that it shows is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from ruamel.yaml import YAML

from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "placement.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
PICTURES = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", PAGE)
LINKS = re.findall(r"(?<!!)\[[^\]]+\]\(([^)#]+)(?:#[^)]*)?\)", PAGE)
BASE = {
    "forestgen": 1,
    "seed": 1,
    "site": {"size_m": [30, 30]},
    "species": {"fireweed": None, "poplar": None, "spruce": None},
    "cameras": [{"position_m": [15, -8, 2]}],
}


def recipe_of(example: str) -> dict[str, Any]:
    """An example as a whole recipe; keys of a community alone are those of deformation_kernel."""
    keys = YAML(typ="safe").load(example)
    if "community" in keys:
        return {**BASE, **keys}
    return {**BASE, "community": {"model": "deformation_kernel", "plants": {"spruce": {"count": 9}}, **keys}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("meadow.png", "path.png"):
        Image.fromarray(np.tri(30, 30, -8, dtype=np.uint8) * 255).save(tmp_path / name)
    return tmp_path


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_accepted(example: str, folder: Path) -> None:
    path = folder / "recipe.yaml"
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe").dump(recipe_of(example), stream)
    plan = check_plan(load_recipe(path), simulate_only=True)
    assert (
        plan.community.model.empty_reason(plan.community.parameters, plan.community.site, plan.community.ecologies)
        is None
    )


def test_the_page_has_examples() -> None:
    assert len(EXAMPLES) >= 10


@pytest.mark.parametrize("path", [*PICTURES, *LINKS])
def test_what_the_page_shows_and_links_is_there(path: str) -> None:
    assert (DOCS / path).is_file()


def test_its_pictures_are_small() -> None:
    for path in PICTURES:
        assert (DOCS / path).stat().st_size < 400_000, path
