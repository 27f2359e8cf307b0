"""What `simulate` made, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from forestgen.community.plan import CommunityPlan
from forestgen.community.population import Population
from forestgen.core.figures import count, seconds, table_lines
from forestgen.core.frames import BREAST_HEIGHT_M

_MOST_NOTES = 5  # that a summary shows


@dataclass(frozen=True)
class Stems:
    """How many plants of a species live, and how many of them a forester counts."""

    species: str
    plants: int  # that live
    stems: int  # of these, over `BREAST_HEIGHT_M`
    per_ha: float  # stems


@dataclass(frozen=True, repr=False)
class SimulationSummary:
    """What `simulate` made."""

    plan: CommunityPlan
    last: Population  # the snapshot of the last step
    plants: int  # without obstacles
    standing_dead: int  # of the plants
    counts: dict[str, int]  # plants by species
    stems: tuple[Stems, ...]  # by species
    notes: tuple[str, ...]  # for people
    timings_s: dict[str, float]
    total_s: float

    @property
    def biome(self) -> str | None:
        """What people call land of the climate that chose the recipe's species; None if no climate did."""
        from forestgen.recipe.biome import biome_name

        biome = self.plan.drawn.recipe.community.parameters.get("biome")
        if not biome:
            return None
        warmth, rain = biome["temperature_c"], biome["precipitation_mm_per_yr"]
        return f"{biome_name(warmth, rain)}, of {warmth:g} deg C and {rain:g} mm a year"

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        return f"<SimulationSummary: {count(self.plants, 'plant')}, {count(len(self.notes), 'note')}>"

    def lines(self, *, verbose: bool = False) -> Iterator[str]:
        """For people; `verbose`: with all notes."""
        kinds = ", ".join(f"{number:,} {name}" for name, number in self.counts.items())
        dead = f", {self.standing_dead:,} of them standing dead" if self.standing_dead else ""
        yield f"{count(self.plants, 'plant')} ({kinds}){dead}"
        yield from _stem_lines(self.stems)
        if self.biome:
            yield f"biome: {self.biome}"
        shown = self.notes if verbose else self.notes[:_MOST_NOTES]
        for note in shown:
            yield f"note: {note}"
        if len(self.notes) > len(shown):
            yield f"note: {len(self.notes) - len(shown)} more notes: `verbose` shows all"
        yield f"simulated in {seconds(self.timings_s['community'])}"


def _stem_lines(stems: Sequence[Stems]) -> list[str]:
    """What a forester counts, by species: living plants over breast height."""
    if not any(one.plants for one in stems):
        return []
    rows = [("living", "plants", f"stems over {BREAST_HEIGHT_M} m", "stems per ha")]
    rows += [(one.species, f"{one.plants:,}", f"{one.stems:,}", f"{one.per_ha:,.0f}") for one in stems]
    if len(stems) > 1:
        sums = (sum(one.plants for one in stems), sum(one.stems for one in stems), sum(one.per_ha for one in stems))
        rows.append(("all", *(f"{value:,.0f}" for value in sums)))  # type: ignore[arg-type]
    return table_lines(rows)
