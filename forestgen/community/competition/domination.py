"""Domination: of any two circles that intersect (touching counts), the smaller gets nothing.

References: O. Deussen et al., Realistic modeling and rendering of plant ecosystems, SIGGRAPH 1998, after the first of
two models; B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, Figure 3.1, sections
4.3 and 4.5. ::

    c_i = 0  where a circle j exists with |x_i - x_j| <= r_i + r_j  and  r_j > r_i
    c_i = 1  elsewhere

There are no parameters. Heights and species have no influence. A dominated circle dominates smaller ones all the same.

Decided where the thesis is silent: of two equal circles the one with the higher plant_id, the later born, is
dominated, so that the answer depends neither on the order of rows nor on rounding.

Method: the neighbour grid. The circle of highest rank (radius, then age) comes first in its cell; a crowded cell is
sorted by rank. The search for a circle ends at the first circle that dominates it. The decision is that of float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.community.competition import grid
from forestgen.community.competition.contract import Circles
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled
from forestgen.core.threads import parallel_for
from forestgen.recipe.fields import Section

_CROWD = 64  # members


class DominationParameters(Section):
    """None: the circles say everything."""


@compiled
def _beats(j, i, strength, circle, plant_id):  # type: ignore[no-untyped-def]
    """Whether circle `j` has the higher rank of two: the greater strength, or of equal ones the lower plant_id."""
    sj, si = strength[j], strength[i]
    return sj > si or (sj == si and plant_id[int(circle[j, 3])] < plant_id[int(circle[i, 3])])


@compiled
def _meets(j, i, circle, size_m, periodic):  # type: ignore[no-untyped-def]
    """Whether two circles intersect or touch."""
    reach = circle[i, 2] + circle[j, 2]
    return grid.near(circle[i, 0], circle[i, 1], circle[j, 0], circle[j, 1], reach, size_m, periodic)


@compiled
def _sort(low, size, entry, strength, circle, plant_id):  # type: ignore[no-untyped-def]
    """Heapsort of `size` entries from `low` by rank, the highest first."""
    for step in range(size // 2 + size - 1):
        hole, last = size // 2 - 1 - step, size
        if step >= size // 2:
            hole, last = 0, size - 1 - (step - size // 2)
            entry[low], entry[low + last] = entry[low + last], entry[low]
        moved = entry[low + hole]
        child = 2 * hole + 1
        while child < last:
            if child + 1 < last and _beats(entry[low + child], entry[low + child + 1], strength, circle, plant_id):
                child += 1
            if not _beats(moved, entry[low + child], strength, circle, plant_id):
                break
            entry[low + hole] = entry[low + child]
            hole, child = child, 2 * child + 1
        entry[low + hole] = moved


@compiled
def _rank(first, end, g, strength, plant_id, ranked):  # type: ignore[no-untyped-def]
    """Bring each cell's member of highest rank to its front; put the cells of a crowd in order of rank."""
    circle, entry, start = g.circle, g.entry, g.start
    for c in range(first, end):
        low, size = np.int64(start[c]), np.int64(start[c + 1]) - np.int64(start[c])
        ranked[c] = size > _CROWD
        if ranked[c]:
            _sort(low, size, entry, strength, circle, plant_id)
            continue
        for k in range(low + 1, low + size):
            if _beats(entry[k], entry[low], strength, circle, plant_id):
                entry[low], entry[k] = entry[k], entry[low]


@compiled
def _search(first, end, g, strength, plant_id, ranked, out):  # type: ignore[no-untyped-def]
    """Set `out` for circles `first` to `end` of the grid: whether a circle of higher rank meets them."""
    circle, entry, start, n, per_m, size_m, periodic = g
    for i in range(first, end):
        beaten = False
        x0, across, y0, along = grid.box(circle[i, 0], circle[i, 1], circle[i, 2], n, per_m, periodic)
        for b in range(along):
            line = grid.wrapped(y0 + b, n[1]) * n[0]
            for a in range(across):
                cell = line + grid.wrapped(x0 + a, n[0])
                for k in range(start[cell], start[cell + 1]):
                    j = entry[k]
                    if strength[j] >= strength[i]:
                        beaten = _meets(j, i, circle, size_m, periodic) and _beats(j, i, strength, circle, plant_id)
                        if beaten:
                            break
                    elif ranked[cell]:
                        break
                if beaten:
                    break
            if beaten:
                break
        out[int(circle[i, 3])] = beaten


def dominated(
    position_m: Floats,
    radius_m: Floats,
    plant_id: NDArray[np.uint32],
    size_m: tuple[float, float],
    *,
    periodic: bool,
    strength: Floats | None = None,
) -> NDArray[np.bool_]:
    """(N,) which of the circles, (N, 2) positions and (N,) radii in metres, intersect or touch a stronger one.

    `strength` (N,) is the radius by default; of equal strengths the lower `plant_id` wins. `periodic`: the site is a
    torus; otherwise it lies in the plane.
    """
    out = np.zeros(len(radius_m), dtype=np.bool_)
    if len(radius_m) > 1:
        cells = grid.build(position_m, radius_m, size_m, periodic=periodic)
        ranks = (radius_m if strength is None else strength)[cells.circle[:, 3].astype(np.intp)]
        ranked = np.zeros(len(cells.start) - 1, dtype=np.bool_)
        parallel_for(len(ranked), lambda first, end: _rank(first, end, cells, ranks, plant_id, ranked))
        parallel_for(len(out), lambda first, end: _search(first, end, cells, ranks, plant_id, ranked, out))
    return out


class Domination:
    Parameters = DominationParameters
    needs_heights = False

    def answer(
        self, parameters: DominationParameters, circles: Circles, size_m: tuple[float, float], *, periodic: bool
    ) -> Floats:
        """c: 0.0 dominated, 1.0 not."""
        smaller = dominated(circles.position_m, circles.radius_m, circles.plant_id, size_m, periodic=periodic)
        return np.where(smaller, 0.0, 1.0)


MODEL = Domination()
