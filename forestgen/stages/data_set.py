"""What all images of a data set share."""

from __future__ import annotations

from dataclasses import fields

from forestgen.core.errors import RecipeError
from forestgen.dataset.settings import DatasetSettings, dataset_settings
from forestgen.labels.classes import ClassMap
from forestgen.recipe.load import DrawnRecipe

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
    return ClassMap(tuple(drawn.species), drawn.recipe.labels.classes)


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


def _show(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else repr(value)
