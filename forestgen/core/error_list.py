"""Collects the errors of checks that do not depend on each other, to report all of them at once."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from forestgen.core.errors import AssetError, ForestgenError, LsystemError, RecipeError, RecipeErrors

P = ParamSpec("P")
T = TypeVar("T")

_PLACE = re.compile(r"^(?P<origin>.*?):(?P<line>\d+)(?::|$)")


class ErrorList:
    """Errors of a recipe, one a place: what is wrong there is said once.

    Parameters
    ----------
    origin : the recipe's file as errors name it; its errors come first.
    """

    def __init__(self, origin: str) -> None:
        self.origin = origin
        self.found: list[ForestgenError] = []

    def __bool__(self) -> bool:
        return bool(self.found)

    @property
    def places(self) -> set[str]:
        """Where the errors are."""
        return {error.where for error in self.found if error.where}

    def add(self, error: ForestgenError) -> None:
        """Add what an error holds, but for places that had errors before."""
        known = self.places
        self.found += [one for one in error.errors if one.where is None or one.where not in known]

    def add_all(self, other: ErrorList) -> None:
        known = self.places
        self.found += [one for one in other.found if one.where is None or one.where not in known]

    def attempt(self, check: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T | None:
        """The result of a check, or None if the recipe fails it."""
        try:
            return check(*arguments, **keywords)
        except (RecipeError, AssetError, LsystemError) as error:
            self.add(error)
            return None

    def raise_all(self) -> None:
        """Raise the only error, or all of them in the order of the file; nothing where there is none."""
        if len(self.found) == 1:
            raise self.found[0]
        if self.found:
            places = [_place(error) for error in self.found]
            origins = list(dict.fromkeys([self.origin, *(origin for origin, _ in places)]))
            order = sorted(range(len(places)), key=lambda k: (origins.index(places[k][0]), places[k][1]))
            raise RecipeErrors([self.found[k] for k in order]) from self.found[order[0]]


def _place(error: ForestgenError) -> tuple[str, int]:
    """File and line of an error; line 0 where it names none."""
    where = error.where or ""
    match = _PLACE.match(where)
    return (match["origin"], int(match["line"])) if match else (where.partition(": ")[0], 0)
