"""What a drawn recipe says of labels: species in order, classes, formats, wind; and of the light its mode.

Not more of it is read, for speed.

A recipe's YAML is long for its species, whose numbers do not matter here; reading all of it takes longer than all other
checks of an image. Drawn recipes are written in block style, so sections start at a line's beginning.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError
from forestgen.dataset.check.files import read_text
from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.recipe.sources import parse_yaml

_SECTION = re.compile(r"(?m)^(?=[A-Za-z_]\w*:)")
_WANTED = ("labels", "dataset", "wind", "render")
_OTHERS = "others"  # in a class: all species that no class names


def read_recipe(root: Path, name: str) -> dict[str, Any]:
    """Sections labels, dataset, wind and render of a drawn recipe, and its species as a list of names in order."""
    try:
        recipe = parse_yaml(_excerpt(read_text(root, name)), name, error=DatasetError)[0]
    except DatasetError as error:
        raise UnreadableError(Finding(name, error.problem, error.expected or "", error.got or "")) from error
    if not isinstance(recipe, dict) or not isinstance(recipe.get("species"), dict):
        raise UnreadableError(Finding(name, "this is no drawn recipe", expected="a mapping with species"))
    sections = {key: recipe.get(key) or {} for key in _WANTED}
    for key, section in sections.items():
        if not isinstance(section, dict):
            raise UnreadableError(Finding(name, f"{key} is no section", expected="a mapping", got=str(section)[:80]))
    return {**sections, "species": [str(species) for species in recipe["species"]]}


def class_names(recipe: Mapping[str, Any]) -> list[str]:
    """Semantic class number -> name."""
    own = recipe["labels"].get("classes") or recipe["species"]
    return ["nothing", "ground", *(str(name) for name in own)]


def categories(recipe: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
    """Names of instances' categories in order, and species -> category: its class, that of others, or itself."""
    species = recipe["species"]
    classes = recipe["labels"].get("classes") or {name: [name] for name in species}
    names, found = [], {}
    for name, members in classes.items():
        named = [member for member in members if member in species]
        found.update(dict.fromkeys(named, str(name)))
        if named or _OTHERS in members:
            names.append(str(name))
    rest = [str(name) for name, members in classes.items() if _OTHERS in members and _OTHERS not in species]
    for one in species:
        if one not in found:
            found[one] = rest[0] if rest else one
            names += [] if rest else [one]
    return names, found


def _excerpt(text: str) -> str:
    """The wanted sections, and the species' names without what they are."""
    sections = {block.partition(":")[0]: block for block in _SECTION.split(text)}
    kept = [sections[key] for key in _WANTED if key in sections]
    species = sections.get("species", "")
    if species.startswith("species:\n"):
        names = re.findall(r"(?m)^  (\S[^:\n]*):", species)
        species = "species:\n" + "".join(f"  {name}:\n" for name in names)
    return "".join([species, *kept])
