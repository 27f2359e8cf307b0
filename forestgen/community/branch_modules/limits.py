"""What a forest of branch modules may grow to; more is told before memory is asked for."""

from __future__ import annotations

from forestgen.core.errors import ResourceError

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
