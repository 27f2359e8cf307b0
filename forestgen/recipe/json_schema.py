"""JSON Schema of the recipe as its author may write it: for editors' completion and checks while typing.

The schema of a *drawn* recipe comes from the pydantic classes; here every scalar also admits a distribution, shorthands
are admitted, and a species is a file's name with overrides or a whole species.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from forestgen.recipe.assets import list_assets
from forestgen.recipe.distributions import KINDS, MOST_VALUES
from forestgen.recipe.fields import NAME_PATTERN
from forestgen.recipe.messages import UNDRAWN
from forestgen.recipe.schema import SCHEMA_VERSION, Recipe

Json = dict[str, Any]
DIALECT = "https://json-schema.org/draft/2020-12/schema"
DISTRIBUTION = {"$ref": "#/$defs/Distribution"}
ALTERNATIVES = {"$ref": "#/$defs/Alternatives"}
_BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
_SCALARS = {"number", "integer", "boolean", "string"}
_SCALAR: Json = {"type": ["number", "string", "boolean", "null"]}
_OF_SAMPLING = {"Sampling", "Correlation"}  # decide how the rest is drawn


def recipe_json_schema(
    community_parameters: Mapping[str, Json] | None = None, plant_parameters: Mapping[str, Json] | None = None
) -> Json:
    """JSON Schema (draft 2020-12) of a recipe file.

    Parameters
    ----------
    community_parameters : community model's id -> JSON Schema of its own keys. Given, no other model is admitted.
    plant_parameters : plant generator's id -> JSON Schema of its own keys. Given, no other generator is admitted.
    """
    schema: Json = copy.deepcopy(Recipe.model_json_schema())
    definitions: Json = schema["$defs"]
    if community_parameters:
        _splice(definitions, "Community", "model", community_parameters)
    if plant_parameters:
        _splice(definitions, "Plant", "generator", plant_parameters)
    _tidy(schema)
    splits = copy.deepcopy(definitions["Dataset"]["properties"]["splits"])
    for name, definition in definitions.items():
        if name not in _OF_SAMPLING:
            definitions[name] = _drawable(definition)
    undrawn = {str(keys[0]) for keys in UNDRAWN if len(keys) == 1}
    properties: Json = schema["properties"]
    for name, definition in properties.items():
        if name not in undrawn:
            properties[name] = _drawable(definition)
    _admit_shorthands(schema)
    _admit_alternatives(schema, undrawn)
    _admit_species_files(schema)
    definitions["Dataset"]["properties"]["splits"] = splits
    definitions["Distribution"] = _distribution()
    definitions["Alternatives"] = _alternatives()
    definitions["Sampling"]["properties"]["variables"]["additionalProperties"] = {"anyOf": [_SCALAR, DISTRIBUTION]}
    schema["required"] = [name for name in schema["required"] if name not in ("cameras", "species")]
    head = {
        "$schema": DIALECT,
        "$id": f"https://forestgen.invalid/schemas/recipe-{SCHEMA_VERSION}.json",
        "title": "forestgen recipe",
    }
    return {**head, **schema, "description": "A plant community and the images to make of it."}


def _drawable(node: Any) -> Any:
    """`node` with every scalar schema inside also admitting a distribution."""
    if isinstance(node, list):
        return [_drawable(item) for item in node]
    if not isinstance(node, dict):
        return node
    if node.get("type") in _SCALARS or "const" in node or "enum" in node:
        # The description stays outside, where editors look for it.
        outer = {key: node[key] for key in ("description", "default") if key in node}
        inner = {key: value for key, value in node.items() if key not in outer}
        return {**outer, "anyOf": [inner, DISTRIBUTION]}
    result: Json = {}
    for key, value in node.items():
        if key in ("properties", "patternProperties"):
            result[key] = {name: _drawable(item) for name, item in value.items()}
        elif key in ("items", "prefixItems", "anyOf", "oneOf", "allOf", "additionalProperties"):
            result[key] = _drawable(value)
        else:
            result[key] = value
    return result


def _tidy(node: Any) -> None:
    """Remove the titles that repeat a key's name (a key called "title" stays) and give bounds their JSON Schema names.

    The schema library writes a bound beyond a validator function, as in `fields.Whole`, under its own name.
    """
    if isinstance(node, list):
        for item in node:
            _tidy(item)
    elif isinstance(node, dict):
        if isinstance(node.get("title"), str):
            del node["title"]
        for name, keyword in _BOUNDS.items():
            if isinstance(node.get(name), int | float):
                node[keyword] = node.pop(name)
        for item in node.values():
            _tidy(item)


def _splice(definitions: Json, section: str, selector: str, parameters: Mapping[str, Json]) -> None:
    """Make `section` one of its variants by the selector's value, each with its own keys."""
    base = definitions[section]
    variants = []
    for name, own in sorted(parameters.items()):
        own = copy.deepcopy(own)
        prefix = f"{section}_{name}_"
        for inner, definition in own.pop("$defs", {}).items():
            definitions[prefix + inner] = _renamed(definition, prefix)
        own = _renamed(own, prefix)
        description = base["properties"][selector].get("description", "")
        variants.append(
            {
                "type": "object",
                "description": own.get("description", f"{selector} {name}"),
                # As an object, not as a scalar to be drawn: the choice of the variant is not a distribution.
                "properties": {selector: {"allOf": [{"const": name}], "description": description}, **own["properties"]},
                "required": [selector, *own.get("required", [])],
                "additionalProperties": False,
            }
        )
    definitions[section] = {"description": base.get("description", ""), "oneOf": variants}


