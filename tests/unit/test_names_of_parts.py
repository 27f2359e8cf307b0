"""Interchangeable parts are found by their registry: no other code knows one by its name."""

from __future__ import annotations

import ast
from functools import cache

import pytest

from forestgen.core.code_hash import PACKAGE
from forestgen.core.registry import Registry
from forestgen.recipe.registries import CLOUD_SOURCES, DATASET_FORMATS, GROUND_COVERS, SKIES, TERRAINS

REGISTRY = "recipe/registries.py"
PARTS = [(one, name) for one in (DATASET_FORMATS, CLOUD_SOURCES, SKIES, TERRAINS, GROUND_COVERS) for name in one]
OTHER_MEANINGS = {  # file -> names that are no part's in it, or a default
    "api/instruments.py": {"points"},  # what a list holds, for its error
    "api/points.py": {"points"},  # a parameter
    "community/fitting/recipe_text.py": {"points"},  # a key of community model strauss
    "dataset/check/merged.py": {"bop"},  # a folder, whose files the checks read by their names
    "lsystem/parsing.py": {"points"},  # a rule of the grammar
    "lsystem/statement_reader.py": {"points"},  # the same
    "recipe/schema.py": {"litter"},  # the default
    "recipe/sky.py": {"clear"},  # the default
    "recipe/suggestions.py": {"grass"},  # a species
    "recipe/terrain.py": {"flat"},  # the default
    "render/clear_view.py": {"clear"},  # a stream of random numbers
    "scene/spec.py": {"clear"},  # the default
    "scene/terrain.py": {"litter"},  # the default
    "stages/light.py": {"points"},  # a stage of the progress bar, and a key of a table
    "stages/resume.py": {"flat"},  # a history's word for ground without a height function
}
COMMON_WORDS = {"community", "file", "map", "none"}  # which only the comparison with a section's key gives away
SELECTORS = {"ground", "kind", "type"}


@cache
def trees() -> dict[str, ast.Module]:
    """File of the package -> its syntax tree."""
    files = {path.relative_to(PACKAGE).as_posix(): path for path in PACKAGE.rglob("*.py")}
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in files.items()}


@cache
def texts() -> dict[str, set[str]]:
    """File of the package -> its literal texts."""
    return {file: set(_texts(tree)) for file, tree in trees().items()}


def _texts(tree: ast.AST) -> list[str]:
    values = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return [value for value in values if isinstance(value, str)]


@cache
def compared() -> dict[str, set[str]]:
    """File of the package -> literal texts that it compares with an attribute which may name a part."""
    found = {}
    for file, tree in trees().items():
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Compare | ast.Subscript)]
        selecting = [n for n in nodes if any(isinstance(a, ast.Attribute) and a.attr in SELECTORS for a in ast.walk(n))]
        found[file] = {text for node in selecting for text in _texts(node)}
    return found


@pytest.mark.parametrize(("registry", "name"), PARTS, ids=[name for _, name in PARTS])
def test_only_a_parts_own_module_names_it(registry: Registry, name: str) -> None:
    own = registry._entries[name][0].partition(":")[0].removeprefix("forestgen.").replace(".", "/") + ".py"
    known = {REGISTRY, own} | {file for file, names in OTHER_MEANINGS.items() if name in names}
    literal = compared() if name in COMMON_WORDS else texts()
    found = {file for file, names in literal.items() if name in names}
    assert found - known == set(), f"ask the {registry.kind} {name!r} instead of naming it"
    assert {file for file, names in OTHER_MEANINGS.items() if name in names} <= found, "an exception without a cause"
