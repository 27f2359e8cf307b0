"""What `forestgen.pipeline.simulate` made, and the words that show it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from forestgen.community.population import Population, count_by_species, stems_by_species
from forestgen.community.simulation import CommunityPlan, counts_of, dead_plants
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
    notes: tuple[str, ...]  # for people
    timings_s: dict[str, float]
    total_s: float

    @cached_property
    def _plants(self) -> Population:
        return self.plan.obstacles.left_out_of(self.last)

    @property
    def plants(self) -> int:
        """How many there are, without obstacles."""
        return len(self._plants)

    @property
    def dead(self) -> int:
        """How many of the plants are dead."""
        return dead_plants(self._plants)

    @property
    def counts(self) -> dict[str, int]:
        """Plants by species."""
        return counts_of(self._plants)

    @property
    def stems(self) -> tuple[Stems, ...]:
        """By species."""
        alive, stems = count_by_species(self._plants), stems_by_species(self._plants)
        area_m2 = self.plan.site.area_m2
        return tuple(Stems(name, alive[name], number, number / area_m2 * 1e4) for name, number in stems.items())

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
        dead = f", {self.dead:,} of them dead" if self.dead else ""
        yield f"{count(self.plants, 'plant')} ({kinds}){dead}"
        yield from self._stem_lines()
        if self.biome:
            yield f"biome: {self.biome}"
        shown = self.notes if verbose else self.notes[:_MOST_NOTES]
        for note in shown:
            yield f"note: {note}"
        if len(self.notes) > len(shown):
            yield f"note: {len(self.notes) - len(shown)} more notes: `verbose` shows all"
        yield f"simulated in {seconds(self.timings_s['community'])}"

    def _stem_lines(self) -> list[str]:
        """What a forester counts, by species: living plants over breast height."""
        found = list(self.stems)
        if not any(one.plants for one in found):
            return []
        if len(found) > 1:
            sums = (sum(getattr(one, name) for one in found) for name in ("plants", "stems", "per_ha"))
            found.append(Stems("all", *sums))
        rows = [("living", "plants", f"stems over {BREAST_HEIGHT_M} m", "stems per ha")]
        rows += [(one.species, f"{one.plants:,}", f"{one.stems:,}", f"{one.per_ha:,.0f}") for one in found]
        return table_lines(rows)
