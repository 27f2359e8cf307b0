"""Checks of a recipe's `labels.classes`; `forestgen.labels.classes` has their meaning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic_core import PydanticCustomError

from forestgen.core.parts import Part
from forestgen.recipe.fields import violation
from forestgen.recipe.suggestions import did_you_mean

OTHERS = "others"  # all species that no class names
RESERVED = ("nothing", "ground")  # classes that there always are
NO_SPECIES = (*RESERVED, "sky")  # names of what is no plant in a data set's files
MOST_CLASSES = 256 - len(RESERVED)  # of a recipe's own: a semantic mask has 8 bits
PARTS = {part.name.lower(): part for part in Part if part not in (Part.NOTHING, Part.GROUND)}  # a class may list
PLANT_PARTS = ("trunk", "branch", "leaf", "flower", "fruit", "dead_wood")


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
