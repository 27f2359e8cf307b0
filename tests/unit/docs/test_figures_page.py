"""The page of published figures shows every recipe of one, and a picture of each figure."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "figures.md").read_text(encoding="utf-8")
RECIPES = sorted((DOCS.parent / "recipes" / "reproductions").glob("*_fig*.yaml"))
PICTURES = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", PAGE)


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
def test_a_recipe_of_a_figure_is_on_the_page_once(recipe: Path) -> None:
    assert PAGE.count(f"](../recipes/reproductions/{recipe.name})") == 1


@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_is_there_once_and_small(picture: str) -> None:
    assert PICTURES.count(picture) == 1
    assert (DOCS / picture).stat().st_size < 400_000


def test_parts_of_a_figure_share_a_picture() -> None:
    assert len(PICTURES) == PAGE.count("\n### ") <= len(RECIPES)
