"""Interchangeable parts are found by their registry: no other code knows one by its name."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest

from forestgen.community.registry import COMMUNITY_MODELS, COMPETITION_MODELS
from forestgen.core.cache import PACKAGE
from forestgen.core.registry import Registry
from forestgen.geometry.export import MESH_EXPORTERS
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.registries import (
    BUILDINGS,
    CLOUD_SOURCES,
    DATASET_FORMATS,
    GROUND_COVERS,
    INSTRUMENTS,
    LABEL_CHANNELS,
    PACKS,
    PROJECTIONS,
    RIGS,
    SKIES,
    TERRAINS,
)

REGISTRIES = (
    DATASET_FORMATS,
    PACKS,
    COMPETITION_MODELS,
    LABEL_CHANNELS,
    CLOUD_SOURCES,
    SKIES,
    TERRAINS,
    GROUND_COVERS,
    PROJECTIONS,
    RIGS,
    INSTRUMENTS,
    GENERATORS,
    BUILDINGS,
)
# Where names of a kind are looked for, if they are common words.
FOLDERS = {"label channel": ("labels/", "dataset/", "instruments/", "pipeline.py")}
REGISTRY_FILES = {"recipe/registries.py", "community/registry.py", "plants/registry.py"}
OTHER_MEANINGS = {  # file -> names that are no part's in it, or a default
    "instruments/instrument.py": {"points"},  # what a list holds, for its error
    "labels/gap_fraction.py": {"gap_fraction"},  # a field of canopy.json
    "api/points.py": {"points"},  # a parameter
    "community/fitting/report.py": {"points"},  # a key of community model strauss
    "dataset/camera.py": {"motion"},  # a key of camera.json
    "dataset/check/frame_data.py": {"coverage", "motion"},  # a part of frame.exr; a key of camera.json
    "dataset/check/geometry.py": {"motion"},  # a part of frame.exr, and a check
    "dataset/check/light.py": {"albedo", "cloud", "sun"},  # parts of frame.exr
    "dataset/check/masks.py": {"amodal", "coverage", "module"},  # the same, and checks
    "dataset/formats/bop.py": {"amodal"},  # a channel that it needs
    "dataset/frame.py": {"albedo", "cloud", "motion", "sun"},  # parts of frame.exr
    "dataset/pack/source.py": {"albedo", "motion"},  # the same
    "dataset/report/sections.py": {"sun"},  # a key of the recipe
    "lsystem/parsing.py": {"points"},  # a rule of the grammar
    "lsystem/statements.py": {"points"},  # the same
    "recipe/ground.py": {"litter"},  # the default
    "recipe/schema.py": {"flat"},  # the same
    "recipe/sky.py": {"clear"},  # the default
    "recipe/suggestions.py": {"grass"},  # a species
    "render/views.py": {"clear"},  # a stream of random numbers
    "scene/spec.py": {"clear"},  # the default
    "scene/terrain.py": {"litter"},  # the default
    "render/metering.py": {"panorama"},  # a camera that sees the light from all sides
    "render/irradiance.py": {"perspective"},  # a plugin of the renderer
    "render/capture.py": {"perspective"},  # the same
    "instruments/light_meter.py": {"points", "sun"},  # a stage of the progress bar, and keys of a table
    "community/resume.py": {"flat"},  # a history's word for ground without a height function
}
COMMON_WORDS = {"community", "file", "map", "none"}  # which only the comparison with a section's key gives away
SELECTORS = {"ground", "kind", "type", "what"}


@cache
def trees() -> dict[str, ast.Module]:
    """File of the package -> its syntax tree."""
    files = {path.relative_to(PACKAGE).as_posix(): path for path in PACKAGE.rglob("*.py")}
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in files.items()}


MODEL_REGISTRY = "community/registry.py"
MODEL_FOLDERS = ("models", "branch_modules", "ecoclimate", "stand")  # of the models' own code, in community/
MODEL_FILES = ("community/multiset_program.py",)
OTHER_THAN_MODELS = {  # file -> names that are no community model's in it, or are one's example
    "recipe/schema.py": {"uniform"},  # the section of no plants, whatever the model
    "cli/__init__.py": {"multiset_lsystem"},  # an example of a command
    "cli/parsing.py": {"multiset_lsystem"},  # an example of a setting
    "api/plants.py": {"stand"},  # where a tree grows
    "api/plant_requests.py": {"stand"},  # the same
    "pipeline.py": {"stand"},  # a key of the manifest
    "instruments/stand_table.py": {"stand"},  # a stage of the timings
    "instruments/stand_plots.py": {"stand"},  # a word on pictures
    "cli/plant.py": {"stand"},  # the same
    "recipe/tree_sizes.py": {"stand"},
    "community/fitting/report.py": {"deformation_kernel", "stand"},  # the model that is fitted; a key
    "community/placement/model.py": {"placed"},  # a key of the statistics
    "plants/generators/branch_modules.py": {"branch_modules"},  # the plant generator
    "plants/registry.py": {"branch_modules"},  # the same
    "plants/variation/model.py": {"uniform"},  # a distribution
    "recipe/distributions.py": {"uniform"},  # the same
    "recipe/json_schema.py": {"uniform"},
    "recipe/messages.py": {"uniform"},
}


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


def own_module(registry: Registry, name: str) -> str:
    """The part's file in the package."""
    return registry._entries[name][0].partition(":")[0].replace(".", "/").removeprefix("forestgen/") + ".py"


