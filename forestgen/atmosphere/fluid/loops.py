"""Loops over rows of cells on several cores."""

from __future__ import annotations

from collections.abc import Callable

from forestgen.core.threads import over_ranges


def over_slabs(count: int, cells_each: int, work: Callable[[int, int], None]) -> None:
    """``work(first, end)`` over 0 ... count in disjoint ranges, on all cores; each of the count has so many cells."""

    def slab(first_cell: int, end_cell: int) -> None:
        first, end = -(-first_cell // cells_each), -(-end_cell // cells_each)
        if first < end:
            work(first, end)

    over_ranges(count * cells_each, slab)
