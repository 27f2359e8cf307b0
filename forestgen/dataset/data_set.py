"""What all images of a data set share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

from forestgen.community.plan import CommunityPlan
from forestgen.core.errors import RecipeError
from forestgen.dataset.settings import DatasetSettings, dataset_settings
from forestgen.labels.classes import ClassMap
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe

_CLASSES = ("labels", "classes")
_KEYS = {
    "species_names": ("species",),
    "class_names": _CLASSES,
    "category_names": _CLASSES,
    "species_category": _CLASSES,
}
_LICENCE = {"licence_name": ("dataset", "licence", "name"), "licence_url": ("dataset", "licence", "url")}


def class_map(drawn: DrawnRecipe) -> ClassMap:
    """The semantic classes of a drawn recipe."""
    return ClassMap(drawn.recipe.labelled_names, drawn.recipe.labels.classes)


def data_set_of(drawn: DrawnRecipe) -> DatasetSettings:
    """Settings of the data set that a drawn recipe's image belongs to."""
    return dataset_settings(drawn.recipe, class_map(drawn))


def check_one_data_set(drawn: DrawnRecipe, settings: DatasetSettings) -> None:
    """Refuse an image of other settings than the data set's: one file describes all images.

    Raises
    ------
    RecipeError
        With the key that a distribution makes differ.
    """
    own = data_set_of(drawn)
    for field in fields(DatasetSettings):
        mine, common = getattr(own, field.name), getattr(settings, field.name)
        if mine != common:
            keys = {**_KEYS, **_LICENCE}.get(field.name, ("dataset", field.name))
            raise RecipeError(
                "images of one data set must agree on this",
                where=drawn.where(*keys),
                expected=f"{_show(common)}, as in the first image",
                got=_show(mine),
                hint="give a value, not a distribution",
            )


def check_stands(plan: CommunityPlan, loaded: LoadedRecipe, splits: Sequence[str]) -> None:
    """Refuse several splits for a stand in which nothing is drawn: an inventory is the same forest in each image.

    Raises
    ------
    RecipeError
    """
    community = plan.drawn.recipe.community
    stands_differ = (
        plan.parameters.is_random
        or bool(plan.parameters.disturbances)
        or any(keys[0] == "community" for keys in loaded.distributions)
    )
    nobody = plan.model.expected_plants(plan.parameters, plan.site, plan.ecologies) == 0
    if len(splits) > 1 and not stands_differ and not nobody:
        raise RecipeError(
            "all images show the plants of one list: what is tested would have been learned",
            where=plan.drawn.where("community", "model"),
            expected="one split, or a stand that is drawn for each image",
            got=f"{community.model}, with the splits {', '.join(splits)}",
            hint="`set='dataset.splits={train: 1}'`; merge data sets of several stands, each of its own split",
        )


def _show(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else repr(value)


def check_splits(loaded: LoadedRecipe, splits: Sequence[str]) -> None:
    """Refuse a run that would show one stand in several of the splits that it uses.

    Raises
    ------
    RecipeError : the recipe has ``same_stand: true`` and there is more than one split.
    """
    if loaded.data.get("same_stand") is True and len(splits) > 1:
        raise RecipeError(
            "one stand cannot be in several splits: what is tested would have been learned",
            where=loaded.sources.where(("same_stand",)),
            expected="by_split, a stand for each split; or false, a stand for each image",
            got=f"true, with the splits {', '.join(splits)}",
            hint="or one split: `set='dataset.splits={train: 1}'`",
        )
