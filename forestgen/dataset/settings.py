"""What holds for a whole data set: an argument of every format's writer and merger."""

from __future__ import annotations

from dataclasses import dataclass

from forestgen.labels.classes import ClassMap
from forestgen.recipe.dataset import View
from forestgen.recipe.registries import DEFAULT_FORMATS
from forestgen.recipe.schema import Recipe

DRAW = "draw."  # begins the index's columns of what the recipe's distributions gave, as draw.sky.turbidity


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


def dataset_settings(recipe: Recipe, classes: ClassMap) -> DatasetSettings:
    """Settings of a drawn recipe; all images of a data set must have the same."""
    section = recipe.dataset
    category_names, species_category = classes.instance_categories
    licence = section.licence
    return DatasetSettings(
        species_names=classes.species_names,
        class_names=classes.names,
        category_names=category_names,
        species_category=tuple(species_category.tolist()),
        formats=tuple(section.formats),
        view=section.view,
        description=section.description,
        contributor=section.contributor,
        licence_name="" if licence is None else licence.name,
        licence_url="" if licence is None else licence.url,
        depth_unit_m=section.depth_unit_m,
        point_stride=section.point_stride,
    )
