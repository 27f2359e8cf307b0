"""Zones of influence: ground that several plants reach is divided among them, the tallest first.

Reference: L. G. Firbank and A. R. Watkinson, A model of interference within plant monocultures, Journal of Theoretical
Biology 116 (1985) 291-311, as in B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002,
section 3.1. A plant's mass is that of an isolated one times (z / q)^r; the answer is z / q::

    q_i = pi r_i^2                                the ecological neighbourhood, a circle
    z_i = integral over it of w(k, n)             n: how many circles cover a point; k: i's rank by height, tallest 0
    w(k, n) = d (1 - d)^k  for k < n - 1,         (1 - d)^(n - 1)  for the last

The tallest gets a fraction d, the next d of the remainder, ..., the last what is left: so n = 1 gets all, the shares of
a point sum to 1, and the zones of all plants to the area of the union of circles.

Parameters: see below; d is one_sided.

d = 1: the tallest takes everything; d = 0.5 divides equally between two. Decided where the thesis is silent: the last
gets the remainder (otherwise a part of the ground would be unused), of equal heights the lower plant_id counts as
taller, and d = 0.9 unless said otherwise. A circle that a small torus lets overlap itself competes with its images, so
that the zones still sum to the union.

Method, exact but for rounding: w is constant between arcs, so by Green's theorem z_i is a sum over the arcs in and on
circle i, each times the jump of w across it. One walk round every circle, with the set of circles that cover each arc,
serves all of them. Time goes with the square of the number of circles that a circle meets.
"""

from __future__ import annotations

from math import acos, atan2, cos, pi, sin, sqrt

import numpy as np
from pydantic import Field

from forestgen.community.competition import grid
from forestgen.community.competition.contract import Circles
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled
from forestgen.recipe.fields import Section


class FirbankWatkinsonParameters(Section):
    """How shared ground is divided."""

    one_sided: float = Field(0.9, gt=0, le=1, description="d: the part of shared ground that the tallest gets")


@compiled
def _covers(d, r, s, rank, other_rank, same):  # type: ignore[no-untyped-def]
    """How much of the edge of a circle of radius `r` the disc `s` covers, `d` away: 0 nothing, 1 a part, 2 all.

    Of two equal discs in one place that of lower rank number is held to be larger by a hair.
    """
    if d == 0 and r == s:
        return 2 if not same and other_rank < rank else 0
    if d >= r + s or d + s <= r:
        return 0
    return 2 if d + r <= s else 1


@compiled
def _enlist(table, m, dx, dy, r, s, rank, other_rank, j, same):  # type: ignore[no-untyped-def]
    """Append a neighbour to row `m` of the table if its disc covers some of the edge; table and number of rows.

    A row: the centre dx, dy from that of the circle walked round, radius, rank by height, index in the grid, and the
    angle about which the disc covers the circle's edge, as far as so many radians to either side.
    """
    d = sqrt(dx * dx + dy * dy)
    how = _covers(d, r, s, rank, other_rank, same)
    if how == 0:
        return table, m
    if m == len(table):
        wider = np.empty((2 * m, 7))
        for k in range(m):  # an assignment of slices takes Numba five seconds to compile
            for column in range(7):
                wider[k, column] = table[k, column]
        table = wider
    middle, half = 0.0, 2 * pi
    if how == 1:
        middle = atan2(dy, dx)
        half = acos(min(max((d * d + (r - s) * (r + s)) / (2 * d * r), -1.0), 1.0))
    table[m, 0], table[m, 1], table[m, 2], table[m, 3], table[m, 4] = dx, dy, s, other_rank, j
    table[m, 5], table[m, 6] = middle, half
    return table, m + 1


@compiled
def _neighbours(i, circle, entry, start, n, per_m, size_m, periodic, rank, table):  # type: ignore[no-untyped-def]
    """Fill the table from row 1 (row 0 is circle `i` itself); the table and its number of rows."""
    x, y, r, own = circle[i, 0], circle[i, 1], circle[i, 2], rank[int(circle[i, 3])]
    table[0, 0], table[0, 1], table[0, 2], table[0, 3], table[0, 4] = 0.0, 0.0, r, own, i
    m = 1
    x0, across, y0, along = grid.box(x, y, r, n, per_m, periodic)
    for b in range(along):
        for a in range(across):
            cell = grid.wrapped(y0 + b, n[1]) * n[0] + grid.wrapped(x0 + a, n[0])
            for k in range(start[cell], start[cell + 1]):
                j = entry[k]
                u, v, s = circle[j, 0], circle[j, 1], circle[j, 2]
                if not grid.near(x, y, u, v, r + s, size_m, periodic):
                    continue
                if not grid.first_shared(a, b, x0, y0, u, v, s, n, per_m, periodic):
                    continue
                left, right = grid.images(u - x, r + s, size_m[0], periodic)
                low, high = grid.images(v - y, r + s, size_m[1], periodic)
                for f in range(low, high + 1):
                    for e in range(left, right + 1):
                        if i != j or e != 0 or f != 0:
                            dx, dy = u - x + e * size_m[0], v - y + f * size_m[1]
                            other = rank[int(circle[j, 3])]
                            table, m = _enlist(table, m, dx, dy, r, s, own, other, j, i == j)
    return table, m


