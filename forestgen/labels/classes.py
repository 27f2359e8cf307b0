"""Semantic classes: which class a pixel has, by its plant's species and its part.

Classes are numbered: 0 nothing (sky), 1 ground and what lies on it, then the recipe's own, in its order. A recipe that
names none has a class for each of its species. A class lists species, parts, or both::

    labels:
      classes:
        wood: [trunk, branch, dead_wood]
        conifer: [spruce, fir]
        broadleaved: [others]

- A part's class goes before a species': a spruce's trunk is `wood` here, its needles are `conifer`.
- `others` stands for all species that no class names. Without it, a species that is in no class is an error, unless
  every part of a plant has a class.
- litter, rock and water are parts that may have a class as well; otherwise they are ground.
- A pixel's part is the part mask's: the commonest among the samples of the pixel's winner.

A plant as a whole has a category, in COCO, panoptic and YOLO: the class that lists its species, or `others`. A species
that only classes of parts cover is a category of its own name. Categories are the classes that list species, in the
recipe's order, then such species; `wood` is none here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.recipe.classes import MOST_CLASSES, OTHERS, PARTS, RESERVED

NOTHING_CLASS, GROUND_CLASS, FIRST_OWN_CLASS = 0, 1, 2


@dataclass(frozen=True)
class ClassMap:
    """Semantic classes of a data set, see above; too many species raise `RecipeError`. The recipe checks `classes`."""

    species_names: tuple[str, ...]  # in the recipe's order
    classes: Mapping[str, Sequence[str]] | None = None  # name -> species and parts; None: a class for each species

    def __post_init__(self) -> None:
        if len(self.own_names) > MOST_CLASSES:
            expected, got = f"at most {MOST_CLASSES} species", str(len(self.own_names))
            problem, hint = (
                "too many species for an 8-bit semantic mask",
                "let labels.classes put several species into one class",
            )
            raise RecipeError(problem, where="species", expected=expected, got=got, hint=hint)

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the recipe's own classes."""
        return self.species_names if self.classes is None else tuple(self.classes)

    @property
    def names(self) -> tuple[str, ...]:
        """Class number -> name."""
        return (*RESERVED, *self.own_names)

    @cached_property
    def class_of(self) -> NDArray[np.uint8]:
        """(species + 1, parts) class by species index and part; the last row is for what is no plant."""
        species = len(self.species_names)
        table = np.full((species + 1, len(Part)), GROUND_CLASS, dtype=np.uint8)
        if self.classes is None:
            table[:species] = np.arange(FIRST_OWN_CLASS, FIRST_OWN_CLASS + species)[:, None]
        else:
            numbered = enumerate(self.classes.values(), FIRST_OWN_CLASS)
            listed = [(number, name) for number, members in numbered for name in members]
            own = {name: number for number, name in listed if name in self.species_names}
            rest = next((number for number, name in listed if name == OTHERS and name not in own), GROUND_CLASS)
            table[:species] = np.array([own.get(name, rest) for name in self.species_names], np.uint8)[:, None]
            for number, name in listed:
                if name in PARTS:
                    table[:, PARTS[name]] = number
        table[:, Part.NOTHING] = NOTHING_CLASS
        return table

    @cached_property
    def instance_categories(self) -> tuple[tuple[str, ...], NDArray[np.intp]]:
        """Names of the categories, and (species,) the index of each species' one."""
        if self.classes is None:
            return self.species_names, np.arange(len(self.species_names), dtype=np.intp)
        known = {*self.species_names, OTHERS}
        holding = [name for name, members in self.classes.items() if known & set(members)]
        of_member = {member: name for name in holding for member in self.classes[name]}
        rest = None if OTHERS in self.species_names else of_member.get(OTHERS)
        own = [of_member.get(name, rest or name) for name in self.species_names]
        names = tuple(dict.fromkeys([*holding, *own]))
        return names, np.array([names.index(name) for name in own], dtype=np.intp)

    def species_index(self, names: Sequence[str]) -> NDArray[np.intp]:
        """(M,) positions in the recipe of a population's M species names; an unknown name raises `ValueError`."""
        missing = sorted(set(names) - set(self.species_names))
        if missing:
            raise ValueError(f"species {missing} of the population are not among the recipe's {self.species_names}")
        return np.array([self.species_names.index(name) for name in names], dtype=np.intp)