def _renamed(node: Any, prefix: str) -> Any:
    """`node` with its references to local definitions given a prefix."""
    if isinstance(node, list):
        return [_renamed(item, prefix) for item in node]
    if isinstance(node, dict):
        return {
            key: f"#/$defs/{prefix}{value.removeprefix('#/$defs/')}"
            if key == "$ref" and isinstance(value, str)
            else _renamed(value, prefix)
            for key, value in node.items()
        }
    return node


def _admit_shorthands(schema: Json) -> None:
    definitions = schema["$defs"]
    for owner, key, section, field in (
        ("Site", "terrain", "Terrain", "kind"),
        ("Site", "wet_soil", "WetSoil", "shown"),
        ("SkySection", "clouds", "Clouds", "type"),
    ):
        kinds = definitions[section]["properties"][field]["anyOf"]
        place = definitions[owner]["properties"][key]
        description = {k: place[k] for k in ("description", "default") if k in place}
        arms = place.get("anyOf", [{"$ref": f"#/$defs/{section}"}])
        definitions[owner]["properties"][key] = {**description, "anyOf": [*arms, *kinds]}
    del definitions["Camera"]["required"]
    for name in ("site", "plants", "sky", "cameras", "render", "labels"):
        place = schema["properties"][name]
        inner = {k: v for k, v in place.items() if k not in ("description", "default")}
        outer = {k: v for k, v in place.items() if k in ("description", "default")}
        schema["properties"][name] = {**outer, "anyOf": [inner, {"type": "null"}]}


def _admit_alternatives(schema: Json, undrawn: set[str]) -> None:
    """Every mapping or list in a section, but for species, may be chosen among several."""
    for name in schema["$defs"].keys() - _OF_SAMPLING:
        _with_alternatives(schema["$defs"][name], schema["$defs"][name].get("properties", {}))
    outer = {name: schema["properties"][name] for name in schema["properties"].keys() - undrawn - {"species"}}
    _with_alternatives(schema, outer)


def _with_alternatives(section: Json, properties: Json) -> None:
    for name, place in properties.items():
        arms = place.get("anyOf", [place])
        if any(("$ref" in arm and arm != DISTRIBUTION) or arm.get("type") in ("object", "array") for arm in arms):
            outer = {key: place[key] for key in ("description", "default") if key in place}
            inner = {key: value for key, value in place.items() if key not in outer}
            section["properties"][name] = {**outer, "anyOf": [*inner.get("anyOf", [inner]), ALTERNATIVES]}


