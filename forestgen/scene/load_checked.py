"""A recipe with all of its errors at once, those of models and generators too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import ResourceError
from forestgen.recipe.draws import find_written
from forestgen.recipe.load import LoadedRecipe, Loading, RecipeSource, Source, read_recipe
from forestgen.recipe.messages import Explainer


def load_checked(source: Source | RecipeSource, overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe as `load_recipe` does; its errors hold those of the community model and of plants' generators.

    Of a recipe that `load_recipe` takes, the name of the community model is checked, and the rest left to `check_plan`,
    which raises all of the latter.

    `source`: a file, or the content of one, as a mapping or a text of several lines; paths in that are relative to the
    working folder. Or what `read_source` made of one.
    """
    loading = read_recipe(source, overrides)
    section = loading.community if isinstance(loading.community, Mapping) else {}
    name = section.get("model") if isinstance(section.get("model"), str) else None  # None: it is drawn, or no name
    if name is not None:
        loading.errors.attempt(COMMUNITY_MODELS.check, name, where=loading.sources.where(("community", "model")))
    if loading.errors and loading.sound is not None:
        from forestgen.scene.plan import collect_plan

        with suppress(ResourceError):  # raised when the recipe is right
            collect_plan(loading.sound.draw(0), loading.errors, loading.stand_ins)
        _check_keys(loading, dict(section), name)
    return loading.whole()


def _check_keys(loading: Loading, section: dict[str, Any], name: str | None) -> None:
    """Add the errors of the keys of a community that could not be checked as a whole.

    Of an unknown model, the keys that all models have are checked. Values that are drawn are left out.
    """
    from forestgen.community.model import CommunityParameters

    known = name if name in COMMUNITY_MODELS else None
    if not section or (known and "community" not in loading.stand_ins):
        return
    section.pop("model", None)
    parameters = COMMUNITY_MODELS.load(known).Parameters if known else CommunityParameters
    left_out = {_second(place) for place in loading.errors.places}
    left_out |= {str(keys[1]) for keys in find_written({"community": section}) if len(keys) > 1}
    data = {
        key: value
        for key, value in section.items()
        if key not in left_out and (known or key in CommunityParameters.model_fields)
    }
    try:
        parameters.model_validate(data, context={"folder": Path()})
    except ValidationError as failure:
        error = Explainer(parameters, data, loading.sources, ("community",), {}).error(failure)
        for one in error.errors:
            if _second(one.where or "") in data:  # a key that was left out is not missing
                loading.errors.add(one)


def _second(place: str) -> str:
    """The community's key in an error's place, such as ``stand.yaml:7: community.steps``; empty: none."""
    keys = place.rpartition(": ")[2].split(".")
    return keys[1] if keys[0] == "community" and len(keys) > 1 else ""
