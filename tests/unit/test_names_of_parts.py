"""Interchangeable parts are found by their registry: no other code knows one by its name."""

from __future__ import annotations

import ast
from functools import cache

import pytest

from forestgen.core.code_hash import PACKAGE
from forestgen.recipe.registries import DATASET_FORMATS, PROJECTIONS

REGISTRY = "recipe/registries.py"
PARTS = {  # name -> the module of its part
    name: module.removeprefix("forestgen.").replace(".", "/") + ".py"
    for registry in (DATASET_FORMATS, PROJECTIONS)
    for name in registry
    for module in [type(registry.load(name)).__module__]
}
OTHER_MEANINGS = {  # file -> names that are no part's in it
    "api/instruments.py": {"points"},  # what a list holds, for its error
    "api/points.py": {"points"},  # a parameter
    "community/fitting/recipe_text.py": {"points"},  # a key of community model strauss
    "dataset/check/merged.py": {"bop"},  # a folder, whose files the checks read by their names
    "lsystem/parsing.py": {"points"},  # a rule of the grammar
    "lsystem/statement_reader.py": {"points"},  # the same
    "render/irradiance.py": {"perspective"},  # a plugin of the renderer
    "render/sensors.py": {"perspective"},  # the same
    "stages/light.py": {"points"},  # a stage of the progress bar, and a key of a table
}


@cache
def texts() -> dict[str, set[str]]:
    """File of the package -> its literal texts."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        values = (node.value for node in nodes if isinstance(node, ast.Constant))
        found[path.relative_to(PACKAGE).as_posix()] = {value for value in values if isinstance(value, str)}
    return found


@pytest.mark.parametrize("name", PARTS)
def test_only_a_parts_own_module_names_it(name: str) -> None:
    known = {REGISTRY, PARTS[name]} | {file for file, names in OTHER_MEANINGS.items() if name in names}
    found = {file for file, own in texts().items() if name in own}
    assert found - known == set(), f"ask the part that a registry has for {name!r} instead of naming it"
    assert {file for file, names in OTHER_MEANINGS.items() if name in names} <= found, "an exception without a cause"
