from __future__ import annotations

import re
from io import StringIO
from typing import Any

import pytest
from recipe_example import RECIPE
from ruamel.yaml import YAML

from forestgen.recipe.json_schema import recipe_json_schema

TYPES: dict[str, Any] = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
KNOWN = {
    "$schema", "$id", "$defs", "$ref", "title", "description", "default", "type", "properties", "required", "items",
    "additionalProperties", "patternProperties", "prefixItems", "anyOf", "oneOf", "allOf", "const", "enum", "pattern",
    "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "minItems", "maxItems", "minLength", "maxLength",
    "minProperties", "maxProperties", "propertyNames",
}  # fmt: skip


def is_type(name: str, value: Any) -> bool:
    if name == "number":
        return isinstance(value, int | float) and not isinstance(value, bool)
    if name == "integer":
        return is_type("number", value) and value == int(value)
    return isinstance(value, TYPES[name])


def accepts(schema: Any, value: Any, root: dict[str, Any]) -> bool:
    """A validator of the part of JSON Schema that the recipe's schema uses; an unknown keyword fails the test."""
    if isinstance(schema, bool):
        return schema
    assert schema.keys() <= KNOWN, schema.keys() - KNOWN
    if "$ref" in schema and not accepts(root["$defs"][schema["$ref"].removeprefix("#/$defs/")], value, root):
        return False
    names = schema.get("type", [])
    if names and not any(is_type(name, value) for name in ([names] if isinstance(names, str) else names)):
        return False
    if "const" in schema and value != schema["const"]:
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    counted = sum(accepts(arm, value, root) for arm in schema.get("oneOf", []))
    return (
        ("oneOf" not in schema or counted == 1)
        and ("anyOf" not in schema or any(accepts(arm, value, root) for arm in schema["anyOf"]))
        and all(accepts(arm, value, root) for arm in schema.get("allOf", []))
        and (not is_type("number", value) or accepts_number(schema, value))
        and (not isinstance(value, str) or re.search(schema.get("pattern", ""), value) is not None)
        and (not isinstance(value, list) or accepts_list(schema, value, root))
        and (not isinstance(value, dict) or accepts_object(schema, value, root))
    )


def accepts_number(schema: dict[str, Any], value: float) -> bool:
    return (
        schema.get("minimum", value) <= value <= schema.get("maximum", value)
        and value > schema.get("exclusiveMinimum", -float("inf"))
        and value < schema.get("exclusiveMaximum", float("inf"))
    )


def accepts_list(schema: dict[str, Any], value: list[Any], root: dict[str, Any]) -> bool:
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
        return False
    first = schema.get("prefixItems", [])
    inner = [*first, *[schema.get("items", True)] * max(len(value) - len(first), 0)]
    return all(accepts(arm, item, root) for arm, item in zip(inner, value, strict=False))


def accepts_object(schema: dict[str, Any], value: dict[str, Any], root: dict[str, Any]) -> bool:
    if not set(schema.get("required", [])) <= value.keys():
        return False
    if not schema.get("minProperties", 0) <= len(value) <= schema.get("maxProperties", len(value)):
        return False
    for key, item in value.items():
        arms = [arm for pattern, arm in schema.get("patternProperties", {}).items() if re.search(pattern, key)]
        arms += [schema["properties"][key]] if key in schema.get("properties", {}) else []
        arms = arms or [schema.get("additionalProperties", True)]
        if not all(accepts(arm, item, root) for arm in arms):
            return False
    return True


def example() -> dict[str, Any]:
    data: dict[str, Any] = YAML(typ="safe", pure=True).load(StringIO(RECIPE))
    return data


def test_accepts_the_example_and_a_minimal_recipe() -> None:
    schema = recipe_json_schema()
    assert accepts(schema, example(), schema)
    minimal = {"forestgen": 1, "species": {"poplar": None}, "community": {"model": "x"}, "render": None}
    assert accepts(schema, minimal, schema)
    assert accepts(schema, {**minimal, "species": {"pine": {"height_m": 20}, "pines": {"from": "pine"}}}, schema)
    assert schema["$schema"].endswith("2020-12/schema")
    assert schema["title"] == "forestgen recipe"


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("sede",), 3),
        (("seed",), {"uniform": [1, 2]}),
        (("site", "size"), [1, 2]),
        (("site", "size_m"), [1]),
        (("site", "terrain"), "hills"),
        (("site", "terrain"), {"kin": "flat"}),
        (("species", "elm", "ecology"), {"growth": 3}),
        (("species", "a b"), None),
        (("species", "pinus"), {"height_m": 20}),
        (("sky", "turbidity"), {"unifrom": [1, 2]}),
        (("sky", "turbidity"), {"uniform": [1, 2], "choice": [1]}),
        (("sky", "turbidity"), 11),
        (("cameras",), []),
        (("render",), {"samples": "many"}),
    ],
)
def test_rejects(path: tuple[str, ...], value: object) -> None:
    schema, data = recipe_json_schema(), example()
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    assert not accepts(schema, data, schema)