@compiled
def _taller(e, f, table):  # type: ignore[no-untyped-def]
    """Whether neighbour `e` comes before `f`: by height and age, images of one plant by place."""
    if table[e, 3] != table[f, 3]:
        return table[e, 3] < table[f, 3]
    return table[e, 0] < table[f, 0] or (table[e, 0] == table[f, 0] and table[e, 1] < table[f, 1])


@compiled
def _cover(at, m, table, over):  # type: ignore[no-untyped-def]
    """Set the first of `over` to the neighbours that cover the edge at an angle, the tallest first; their number."""
    depth = 0
    for e in range(1, m):
        apart = abs(at - table[e, 5])
        if min(apart, 2 * pi - apart) <= table[e, 6]:
            k = depth
            while k > 0 and _taller(e, over[k - 1], table):
                over[k] = over[k - 1]
                k -= 1
            over[k] = e
            depth += 1
    return depth


@compiled
def _add_arc(a, b, over, depth, table, d, zone):  # type: ignore[no-untyped-def]
    """Add to every zone what the arc from angle `a` to `b` of circle 0 of the table bounds of it."""
    r = table[0, 2]
    turn, right, up = b - a, sin(b) - sin(a), cos(a) - cos(b)
    left = 1.0  # of the ground, after those taller than the k-th have taken theirs
    place = depth
    for k in range(depth):
        e = over[k]
        if place == depth and _taller(0, e, table):
            place = k
        outside = left if k == depth - 1 else d * left
        inside = d * left
        if k >= place:
            inside = (left if k == depth - 1 else d * left) * (1 - d)
        area = 0.5 * (r * r * turn - r * (table[e, 0] * right + table[e, 1] * up))
        zone[int(table[e, 4])] += (inside - outside) * area
        left *= 1 - d
    own = (1 - d) ** place if place == depth else d * (1 - d) ** place
    zone[int(table[0, 4])] += own * 0.5 * r * r * turn


@compiled
def _ends(m, table, angle):  # type: ignore[no-untyped-def]
    """Set the first of `angle` to where discs begin and end to cover the edge; their number."""
    count = 0
    for e in range(1, m):
        if 0 < table[e, 6] < pi:
            for end in (table[e, 5] - table[e, 6], table[e, 5] + table[e, 6]):
                angle[count] = end + 2 * pi if end < -pi else (end - 2 * pi if end > pi else end)
                count += 1
    return count


@compiled
def _walk(g, rank, d, zone):  # type: ignore[no-untyped-def]
    """Walk round every circle and add up the zones, (N,) in the order of the grid."""
    circle, entry, start, n, per_m, size_m, periodic = g
    table = np.empty((64, 7))
    angle, over = np.empty(129), np.empty(64, dtype=np.int64)
    for i in range(len(circle)):
        table, m = _neighbours(i, circle, entry, start, n, per_m, size_m, periodic, rank, table)
        if len(over) < len(table):
            angle, over = np.empty(2 * len(table) + 1), np.empty(len(table), dtype=np.int64)
        count = _ends(m, table, angle)
        angle[count], at = pi, -pi
        for end in np.sort(angle[: count + 1]):
            if end > at:
                _add_arc(at, end, over, _cover((at + end) / 2, m, table, over), table, d, zone)
                at = end


class FirbankWatkinson:
    Parameters = FirbankWatkinsonParameters
    needs_heights = True

    def answer(
        self, parameters: FirbankWatkinsonParameters, circles: Circles, size_m: tuple[float, float], *, periodic: bool
    ) -> Floats:
        """z / q."""
        n = len(circles)
        if not n:
            return np.ones(0)
        rank = np.empty(n, dtype=np.uint32)
        rank[np.lexsort((circles.plant_id, -circles.height_m))] = np.arange(n, dtype=np.uint32)
        cells = grid.build(circles.position_m, circles.radius_m, size_m, periodic=periodic)
        zone = np.zeros(n)
        _walk(cells, rank, parameters.one_sided, zone)
        share = np.empty(n)
        share[cells.circle[:, 3].astype(np.uint32)] = zone / (np.pi * cells.circle[:, 2] ** 2)
        return np.clip(share, 0.0, 1.0, out=share)


MODEL = FirbankWatkinson()
