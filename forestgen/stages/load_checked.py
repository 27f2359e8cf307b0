"""A recipe from its file for the command line: all of its errors at once, those of models and generators too."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from forestgen.core.errors import ResourceError
from forestgen.recipe.load import LoadedRecipe, read_recipe
from forestgen.stages.plan import collect_plan


def load_checked(path: Path | str, overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe as `load_recipe` does; its errors hold those of the community model and of plants' generators.

    A recipe that `load_recipe` takes is left to `check_plan`, which tells all of the latter.
    """
    loading = read_recipe(path, overrides)
    if loading.errors and loading.sound is not None:
        with suppress(ResourceError):  # told when the recipe is right
            collect_plan(loading.sound.draw(0), loading.errors, loading.stand_ins)
    return loading.whole()
