"""Interchangeable parts are found by their registry: no other code knows one by its name."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from forestgen.core.code_hash import PACKAGE
from forestgen.recipe.registries import DATASET_FORMATS

REGISTRY = "recipe/registries.py"
OTHER_MEANINGS = {  # file -> names that are no format's in it
    "api/instruments.py": {"points"},  # what a list holds, for its error
    "api/points.py": {"points"},  # a parameter
    "community/fitting/recipe_text.py": {"points"},  # a key of community model strauss
    "dataset/check/merged.py": {"bop"},  # a folder, whose files the checks read by their names
    "lsystem/parsing.py": {"points"},  # a rule of the grammar
    "lsystem/statement_reader.py": {"points"},  # the same
    "stages/light.py": {"points"},  # a stage of the progress bar, and a key of a table
}


def texts_of(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


@pytest.mark.parametrize("name", list(DATASET_FORMATS))
def test_only_a_formats_own_module_names_it(name: str) -> None:
    known = {REGISTRY, f"dataset/formats/{name}.py"}
    known |= {file for file, names in OTHER_MEANINGS.items() if name in names}
    found = {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if name in texts_of(path)}
    assert found - known == set(), f"ask forestgen.dataset.formats.format for {name!r} instead of naming it"
    assert {file for file, names in OTHER_MEANINGS.items() if name in names} <= found, "an exception without a cause"
