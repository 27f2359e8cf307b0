"""A part of another package that cannot be imported does not break recipes that do not use it."""

from __future__ import annotations

import pytest

from forestgen.core import registry
from forestgen.core.errors import RecipeError
from forestgen.recipe.cameras import Camera
from forestgen.recipe.registries import PROJECTIONS, TERRAINS
from forestgen.recipe.schema import Recipe, Terrain


@pytest.fixture(autouse=True)
def _broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_registered", list(registry._registered))
    for one in (TERRAINS, PROJECTIONS):
        monkeypatch.setitem(one._entries, "broken", ("no_such_module:PART", "cannot be imported"))


def test_the_schema_and_errors_of_keys_leave_it_out() -> None:
    before = list(registry._registered)
    assert "broken" in str(Recipe.model_json_schema()["$defs"]["Terrain"])  # by its name alone
    with pytest.raises(ValueError, match="flat has no fit"):
        Terrain.model_validate({"kind": "flat", "fit": "exact"})
    with pytest.raises(ValueError, match="projection perspective has no width_m"):
        Camera.model_validate({"kind": "perspective", "width_m": 20, "position_m": (0, 0, 2), "look_at_m": (5, 5, 2)})
    assert registry._registered == before  # looking does not make a part count as used


def test_who_names_it_is_told() -> None:
    with pytest.raises((RecipeError, ValueError), match="no_such_module"):
        Terrain.model_validate({"kind": "broken"})
