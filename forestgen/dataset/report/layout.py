"""What the page is made of: sections of facts, figures and tables, which the templates lay out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from forestgen.dataset.report.charts import Chart, Polar, Ranges, Share


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


class Cell(NamedTuple):
    """A table's cell: text, and a bar of `share` of the column's width if that is given."""

    text: str
    share: float | None = None
    warn: bool = False
    soft: str = ""  # more text, smaller


class Row(NamedTuple):
    """A table's row."""

    name: str
    cells: Sequence[Cell]
    colour: str = ""  # of its name's swatch and its bars; "" for none


class Table(NamedTuple):
    """A table whose rows have names."""

    title: str
    heads: tuple[str, ...]  # of the name, then of each cell
    rows: Sequence[Row]
    note: str = ""
    words: bool = False  # whether cells are sentences rather than numbers


Figure = Chart | ShareList | Polar | Ranges
Part = Figure | Fact


@dataclass(frozen=True)
class Section:
    """A part of the page under one heading."""

    id: str  # in links
    title: str
    absent: str  # what to say where there is nothing to show
    lead: str = ""
    parts: Sequence[Part | None] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()  # warnings

    @property
    def facts(self) -> list[Fact]:
        return [one for one in self.parts if isinstance(one, Fact)]

    @property
    def figures(self) -> list[Figure]:
        return [one for one in self.parts if one is not None and not isinstance(one, Fact)]

    @property
    def empty(self) -> bool:
        return not (self.facts or self.figures or self.tables)


def listed(words: Sequence[str], most: int = 8) -> str:
    """Words as a list in a sentence, the last ones counted rather than named if they are many."""
    if len(words) > most:
        return f"{', '.join(words[: most - 1])} and {len(words) - most + 1:,} more"
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