def _admit_species_files(schema: Json) -> None:
    definitions = schema["$defs"]
    # Under `from`, any key may be left out at any depth: the file has it.
    for name in ("Species", "Ecology", "PowerLaw", "Allometry", "Plant", "PlantType", "Material"):
        definitions[f"{name}Override"] = _partial(definitions[name])
    override = definitions["SpeciesOverride"]
    source = {"type": "string", "description": "Name of a species in scenes/species, or the path of its file."}
    override["properties"] = {"from": source, **override["properties"]}
    definitions["SpeciesFromFile"] = {**override, "required": ["from"]}
    whole = {"$ref": "#/$defs/Species"}
    arms = [{"type": "null"}, source, {"$ref": "#/$defs/SpeciesFromFile"}, whole]
    # A shipped species' name says where the rest comes from.
    by_name = {"anyOf": [{"type": "null"}, source, {"$ref": "#/$defs/SpeciesOverride"}, whole]}
    place = schema["properties"]["species"]
    place.pop("additionalProperties", None)
    shipped = "|".join(name for name in list_assets("species") if re.fullmatch(NAME_PATTERN, name))
    others = f"^(?!({shipped})$)" + NAME_PATTERN.removeprefix("^")
    place["patternProperties"] = {f"^({shipped})$": by_name, others: {"anyOf": arms}}
    place["additionalProperties"] = False


def _partial(node: Any) -> Any:
    if isinstance(node, list):
        return [_partial(item) for item in node]
    if not isinstance(node, dict):
        return node
    # Without its selector a section may fit several variants.
    result = {"anyOf" if key == "oneOf" else key: _partial(value) for key, value in node.items() if key != "required"}
    reference = result.get("$ref", "")
    if isinstance(reference, str) and reference.removeprefix("#/$defs/") in (
        "Ecology",
        "PowerLaw",
        "Allometry",
        "Plant",
        "PlantType",
        "Material",
    ):
        result["$ref"] = reference + "Override"
    return result


def _choice(item: Json, description: str) -> Json:
    """A choice among such items, with or without weights."""
    items = {"type": "array", "items": item, "minItems": 1, "maxItems": MOST_VALUES}
    weights = {"type": "array", "items": {"type": "number", "minimum": 0}, "minItems": 1, "maxItems": MOST_VALUES}
    weighted = {
        "type": "object",
        "properties": {
            "values": {**items, "description": "What is chosen from."},
            "weights": {**weights, "description": "How often each is chosen, in any unit."},
        },
        "required": ["values", "weights"],
        "additionalProperties": False,
    }
    return {"anyOf": [items, weighted], "description": description}


def _alternatives() -> Json:
    return {
        "type": "object",
        "description": "One of several mappings or lists, in which there may be distributions.",
        "properties": {"choice": _choice({}, "One of these, equally likely; or values and weights.")},
        "required": ["choice"],
        "additionalProperties": False,
    }


def _distribution() -> Json:
    number = {"type": "number"}
    scalar = _SCALAR

    def pair(item: Json) -> Json:
        return {"type": "array", "items": item, "minItems": 2, "maxItems": 2}

    def named(centre: str, spread: str) -> Json:
        properties = {centre: number, spread: {"type": "number", "exclusiveMinimum": 0}, "low": number, "high": number}
        return {"type": "object", "properties": properties, "required": [centre, spread], "additionalProperties": False}

    properties: Json = {
        "uniform": {**pair(number), "description": "[low, high]: any number between, equally likely."},
        "normal": {"anyOf": [pair(number), named("mean", "sd")], "description": "[mean, sd], or with low and high."},
        "lognormal": {
            "anyOf": [pair(number), named("median", "sigma")],
            "description": "[median, sigma], or with low and high.",
        },
        "integers": {**pair({"type": "integer"}), "description": "[low, high]: any whole number, both included."},
        "choice": _choice({"anyOf": [scalar, DISTRIBUTION]}, "One of these, equally likely; or values and weights."),
        "sequence": {"type": "array", "items": scalar, "minItems": 1, "description": "One after another, by image."},
    }
    assert tuple(properties) == KINDS
    properties["variable"] = {"type": "string", "description": "The value of one of sampling.variables."}
    properties["formula"] = {"type": "string", "description": "Arithmetic of sampling.variables: 10 + 30 * wetness."}
    return {
        "type": "object",
        "description": "A value drawn anew for each image.",
        "properties": properties,
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": False,
    }
