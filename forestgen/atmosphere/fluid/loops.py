"""Loops over rows of cells, compiled, on several cores.

As `core.compiled.compiled`, but a division by zero gives infinity instead of an error: without that test in their
midst the loops along a row become vector instructions. Sums are not re-ordered, so results are the same on every
processor and at any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from forestgen.core.threads import over_ranges


def loop(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as machine code, kept on disk where there is a place for it."""
    try:
        kernel: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # neither the package nor the home directory can be written to
        kernel = numba.njit(nogil=True, error_model="numpy")(function)
    return kernel


def over_slabs(count: int, cells_each: int, work: Callable[[int, int], None]) -> None:
    """``work(first, end)`` over 0 ... count in disjoint ranges, on all cores; each of the count has so many cells."""

    def slab(first_cell: int, end_cell: int) -> None:
        first, end = -(-first_cell // cells_each), -(-end_cell // cells_each)
        if first < end:
            work(first, end)

    over_ranges(count * cells_each, slab)
