"""Semantic classes: which class a pixel has, by its plant's species and its part; checks of `labels.classes`.

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
- litter, rock, ground_plants, moss and water are parts that may have a class as well; otherwise they are ground.
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
from pydantic_core import PydanticCustomError

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.recipe.fields import violation
from forestgen.recipe.suggestions import did_you_mean

OTHERS = "others"  # all species that no class names
RESERVED = ("nothing", "ground")  # classes that there always are
NO_SPECIES = (*RESERVED, "sky")  # names of what is no plant in a data set's files
MOST_CLASSES = 256 - len(RESERVED)  # of a recipe's own: a semantic mask has 8 bits
PARTS = {part.name.lower(): part for part in Part if part not in (Part.NOTHING, Part.GROUND)}  # a class may list
PLANT_PARTS = ("trunk", "branch", "leaf", "flower", "fruit", "dead_wood")
NOTHING_CLASS, GROUND_CLASS, FIRST_OWN_CLASS = 0, 1, 2


@dataclass(frozen=True)
class ClassMap:
    """Semantic classes of a data set, see above; too many species raise `RecipeError`. The recipe checks `classes`."""

    species_names: tuple[str, ...]  # in the recipe's order
    classes: Mapping[str, Sequence[str]] | None = None  # name -> species and parts; None: a class for each species

    def __post_init__(self) -> None:
        if len(self.own_names) > MOST_CLASSES:
            expected, got = f"at most {MOST_CLASSES} species", str(len(self.own_names))
            problem = "too many species for an 8-bit semantic mask"
            hint = "let labels.classes put several species into one class"
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


def wrong_classes(classes: Mapping[str, Sequence[str]], species: Sequence[str]) -> PydanticCustomError | None:
    """What is wrong first in the classes of a recipe with these species, or None.

    `classes` maps a class to the names of species and parts in it.
    """
    seen: dict[str, str] = {}
    for key, members in classes.items():
        if key.lower() in RESERVED:
            return _wrong((key,), "this class is there already", "another name than nothing or ground", key)
        for index, name in enumerate(members):
            if name in species and name in PARTS:
                got, hint = f"{name}, which is both a species and a part", "give the species another name"
                return _wrong((key, index), "this name is ambiguous", "a species or a part", got, hint)
            known = [*species, *PARTS, OTHERS]
            if name not in known:
                expected, hint_or_none = "one of " + ", ".join(known), did_you_mean(name.lower(), known)
                problem = "neither a species of the recipe nor a part"
                return _wrong((key, index), problem, expected, repr(name), hint_or_none)
            if name in seen:
                expected, got = "each species and part in one class", f"{name}, also in {seen[name]}"
                return _wrong((key, index), "in two classes", expected, got)
            seen[name] = key
    return None if OTHERS in seen and OTHERS not in species else _left_over(classes, seen, species)


def _wrong(
    keys: tuple[str | int, ...], problem: str, expected: str, got: str, hint: str | None = None
) -> PydanticCustomError:
    return violation(expected, problem=problem, got=got, hint=hint, at=("labels", "classes", *keys))


def _left_over(
    classes: Mapping[str, Sequence[str]], seen: Mapping[str, str], species: Sequence[str]
) -> PydanticCustomError | None:
    """A species without a class, or one whose category of instances would have the name of another species' class."""
    parts = [part for part in PLANT_PARTS if part not in seen]
    left = [name for name in species if name not in seen]
    if parts and left:
        which = "" if len(parts) == len(PLANT_PARTS) else f": its {', '.join(parts)}"
        hint = f"add {left[0]}, or `others` for all species that are not named, to a class"
        return _wrong((), "a species is in no class", "every species in a class", f"{left[0]}{which}", hint)
    for name in left:
        if {*species, OTHERS} & set(classes.get(name, ())):
            expected = f"another name, or {name} among its species"
            return _wrong((name,), "this class has the name of a species that it lacks", expected, name)
    return None
