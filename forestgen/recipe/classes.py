"""What a recipe's `labels.classes` may say; what it means stands in `forestgen.labels.classes`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from forestgen.core.parts import Part
from forestgen.recipe.suggestions import did_you_mean

OTHERS = "others"  # all species that no class names
RESERVED = ("nothing", "ground")  # classes that there always are
NO_SPECIES = (*RESERVED, "sky")  # names of what is no plant in a data set's files
MOST_CLASSES = 256 - len(RESERVED)  # of a recipe's own: a semantic mask has 8 bits
PARTS = {part.name.lower(): part for part in Part if part not in (Part.NOTHING, Part.GROUND)}  # a class may list
PLANT_PARTS = ("trunk", "branch", "leaf", "flower", "fruit", "dead_wood")


@dataclass(frozen=True)
class ClassMistake:
    """What is wrong with a recipe's classes."""

    at: tuple[str | int, ...]  # keys below labels.classes
    problem: str
    expected: str
    got: str
    hint: str | None = None


def check_classes(classes: Mapping[str, Sequence[str]], species: Sequence[str]) -> ClassMistake | None:
    """The first mistake in `classes`, or None.

    Parameters
    ----------
    classes : class name -> names of species and parts in it.
    species : the recipe's.
    """
    seen: dict[str, str] = {}
    for key, members in classes.items():
        if key.lower() in RESERVED:
            return ClassMistake((key,), "this class is there already", "another name than nothing or ground", key)
        for index, name in enumerate(members):
            wrong = _wrong_member(name, species)
            if wrong is None and name in seen:
                wrong = "in two classes", "each species and part in one class", f"{name}, also in {seen[name]}", None
            if wrong is not None:
                return ClassMistake((key, index), *wrong)
            seen[name] = key
    return _left_over(seen, species) or _same_name(classes, seen, species)


def _wrong_member(name: str, species: Sequence[str]) -> tuple[str, str, str, str | None] | None:
    if name in species and name in PARTS:
        both = f"{name}, which is both a species and a part"
        return "this name is ambiguous", "a species or a part", both, "give the species another name"
    known = [*species, *PARTS, OTHERS]
    if name in known:
        return None
    hint = did_you_mean(name.lower(), known)
    return "neither a species of the recipe nor a part", "one of " + ", ".join(known), repr(name), hint


def _left_over(seen: Mapping[str, str], species: Sequence[str]) -> ClassMistake | None:
    parts = [part for part in PLANT_PARTS if part not in seen]
    if not parts or (OTHERS in seen and OTHERS not in species):
        return None
    for name in species:
        if name not in seen:
            which = "" if len(parts) == len(PLANT_PARTS) else f": its {', '.join(parts)}"
            return ClassMistake(
                (),
                "a species is in no class",
                "every species in a class",
                f"{name}{which}",
                f"add {name}, or `others` for all species that are not named, to a class",
            )
    return None


def _same_name(
    classes: Mapping[str, Sequence[str]], seen: Mapping[str, str], species: Sequence[str]
) -> ClassMistake | None:
    """A class of species is a category of instances, and so is a species that only classes of parts cover."""
    if OTHERS in seen and OTHERS not in species:
        return None
    for name in species:
        if name not in seen and {*species, OTHERS} & set(classes.get(name, ())):
            expected = f"another name, or {name} among its species"
            return ClassMistake((name,), "this class has the name of a species that it lacks", expected, name)
    return None
