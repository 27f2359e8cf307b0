"""Stand-ins for the sections of a recipe that are wrong, so that the others can be checked all the same."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from forestgen.recipe.assets import find_asset
from forestgen.recipe.schema import SCHEMA_VERSION, Recipe
from forestgen.recipe.sources import Keys
from forestgen.recipe.yaml_source import read_yaml

_SPECIES = "poplar"  # a shipped one, small and whole


def sections_of(where: str) -> Keys:
    """Section and, of species, name that an error's place names, such as ``stand.yaml:7: species.oak.ecology``."""
    keys = where.rpartition(": ")[2].split(".")
    return tuple(keys[:2] if keys[0] == "species" else keys[:1])


def replace_sections(data: dict[str, Any], wrong: Iterable[Keys]) -> frozenset[str]:
    """Replace in place what key paths name: by defaults, or where there are none by something that the schema takes.

    Returns
    -------
    frozenset : the sections that hold a stand-in now.
    """
    replaced = set()
    for keys in wrong:
        section = str(keys[0]) if keys else ""
        if section not in data and section not in Recipe.model_fields:
            continue
        replaced.add(section)
        if section == "species":
            _replace_species(data, keys)
        elif section == "community":
            data[section] = {"model": "none"}
        elif section == "forestgen":
            data[section] = SCHEMA_VERSION
        else:
            data.pop(section, None)
    return frozenset(replaced)


def _replace_species(data: dict[str, Any], keys: Keys) -> None:
    path = find_asset("species", _SPECIES)
    species = data.get("species")
    if len(keys) > 1 and isinstance(species, dict) and keys[1] in species:
        species[keys[1]] = read_yaml(path)[0]
    else:
        data["species"] = {_SPECIES: read_yaml(path)[0]}
