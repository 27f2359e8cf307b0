"""The species page names every species, and says what a plant grown today is like."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from forestgen.api.plant_requests import plan_of
from forestgen.recipe.assets import list_assets

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def sheet() -> ModuleType:
    sys.path.insert(0, str(DOCS))
    try:
        spec = importlib.util.spec_from_file_location("species_sheet", DOCS / "species_sheet.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(DOCS))
    return module


@pytest.mark.parametrize("name", list_assets("species"))
def test_a_species_has_numbers_a_picture_and_a_chapter(name: str, sheet: ModuleType) -> None:
    text = (DOCS / "species.md").read_text(encoding="utf-8")
    assert f"\n## {name}\n" in text
    if name not in sheet.generate.species_that_grow_alone():
        assert f"| [{name}](#{name}) | [branch_modules](models/branch_modules_plants.md) |" in text
        return
    again = f"run `uv run python docs/species_sheet.py {name}`"
    assert name in json.loads((DOCS / "species.json").read_text(encoding="utf-8")), again
    picture = DOCS / "pictures" / "species" / f"{name}.jpg"
    assert picture.is_file(), again
    assert picture.stat().st_size <= 40_000
    assert f"](pictures/species/{name}.jpg)" in text


@pytest.mark.parametrize("name", ["fireweed", "stump", "daisy"])
def test_numbers_are_those_of_a_plant_grown_today(name: str, sheet: ModuleType) -> None:
    plan = plan_of(name, sheet.SEED)
    fresh = sheet.numbers_of(plan, sheet.mature(plan, name))
    written = sheet.generate.species_numbers()[name]
    again = f"run `uv run python docs/species_sheet.py {name}`"
    assert fresh == pytest.approx(written, rel=1e-3), again


def test_a_page_lists_no_species_that_is_gone(sheet: ModuleType) -> None:
    numbered = set(json.loads((DOCS / "species.json").read_text(encoding="utf-8")))
    assert numbered == set(sheet.generate.species_that_grow_alone())
