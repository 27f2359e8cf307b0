"""Canopy cover: the share of a site's ground under crowns, as discs, and the crown width that gives a cover.

For every cell of a fine grid the least of (distance to a tree / its crown radius) is found; a cell is under crowns
`k` times as wide where that ratio is at most k. So one pass over the trees gives the cover for every k.
"""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats, Site
from forestgen.core.compiled import compiled

_CELLS = 4_000_000  # at most
_FINEST_M = 0.1

Ratios = NDArray[np.float32]


def crown_ratios(position_m: Floats, radius_m: Floats, site: Site, widest: float, *, periodic: bool) -> Ratios:
    """(rows, cols) least distance to a tree over its crown radius, row 0 at y = 0; infinity where above `widest`."""
    width, height = site.size_m
    cell_m = max(_FINEST_M, sqrt(site.area_m2 / _CELLS))
    ratio = np.full((max(1, ceil(height / cell_m)), max(1, ceil(width / cell_m))), np.inf, dtype=np.float32)
    inside = position_m % np.array(site.size_m) if periodic else position_m
    _lower(np.ascontiguousarray(inside), radius_m, widest, (width, height), periodic, ratio)
    return np.sqrt(ratio, out=ratio)


def cover_at(ratio: Ratios, k: float) -> float:
    """Share of the ground under crowns k times as wide."""
    return float(np.count_nonzero(ratio <= k) / ratio.size)


def width_for(ratio: Ratios, cover: float) -> float:
    """The factor of all crowns' widths that gives a cover."""
    cells = min(ratio.size - 1, max(0, round(cover * ratio.size) - 1))
    return float(np.partition(ratio.ravel(), cells)[cells])


@compiled
def _lower(position, radius, widest, size_m, periodic, ratio):  # type: ignore[no-untyped-def]
    """Lower each cell of `ratio` to the square of the distance from its middle over a radius, in place."""
    rows, cols = ratio.shape
    dx, dy = size_m[0] / cols, size_m[1] / rows
    for i in range(len(radius)):
        x, y, reach = position[i, 0], position[i, 1], widest * radius[i]
        per = 1.0 / (radius[i] * radius[i])
        top, left = floor((y - reach) / dy), floor((x - reach) / dx)
        bottom, right = floor((y + reach) / dy), floor((x + reach) / dx)
        if periodic:  # no cell twice, wherever a crown is wider than the site
            top, left = max(top, -(rows // 2)), max(left, -(cols // 2))
            bottom, right = min(bottom, top + rows - 1), min(right, left + cols - 1)
        else:
            top, left, bottom, right = max(top, 0), max(left, 0), min(bottom, rows - 1), min(right, cols - 1)
        for row in range(top, bottom + 1):
            b = abs((row + 0.5) * dy - y)
            if periodic and b > 0.5 * size_m[1]:
                b = abs(size_m[1] - b)
            r = row + rows if row < 0 else (row - rows if row >= rows else row)
            for col in range(left, right + 1):
                a = abs((col + 0.5) * dx - x)
                if periodic and a > 0.5 * size_m[0]:
                    a = abs(size_m[0] - a)
                square = a * a + b * b
                if square <= reach * reach:
                    c = col + cols if col < 0 else (col - cols if col >= cols else col)
                    ratio[r, c] = min(ratio[r, c], square * per)