@pytest.mark.parametrize(
    ("path", "value", "good"),
    [
        (("sky", "turbidity"), {"choice": {"values": [1, 2], "weights": [3, 1]}}, True),
        (("sky", "turbidity"), {"choice": {"values": [1, 2], "weight": [3, 1]}}, False),
        (("sky", "turbidity"), {"formula": "2 + 4 * haze"}, True),
        (("sky", "turbidity"), {"variable": "haze"}, True),
        (("sky", "turbidity"), {"variable": 3}, False),
        (("sky", "clouds"), {"choice": [{"type": "none"}, "noise"]}, True),
        (("sky", "clouds"), {"type": "file", "file": "sky.nc"}, True),
        (("sky", "clouds"), {"type": "cumulus", "sounding": "air.csv", "emission": {"map": "ground.png"}}, True),
        (("sky", "clouds"), {"type": "cumulus", "sounding": 3}, False),
        (("cameras",), {"choice": [[{"name": "a"}], [{"name": "b"}]]}, True),
        (("site", "wet_soil"), False, True),
        (("site", "wet_soil"), {"depth_m": {"uniform": [0.1, 1]}}, True),
        (("site", "wet_soil"), "wet", False),
        (("cameras", 0, "bands"), "sentinel2a", True),
        (("species", "elm", "materials"), {"leaf": {"spectrum": "leaves/birch"}}, True),
        (("same_stand",), "by_split", True),
        (("same_stand",), {"choice": [True, False]}, False),
        (("dataset",), {"splits": {"train": {"uniform": [1, 2]}}}, False),
        (("sampling",), {"method": "sobol", "strata": {"sky.turbidity": 3, "plants.season": "all"}}, True),
        (("sampling",), {"variables": {"haze": {"uniform": [0, 1]}, "two": 2, "x": {"formula": "2 * haze"}}}, True),
        (("sampling",), {"method": {"choice": ["sobol", "halton"]}}, False),
        (("sampling",), {"correlations": [{"keys": ["a", "b"], "rank": 0.5}]}, True),
        (("sampling",), {"correlations": [{"keys": ["a"], "rank": 0.5}]}, False),
    ],
)
def test_what_is_drawn(path: tuple[str, ...], value: object, good: bool) -> None:
    schema, data = recipe_json_schema(), example()
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    assert accepts(schema, data, schema) == good


def test_every_key_has_a_description() -> None:
    def walk(node: Any) -> None:
        if isinstance(node, list):
            for item in node:
                walk(item)
        elif isinstance(node, dict):
            for name, item in node.get("properties", {}).items() if isinstance(node.get("properties"), dict) else ():
                if name not in {"mean", "sd", "median", "sigma", "low", "high"}:
                    assert item.get("description"), name
            for item in node.values():
                walk(item)

    walk(recipe_json_schema())


def test_models_keys_are_spliced_in() -> None:
    own = {
        "type": "object",
        "description": "Plants on a grid.",
        "properties": {
            "steps": {"type": "integer", "minimum": 1, "description": "Steps."},
            "program": {"$ref": "#/$defs/Program", "description": "Rules."},
        },
        "required": ["program"],
        "$defs": {"Program": {"type": "string"}},
    }
    schema = recipe_json_schema({"lattice": own}, {"pole": {"properties": {"leaves": {"type": "integer"}}}})
    data = example()
    data["community"] = {"model": "lattice", "program": "x", "steps": {"integers": [1, 2]}}
    assert accepts(schema, data, schema)
    data["species"]["elm"]["plant"] = {"leaves": 3}
    assert accepts(schema, data, schema)
    for wrong in ({"model": "lattice"}, {"model": "other", "program": "x"}, {**data["community"], "step": 3}):
        data["community"] = wrong
        assert not accepts(schema, data, schema)
