"""A recipe with all of its errors at once, those of models and generators too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.recipe.load import LoadedRecipe, read_recipe, read_recipe_data, read_recipe_text


def load_checked(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe as `load_recipe` does; its errors hold those of the community model and of plants' generators.

    A recipe that `load_recipe` takes is left to `check_plan`, which raises all of the latter.

    Parameters
    ----------
    source : a file, or the content of one, as a mapping or a text of several lines; paths in that are relative to the
        working folder.
    """
    if isinstance(source, Mapping):
        loading = read_recipe_data(source, "recipe", overrides=overrides)
    elif isinstance(source, str) and "\n" in source:
        loading = read_recipe_text(source, overrides)
    else:
        loading = read_recipe(source, overrides)
    if loading.errors and loading.sound is not None:
        from forestgen.stages.plan import collect_plan  # loads every stage

        with suppress(ResourceError):  # raised when the recipe is right
            collect_plan(loading.sound.draw(0), loading.errors, loading.stand_ins)
    return loading.whole()
