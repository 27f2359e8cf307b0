"""JSON Schema of the recipe as its author may write it: for editors' completion and checks while typing.

The schema of a *drawn* recipe comes from the pydantic classes; here every scalar also admits a distribution, shorthands
are admitted, and a species is a file's name with overrides or a whole species.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
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
_OF_SPECIES = ("Ecology", "PowerLaw", "Allometry", "Plant", "PlantType", "Material")


def recipe_json_schema(
    community_parameters: Mapping[str, Json] | None = None, plant_parameters: Mapping[str, Json] | None = None
) -> Json:
    """JSON Schema (draft 2020-12) of a recipe file.

    Parameters
    ----------
    community_parameters : community model's id -> JSON Schema of its own keys. Given, no other model is admitted.
    plant_parameters : plant generator's id -> JSON Schema of its own keys. Given, no other generator is admitted.
    """
    schema: Json = Recipe.model_json_schema()
    definitions: Json = schema["$defs"]
    if community_parameters:
        _splice(definitions, "Community", "model", community_parameters)
    if plant_parameters:
        _splice(definitions, "Plant", "generator", plant_parameters)
    schema = _changed(schema, _tidy)
    definitions, properties = schema["$defs"], schema["properties"]
    splits = copy.deepcopy(definitions["Dataset"]["properties"]["splits"])
    undrawn = {str(keys[0]) for keys in UNDRAWN if len(keys) == 1}
    for nodes, left_out in ((definitions, _OF_SAMPLING), (properties, undrawn)):
        nodes.update({name: _changed(nodes[name], _drawable) for name in nodes.keys() - left_out})
    _admit_shorthands(schema)
    # Every mapping or list in a section, except species, may be chosen among several.
    for name in definitions.keys() - _OF_SAMPLING:
        _admit_alternatives(definitions[name].get("properties", {}))
    _admit_alternatives(properties, without=undrawn | {"species"})
    _admit_species_files(schema)
    definitions["Dataset"]["properties"]["splits"] = splits
    definitions["Distribution"], definitions["Alternatives"] = _distribution(), _alternatives()
    definitions["Sampling"]["properties"]["variables"]["additionalProperties"] = {"anyOf": [_SCALAR, DISTRIBUTION]}
    schema["required"] = [name for name in schema["required"] if name not in ("cameras", "species")]
    head = {
        "$schema": DIALECT,
        "$id": f"https://forestgen.invalid/schemas/recipe-{SCHEMA_VERSION}.json",
        "title": "forestgen recipe",
    }
    return {**head, **schema, "description": "A plant community and the images to make of it."}


def _outer_inner(node: Json) -> tuple[Json, Json]:
    """A node's description and default, which stay outside where editors look for them, and the rest."""
    outer: Json = {key: node[key] for key in ("description", "default") if key in node}
    return outer, {key: value for key, value in node.items() if key not in outer}


def _changed(node: Any, change: Callable[[Json], Json]) -> Any:
    """`node` with every mapping in it changed, the inner ones first."""
    if isinstance(node, list):
        return [_changed(item, change) for item in node]
    return change({key: _changed(item, change) for key, item in node.items()}) if isinstance(node, dict) else node


def _drawable(node: Json) -> Json:
    """A scalar's schema also admits a distribution."""
    scalar = isinstance(node.get("type"), str) and node["type"] in _SCALARS
    if not scalar and "const" not in node and "enum" not in node:
        return node
    outer, inner = _outer_inner(node)
    return {**outer, "anyOf": [inner, DISTRIBUTION]}


def _tidy(node: Json) -> Json:
    """Without the title that repeats a key's name (a key called "title" stays), and bounds by their JSON Schema names.

    The schema library writes a bound beyond a validator function under its own name.
    """
    bounds = {name for name in _BOUNDS.keys() & node.keys() if isinstance(node[name], int | float)}
    kept = {key: value for key, value in node.items() if key != "title" or not isinstance(value, str)}
    return {_BOUNDS[key] if key in bounds else key: value for key, value in kept.items()}


def _splice(definitions: Json, section: str, selector: str, parameters: Mapping[str, Json]) -> None:
    """Make `section` one of its variants by the selector's value, each with its own keys."""
    base = definitions[section]
    description = base["properties"][selector].get("description", "")
    variants = []
    for name, given in sorted(parameters.items()):
        own = copy.deepcopy(given)
        prefix = f"{section}_{name}_"
        for inner, definition in own.pop("$defs", {}).items():
            definitions[prefix + inner] = _renamed(definition, prefix)
        own = _renamed(own, prefix)
        # As an object, not as a scalar to be drawn: the choice of the variant is not a distribution.
        chosen = {selector: {"allOf": [{"const": name}], "description": description}}
        required = [selector, *own.get("required", [])]
        variants.append(
            _object({**chosen, **own["properties"]}, required, own.get("description", f"{selector} {name}"))
        )
    definitions[section] = {"description": base.get("description", ""), "oneOf": variants}


def _renamed(node: Any, prefix: str) -> Any:
    """`node` with its references to local definitions given a prefix."""

    def rename(one: Json) -> Json:
        if isinstance(one.get("$ref"), str):
            one["$ref"] = f"#/$defs/{prefix}{one['$ref'].removeprefix('#/$defs/')}"
        return one

    return _changed(node, rename)


