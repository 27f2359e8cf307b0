"""What the page is made of: sections of facts, figures and tables, which the templates lay out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from forestgen.dataset.report.charts import Chart, Share
from forestgen.dataset.report.polar import Polar
from forestgen.dataset.report.ranges import Ranges


@dataclass(frozen=True)
class Fact:
    """A number with its name."""

    value: str
    name: str


@dataclass(frozen=True)
class ShareList:
    """Shares of a whole as a list of bars."""

    title: str
    rows: tuple[Share, ...]
    note: str = ""


@dataclass(frozen=True)
class Cell:
    """A table's cell: text, and a bar of `share` of the column's width if that is given."""

    text: str
    share: float | None = None
    warn: bool = False
    soft: str = ""  # more text, smaller


@dataclass(frozen=True)
class Row:
    """A table's row."""

    name: str
    cells: tuple[Cell, ...]
    colour: str = ""  # of its name's swatch and its bars; "" for none


@dataclass(frozen=True)
class Table:
    """A table whose rows have names."""

    title: str
    heads: tuple[str, ...]  # of the name, then of each cell
    rows: tuple[Row, ...]
    note: str = ""
    words: bool = False  # whether cells are sentences rather than numbers


Figure = Chart | ShareList | Polar | Ranges


@dataclass(frozen=True)
class Section:
    """A part of the page under one heading."""

    id: str  # in links
    title: str
    lead: str = ""
    facts: tuple[Fact, ...] = ()
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()  # warnings
    absent: str = ""  # what to say where there is nothing to show

    @property
    def empty(self) -> bool:
        return not (self.facts or self.figures or self.tables)


Part = Figure | Fact


def facts_in(parts: Sequence[Part | None]) -> tuple[Fact, ...]:
    """Those parts that are facts."""
    return tuple(one for one in parts if isinstance(one, Fact))


def figures_in(parts: Sequence[Part | None]) -> tuple[Figure, ...]:
    """Those parts that are figures."""
    return tuple(one for one in parts if one is not None and not isinstance(one, Fact))


def listed(words: Sequence[str], most: int = 8) -> str:
    """Words as a list in a sentence, the last ones counted rather than named if they are many."""
    if len(words) > most:
        return f"{', '.join(words[: most - 1])} and {len(words) - most + 1:,} more"
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
