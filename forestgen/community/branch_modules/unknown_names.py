"""Errors of names that are no species or prototype of branch modules."""

from __future__ import annotations

from collections.abc import Collection

from forestgen.core.errors import RecipeError
from forestgen.recipe.suggestions import did_you_mean


def not_growing(name: str, growing: Collection[str], where: str) -> RecipeError:
    """The error of a species that is named among those that grow by branch modules."""
    expected = "one of " + (", ".join(growing) or "none: no species has a section modules")
    return RecipeError(f"{name} does not grow by branch modules", where=where, expected=expected, got=name)


def no_prototype(name: str, known: Collection[str], where: str | None = None) -> RecipeError:
    """The error of a prototype that there is not."""
    expected, hint = "one of " + ", ".join(known), did_you_mean(name, known)
    return RecipeError("no such prototype of a module", where=where, expected=expected, got=name, hint=hint)