def _admit_shorthands(schema: Json) -> None:
    """A section may be written as the value of one of its keys, see `fields.shorthand`, or left empty."""
    definitions = schema["$defs"]

    def spelled_short(node: Json) -> Json:
        if not isinstance(node.get("shorthand"), str):
            return node
        outer, inner = _outer_inner(node)
        key = inner.pop("shorthand")
        arms = inner.get("anyOf", [inner])
        section = next(arm["$ref"] for arm in arms if "$ref" in arm).removeprefix("#/$defs/")
        return {**outer, "anyOf": [*arms, *definitions[section]["properties"][key]["anyOf"]]}

    for name, section in definitions.items():
        definitions[name] = _changed(section, spelled_short)
    del definitions["Camera"]["required"]
    for name in ("site", "plants", "sky", "cameras", "render", "labels"):
        outer, inner = _outer_inner(schema["properties"][name])
        schema["properties"][name] = {**outer, "anyOf": [inner, {"type": "null"}]}


def _admit_alternatives(properties: Json, without: set[str] | frozenset[str] = frozenset()) -> None:
    for name in properties.keys() - without:
        outer, inner = _outer_inner(properties[name])
        arms = inner.get("anyOf", [inner])
        if any(("$ref" in arm and arm != DISTRIBUTION) or arm.get("type") in ("object", "array") for arm in arms):
            properties[name] = {**outer, "anyOf": [*arms, ALTERNATIVES]}


def _admit_species_files(schema: Json) -> None:
    definitions = schema["$defs"]
    # Under `from`, any key may be left out at any depth: the file has it.
    for name in ("Species", *_OF_SPECIES):
        definitions[f"{name}Override"] = _changed(definitions[name], _partial)
    override = definitions["SpeciesOverride"]
    source = {"type": "string", "description": "Name of a species in scenes/species, or the path of its file."}
    override["properties"] = {"from": source, **override["properties"]}
    definitions["SpeciesFromFile"] = {**override, "required": ["from"]}
    whole = {"$ref": "#/$defs/Species"}
    arms = [{"type": "null"}, source, {"$ref": "#/$defs/SpeciesFromFile"}, whole]
    # By a shipped species' name the rest is known.
    by_name = {"anyOf": [{"type": "null"}, source, {"$ref": "#/$defs/SpeciesOverride"}, whole]}
    place = schema["properties"]["species"]
    shipped = "|".join(name for name in list_assets("species") if re.fullmatch(NAME_PATTERN, name))
    others = f"^(?!({shipped})$)" + NAME_PATTERN.removeprefix("^")
    place["patternProperties"] = {f"^({shipped})$": by_name, others: {"anyOf": arms}}
    place["additionalProperties"] = False


def _partial(node: Json) -> Json:
    """Any key may be left out; without its selector a section may fit several variants."""
    result = {"anyOf" if key == "oneOf" else key: value for key, value in node.items() if key != "required"}
    reference = result.get("$ref", "")
    if isinstance(reference, str) and reference.removeprefix("#/$defs/") in _OF_SPECIES:
        result["$ref"] = reference + "Override"
    return result


def _object(properties: Json, required: Sequence[str], description: str | None = None) -> Json:
    """A mapping with these keys and no others."""
    about = {} if description is None else {"description": description}
    made = {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}
    return {**made, **about}


def _choice(item: Json, description: str) -> Json:
    """A choice among such items, with or without weights."""
    items = {"type": "array", "items": item, "minItems": 1, "maxItems": MOST_VALUES}
    weights = {**items, "items": {"type": "number", "minimum": 0}}
    properties = {
        "values": {**items, "description": "What is chosen from."},
        "weights": {**weights, "description": "How often each is chosen, in any unit."},
    }
    return {"anyOf": [items, _object(properties, ("values", "weights"))], "description": description}


def _alternatives() -> Json:
    choice = _choice({}, "One of these, equally likely; or values and weights.")
    about = "One of several mappings or lists, in which there may be distributions."
    return _object({"choice": choice}, ("choice",), about)


def _distribution() -> Json:
    number = {"type": "number"}

    def pair(item: Json) -> Json:
        return {"type": "array", "items": item, "minItems": 2, "maxItems": 2}

    def gaussian(centre: str, spread: str) -> Json:
        ends = {"low": number, "high": number}
        named = {centre: number, spread: {"type": "number", "exclusiveMinimum": 0}, **ends}
        arms = [pair(number), _object(named, (centre, spread))]
        return {"anyOf": arms, "description": f"[{centre}, {spread}], or with low and high."}

    properties: Json = {
        "uniform": {**pair(number), "description": "[low, high]: any number between, equally likely."},
        "normal": gaussian("mean", "sd"),
        "lognormal": gaussian("median", "sigma"),
        "integers": {**pair({"type": "integer"}), "description": "[low, high]: any whole number, both included."},
        "choice": _choice({"anyOf": [_SCALAR, DISTRIBUTION]}, "One of these, equally likely; or values and weights."),
        "sequence": {"type": "array", "items": _SCALAR, "minItems": 1, "description": "One after another, by image."},
    }
    assert tuple(properties) == KINDS
    properties["variable"] = {"type": "string", "description": "The value of one of sampling.variables."}
    properties["formula"] = {"type": "string", "description": "Arithmetic of sampling.variables: 10 + 30 * wetness."}
    made = _object(properties, (), "A value drawn anew for each image.")
    del made["required"]
    return {**made, "minProperties": 1, "maxProperties": 1}