@pytest.mark.parametrize(
    ("registry", "name"),
    [(one, name) for one in REGISTRIES for name in one],
    ids=lambda value: getattr(value, "kind", value),
)
def test_only_a_parts_own_module_names_it(registry: Registry, name: str) -> None:
    known = {file for file, names in OTHER_MEANINGS.items() if name in names}
    folders = FOLDERS.get(registry.kind, "")
    literal = compared() if name in COMMON_WORDS else texts()
    found = {file for file, own in literal.items() if name in own and file.startswith(folders)} - REGISTRY_FILES
    own = {own_module(registry, name), f"dataset/check/{name}.py"}  # where a format's checks have their names
    assert found - known <= own, f"ask the part for what it can do instead of naming {name!r}"
    assert known <= found, "an exception without a cause"


def is_of_models(file: str) -> bool:
    """Whether a file of the package belongs to community models."""
    return file in MODEL_FILES or any(file.startswith(f"community/{folder}/") for folder in MODEL_FOLDERS)


@cache
def trees_without_models() -> dict[str, ast.Module]:
    """The same of those that no community model owns."""
    return {file: tree for file, tree in trees().items() if file != MODEL_REGISTRY and not is_of_models(file)}


@cache
def code_texts() -> dict[str, set[str]]:
    """The same file -> its literal texts without docstrings, which are manual pages."""
    found = {}
    for file, tree in trees_without_models().items():
        pages = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in pages)
        found[file] = {node.value for node in constants if isinstance(node.value, str)}
    return found


@pytest.mark.parametrize("name", COMMUNITY_MODELS.ids())
def test_only_its_own_code_names_a_community_model(name: str) -> None:
    words = "_" in name or name == "ecoclimate"  # other names are ordinary words as well
    pattern = re.compile(rf"\b{name}\b" if words else rf"\A{name}\Z|\bmodel[:=] ?{name}\b")
    known = {file for file, names in OTHER_THAN_MODELS.items() if name in names}
    found = {file for file, own in code_texts().items() if any(pattern.search(text) for text in own)}
    assert found - known == set(), f"ask for a capability (forestgen.community.capabilities) instead of {name!r}"
    assert known <= found, "an exception without a cause"


def test_only_models_know_the_classes_of_their_parameters() -> None:
    classes = {COMMUNITY_MODELS.load(name).Parameters.__name__ for name in COMMUNITY_MODELS.ids()}
    assert "EcoclimateParameters" in classes
    for file, tree in trees_without_models().items():
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        names |= {one.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for one in node.names}
        assert not names & classes, f"{file} knows the parameters of a community model"


@pytest.mark.parametrize("name", list(MESH_EXPORTERS))
def test_only_a_mesh_exporters_own_module_names_it(name: str) -> None:
    clouds = {"dataset/formats/points.py", "dataset/check/points.py"} if name == "ply" else set()  # a PLY's first word
    found = {file for file, literals in texts().items() if name in literals}
    own = {"geometry/export.py", own_module(MESH_EXPORTERS, name)}
    assert found - own == clouds, "ask forestgen.geometry.export for the exporter"


@pytest.mark.parametrize(("registry", "folder"), [(GENERATORS, "plants/generators/"), (BUILDINGS, "scene/buildings/")])
def test_only_its_own_module_knows_the_class_of_a_plant_or_building(registry: Registry, folder: str) -> None:
    classes = {type(registry.load(name)).__name__ for name in registry}
    for file in trees().keys() - {own_module(registry, name) for name in registry}:
        words = set(re.findall(r"\w+", (PACKAGE / file).read_text(encoding="utf-8")))
        assert words.isdisjoint(classes), f"{file} knows a part in {folder} by its class"
