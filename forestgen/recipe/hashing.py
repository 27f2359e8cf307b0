"""A recipe's identity: the hash of what it says, not of how it is written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from forestgen.recipe.map_files import is_map_file


def recipe_hash(data: Mapping[str, Any]) -> str:
    """SHA-256, hexadecimal, of a recipe's complete content (`LoadedRecipe.complete` or `DrawnRecipe.data`).

    Comments, layout, the order of keys and 1 against 1.0 do not matter; a species file's content does, and so does the
    order of species, which numbers the classes. A map counts by its content, wherever its file lies.
    """
    content = {"recipe": _canonical(data), "species": list(data.get("species", ()))}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, Mapping):
        nameless = is_map_file(value)
        return {str(key): _canonical(item) for key, item in value.items() if not (nameless and key == "file")}
    if isinstance(value, list | tuple):
        return [_canonical(item) for item in value]
    if isinstance(value, float) and value.is_integer():
        return int(value)  # also -0.0; exact, as every float that is whole is an integer
    return value
