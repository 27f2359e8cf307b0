"""Interchangeable parts are found by their registry: no other code knows one by its name."""

from __future__ import annotations

import ast
from functools import cache

import pytest

from forestgen.core.code_hash import PACKAGE
from forestgen.geometry.export import MESH_EXPORTERS
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


@cache
def texts() -> dict[str, set[str]]:
    """File of the package -> its literal texts."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        values = (node.value for node in nodes if isinstance(node, ast.Constant))
        found[path.relative_to(PACKAGE).as_posix()] = {value for value in values if isinstance(value, str)}
    return found


@pytest.mark.parametrize("name", list(DATASET_FORMATS))
def test_only_a_formats_own_module_names_it(name: str) -> None:
    known = {REGISTRY, f"dataset/formats/{name}.py"}
    known |= {file for file, names in OTHER_MEANINGS.items() if name in names}
    found = {file for file, own in texts().items() if name in own}
    assert found - known == set(), f"ask forestgen.dataset.formats.format for {name!r} instead of naming it"
    assert {file for file, names in OTHER_MEANINGS.items() if name in names} <= found, "an exception without a cause"


@pytest.mark.parametrize("name", list(MESH_EXPORTERS))
def test_only_a_mesh_exporters_own_module_names_it(name: str) -> None:
    own = type(MESH_EXPORTERS.load(name)).__module__.removeprefix("forestgen.").replace(".", "/") + ".py"
    clouds = {"dataset/formats/points.py", "dataset/check/points.py"} if name == "ply" else set()  # a PLY's first word
    found = {file for file, literals in texts().items() if name in literals}
    assert found - {"geometry/export.py", own} == clouds, "ask forestgen.geometry.export for the exporter"
