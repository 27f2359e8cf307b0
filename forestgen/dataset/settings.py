"""What all images of a data set share: an argument of every format's writer and merger."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from forestgen.core.errors import RecipeError
from forestgen.recipe.classes import ClassMap
from forestgen.recipe.dataset import View
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.registries import DEFAULT_FORMATS

if TYPE_CHECKING:  # workers and commands that only handle files start in half the time without Numba
    from forestgen.community.simulation import CommunityPlan

DRAW = "draw."  # begins the index's columns of what the recipe's distributions gave, as draw.sky.turbidity
_CLASSES = ("labels", "classes")
_SAME = ("view", "description", "contributor", "depth_unit_m", "point_stride")  # as in the recipe
# Key of the recipe behind a field of the settings, where it is not dataset.FIELD.
_KEYS = {
    "species_names": ("species",),
    **dict.fromkeys(("class_names", "category_names", "species_category"), _CLASSES),
    "licence_name": ("dataset", "licence", "name"),
    "licence_url": ("dataset", "licence", "url"),
}


@dataclass(frozen=True)
class DatasetSettings:
    """The recipe's `dataset` section, and the names behind the numbers in its files."""

    species_names: tuple[str, ...]  # in the recipe's order
    class_names: tuple[str, ...]  # semantic class number -> name; 0 nothing, 1 ground
    category_names: tuple[str, ...]  # of instances, in the order of their numbers
    species_category: tuple[int, ...]  # index into category_names of each species
    formats: tuple[str, ...] = DEFAULT_FORMATS  # names in recipe/registries.py
    view: View = "filmic"  # view transform of the previews
    description: str = "forestgen dataset"
    contributor: str = ""
    licence_name: str = ""  # "" where the recipe names none
    licence_url: str = ""
    depth_unit_m: float = 0.01  # of a step of the 16-bit depth PNG
    point_stride: int = 1  # of points: every n-th pixel of every n-th row


def class_map(drawn: DrawnRecipe) -> ClassMap:
    """The semantic classes of a drawn recipe."""
    return ClassMap(drawn.recipe.labelled_names, drawn.recipe.labels.classes)


def data_set_of(drawn: DrawnRecipe) -> DatasetSettings:
    """Settings of the data set that a drawn recipe's image belongs to."""
    section, classes = drawn.recipe.dataset, class_map(drawn)
    category_names, species_category = classes.instance_categories
    licence = section.licence
    return DatasetSettings(
        species_names=classes.species_names,
        class_names=classes.names,
        category_names=category_names,
        species_category=tuple(species_category.tolist()),
        formats=tuple(section.formats),
        licence_name="" if licence is None else licence.name,
        licence_url="" if licence is None else licence.url,
        **{name: getattr(section, name) for name in _SAME},
    )


def check_one_data_set(drawn: DrawnRecipe, settings: DatasetSettings) -> None:
    """Refuse an image of other settings than the data set's, with a `RecipeError`: one file describes all images."""
    if (difference := first_difference(settings, data_set_of(drawn))) is not None:
        keys, common, got = difference
        problem, expected = "images of one data set must agree on this", f"{common}, as in the first image"
        hint = "give a value, not a distribution"
        raise RecipeError(problem, where=drawn.where(*keys), expected=expected, got=got, hint=hint)


def first_difference(one: DatasetSettings, other: DatasetSettings) -> tuple[tuple[str, ...], str, str] | None:
    """The recipe's key of the first setting that differs, and its two values, for people; None: all are the same."""
    for field in fields(DatasetSettings):
        values = getattr(one, field.name), getattr(other, field.name)
        if values[0] != values[1]:
            first, second = (
                ", ".join(map(str, value)) if isinstance(value, tuple) else repr(value) for value in values
            )
            return _KEYS.get(field.name, ("dataset", field.name)), first, second
    return None


def check_stands(plan: CommunityPlan, loaded: LoadedRecipe, splits: Sequence[str]) -> None:
    """Refuse several splits for a stand in which nothing is drawn: train and test would share it."""
    community = plan.drawn.recipe.community
    stands_differ = (
        plan.parameters.is_random
        or bool(plan.parameters.disturbances)
        or any(keys[0] == "community" for keys in loaded.distributions)
    )
    nobody = plan.model.expected_plants(plan.parameters, plan.site, plan.ecologies) == 0
    if len(splits) > 1 and not stands_differ and not nobody:
        problem = "all images show the plants of one list: train and test would share a stand (data leakage)"
        expected = "one split, or a stand that is drawn for each image"
        got = f"{community.model}, with the splits {', '.join(splits)}"
        hint = "`set='dataset.splits={train: 1}'`; merge data sets of several stands, each of its own split"
        raise RecipeError(problem, where=plan.drawn.where("community", "model"), expected=expected, got=got, hint=hint)


def check_splits(loaded: LoadedRecipe, splits: Sequence[str]) -> None:
    """Refuse a run of ``same_stand: true`` that uses several splits: train and test would share the stand."""
    if loaded.data.get("same_stand") is True and len(splits) > 1:
        problem = "one stand cannot be in several splits: train and test would share a stand (data leakage)"
        expected = "by_split, a stand for each split; or false, a stand for each image"
        got, hint = f"true, with the splits {', '.join(splits)}", "or one split: `set='dataset.splits={train: 1}'`"
        raise RecipeError(problem, where=loaded.sources.where(("same_stand",)), expected=expected, got=got, hint=hint)
