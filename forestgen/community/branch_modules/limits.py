"""What a forest of branch modules may grow to, and of what; the rest is refused."""

from __future__ import annotations

from collections.abc import Collection

from forestgen.core.errors import RecipeError, ResourceError
from forestgen.recipe.suggestions import did_you_mean

MOST_SEEDS = 20_000_000  # of one step: a gigabyte


def refuse_more_modules(modules: int, most: int) -> None:
    """Raise `ResourceError` for more modules than `community.most_modules`."""
    if modules > most:
        raise ResourceError(
            "the community has too many branch modules",
            where="community.most_modules",
            expected=f"at most {most:,}",
            got=f"{modules:,}",
            hint="make the site smaller, or raise most_modules",
        )


def refuse_more_seeds(seeds: float, where: str = "community.step_yr") -> None:
    """Raise `ResourceError` for more seeds in a step than can be drawn; `where` is the key that asks for them."""
    if seeds > MOST_SEEDS:
        raise ResourceError(
            "more seeds would fall in one step than can be drawn",
            where=where,
            expected=f"at most {MOST_SEEDS:,}",
            got=f"about {seeds:,.0f}",
            hint="lower species' modules.seeds_per_yr, or seeds_per_ha of global_seeding; make steps shorter, or the "
            "site smaller",
        )


def not_growing(name: str, growing: Collection[str], where: str) -> RecipeError:
    """The error of a species that is named among those that grow by branch modules."""
    expected = "one of " + (", ".join(growing) or "none: no species has a section modules")
    return RecipeError(f"{name} does not grow by branch modules", where=where, expected=expected, got=name)


def no_prototype(name: str, known: Collection[str], where: str | None = None) -> RecipeError:
    """The error of a prototype that there is not."""
    expected, hint = "one of " + ", ".join(known), did_you_mean(name, known)
    return RecipeError("no such prototype of a module", where=where, expected=expected, got=name, hint=hint)
