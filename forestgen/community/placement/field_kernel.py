"""Compiled loops of the probability field: sums over its cells, draws from it, and its deformation.

Cells stand in strips of eight columns, one row of a strip after another: a row of a strip is one line of the
processor's memory, and the rows that a plant reaches are neighbours in memory. Above the cells each row has a tree of
sums: of its strips, of eight strips, of 64 ...; eight sums that have one parent are again one line. The sums of whole
rows have such a tree too. A plant changes some rows, and one or two nodes on each level of each of them and above them.
Each node is the sum of its children, taken anew, so that no rounding error grows with the number of plants. A draw
walks down both trees. What a plant costs grows with the kernel's reach, and with the logarithm of the field's size.
"""

from __future__ import annotations

from math import ceil, floor, frexp, ldexp
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.field import LANES
from forestgen.community.placement.field_lanes import (
    SMALLEST,
    ask_for,
    load,
    multiply_by_table,
    multiply_near,
    pointer,
    store,
    sum_line,
    sum_near,
)
from forestgen.core.compiled import contracted

AHEAD = 16  # plants whose memory is asked for before the first of them is placed
FAR = 64  # lines: a kernel that reaches more is not asked for ahead
GREATEST_TOTAL, SMALLEST_TOTAL = 1e250, 1e-150  # outside, a field is scaled by a power of two
LEAST_LEFT = 1e-200  # of the sum within reach: a balanced kernel that leaves less bars all of it
EDGE = 2.0**-32  # of a cell: places keep this far from its edges, so that rounding moves none into the next cell


class Trees(NamedTuple):
    """Cells and sums of one or more fields of the same shape, one after another; inside kernels, pointers to them."""

    cells: Any  # (F, strips, rows, 8) float64; what lies beyond a row's last cell is 0
    nodes: Any  # (F, panels of all levels, rows, 8) float64: sums of strips, of eight strips, ...
    sums: Any  # (F, sum_stride) float64: of the rows, of eight rows, ...
    node_level: Any  # (levels,) int64: where each level begins
    sum_level: Any  # (levels,) int64
    node_levels: int
    sum_levels: int
    rows: int
    cols: int
    strips: int
    cell_stride: int  # numbers of a field
    node_stride: int
    sum_stride: int
    width_m: float  # of a cell
    height_m: float
    periodic: bool


class Effects(NamedTuple):
    """The kernels, K in all."""

    which: NDArray[np.int64]  # (F, S) kernel of a plant of species S on field F; -1: none
    tables: NDArray[np.float64]  # (K, samples + 2): κ at even distances up to the reach, the last one twice
    constant: NDArray[np.bool_]  # (K,) κ is the same all over
    balanced: NDArray[np.bool_]  # (K,)
    reach: NDArray[np.float64]  # (K,) in radii or metres
    in_radii: NDArray[np.bool_]  # (K,)


@contracted
def _pointed(t):  # type: ignore[no-untyped-def]
    """The trees by pointers: Numba would count references to arrays in every call."""
    return Trees(
        pointer(t.cells),
        pointer(t.nodes),
        pointer(t.sums),
        pointer(t.node_level),
        pointer(t.sum_level),
        t.node_levels,
        t.sum_levels,
        t.rows,
        t.cols,
        t.strips,
        t.cell_stride,
        t.node_stride,
        t.sum_stride,
        t.width_m,
        t.height_m,
        t.periodic,
    )


@contracted
def _pick(line, i, u):  # type: ignore[no-untyped-def]
    """Of eight numbers the k in which the partial sums pass u, and what of u is left there; never one that is 0."""
    c0, c1, c2, c3 = load(line, i), load(line, i + 1), load(line, i + 2), load(line, i + 3)
    c4, c5, c6 = load(line, i + 4), load(line, i + 5), load(line, i + 6)
    s1, s23, s45 = c0 + c1, c2 + c3, c4 + c5
    s2, s3 = s1 + c2, s1 + s23
    s4, s5 = s3 + c4, s3 + s45
    s6 = s5 + c6
    k = ((c0 <= u) + (s1 <= u)) + ((s2 <= u) + (s3 <= u)) + ((s4 <= u) + (s5 <= u)) + (s6 <= u)
    below = c0 if c0 <= u else 0.0
    below = s1 if s1 <= u else below
    below = s2 if s2 <= u else below
    below = s3 if s3 <= u else below
    below = s4 if s4 <= u else below
    below = s5 if s5 <= u else below
    below = s6 if s6 <= u else below
    u -= below
    value = load(line, i + k)
    if u < value:
        return k, u
    while k > 0 and not value > 0.0:  # u has reached the sum, by rounding: the last that is not 0
        k -= 1
        value = load(line, i + k)
    return k, value


@contracted
def _row(t, f, u):  # type: ignore[no-untyped-def]
    """The row in which the partial sums of the rows pass u, and what of u is left."""
    at, base = 0, f * t.sum_stride
    for level in range(t.sum_levels - 1, -1, -1):
        k, u = _pick(t.sums, base + load(t.sum_level, level) + at * LANES, u)
        at = at * LANES + k
    return at, u


@contracted
def _strips(t, f, row, v, least):  # type: ignore[no-untyped-def]
    """The same along a row: the node of level `least`, where the strips are level 0."""
    at, base = 0, f * t.node_stride
    for level in range(t.node_levels - 1, least - 1, -1):
        k, v = _pick(t.nodes, base + load(t.node_level, level) + (at * t.rows + row) * LANES, v)
        at = at * LANES + k
    return at, v


@contracted
def _inside(u, value):  # type: ignore[no-untyped-def]
    return min(max(u / value, EDGE), 1.0 - EDGE)


@contracted
def _draw(t, f, total, u, v):  # type: ignore[no-untyped-def]
    """x, y in cells, of two numbers in [0, 1)."""
    row, u = _row(t, f, u * total)
    of_row = load(t.sums, f * t.sum_stride + row)
    strip, v = _strips(t, f, row, v * of_row, 0)
    line = f * t.cell_stride + (strip * t.rows + row) * LANES
    k, v = _pick(t.cells, line, v)
    return strip * LANES + k + _inside(v, load(t.cells, line + k)), row + _inside(u, of_row)


@contracted
def _renew(t, f, i0, i1, b0, b1):  # type: ignore[no-untyped-def]
    """All sums above the strips b0 .. b1 in rows i0 .. i1, whose own sums are right; the field's total."""
    base = f * t.node_stride
    for level in range(1, t.node_levels):
        below, above = base + load(t.node_level, level - 1), base + load(t.node_level, level)
        b0, b1 = b0 // LANES, b1 // LANES
        for b in range(b0, b1 + 1):
            child, parent = below + b * t.rows * LANES, above + (b // LANES) * t.rows * LANES + b % LANES
            for i in range(i0, i1 + 1):
                store(t.nodes, parent + i * LANES, sum_line(t.nodes, child + i * LANES))
    top, sums = base + load(t.node_level, t.node_levels - 1), f * t.sum_stride
    for i in range(i0, i1 + 1):
        store(t.sums, sums + i, sum_line(t.nodes, top + i * LANES))
    for level in range(1, t.sum_levels):
        below, above = sums + load(t.sum_level, level - 1), sums + load(t.sum_level, level)
        i0, i1 = i0 // LANES, i1 // LANES
        for i in range(i0, i1 + 1):
            store(t.sums, above + i, sum_line(t.sums, below + i * LANES))
    return total_of_pointed(t, f)


@contracted
def total_of_pointed(t, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    return sum_line(t.sums, f * t.sum_stride + load(t.sum_level, t.sum_levels - 1))


@contracted
def _patch(t, f, squares, r_m, table, last, factor, window, x, y):  # type: ignore[no-untyped-def]
    """Multiply the cells of a window by `table`, or by `factor` if `last` is 0; a factor < 0 only sums.

    Returns the field's total, or the sum within reach.
    """
    i0, i1, j0, j1 = window
    b0, b1 = j0 // LANES, j1 // LANES
    r2, near, scale = r_m * r_m, 0.0, last / r_m
    nodes = f * t.node_stride
    for b in range(b0, b1 + 1):
        for k in range(LANES):
            j = b * LANES + k
            dx = (j + 0.5 - x) * t.width_m
            store(squares, k, dx * dx if (j >= j0) & (j <= j1) else np.inf)
        line, node = f * t.cell_stride + b * t.rows * LANES, nodes + (b // LANES) * t.rows * LANES + b % LANES
        for i in range(i0, i1 + 1):
            dy = (i + 0.5 - y) * t.height_m
            dy2, at = dy * dy, line + i * LANES
            if last > 0.0:
                value = multiply_by_table(t.cells, at, squares, dy2, r2, scale, last, table)
            elif factor >= 0.0:
                value = multiply_near(t.cells, at, squares, dy2, r2, factor)
            else:
                near += sum_near(t.cells, at, squares, dy2, r2)
                continue
            store(t.nodes, node + i * LANES, value)
    return near if factor < 0.0 else _renew(t, f, i0, i1, b0, b1)


@contracted
def _reached(at, reach, cells, periodic):  # type: ignore[no-untyped-def]
    """First and last cell in reach along an axis; if periodic maybe beyond the edges, but no cell twice."""
    reach = min(reach, 2.0 * cells) + 1e-9
    first, last = ceil(at - reach - 0.5), floor(at + reach - 0.5)
    if not periodic:
        return max(first, 0), min(last, cells - 1)
    if last - first >= cells:  # each at its least distance
        first = ceil(at - 0.5 * cells - 0.5)
        last = first + cells - 1
    return first, last


@contracted
def _patches(t, f, squares, r_m, table, last, factor, x, y):  # type: ignore[no-untyped-def]
    """`_patch` wherever a disc around (x, y) meets the site: up to four times if the site is periodic."""
    i0, i1 = _reached(y, r_m / t.height_m, t.rows, t.periodic)
    j0, j1 = _reached(x, r_m / t.width_m, t.cols, t.periodic)
    result, near = -1.0, 0.0
    for a in range(-1 if i1 >= t.rows else 0, 2 if i0 < 0 else 1):
        top, bottom = max(i0 + a * t.rows, 0), min(i1 + a * t.rows, t.rows - 1)
        if top > bottom:
            continue
        for b in range(-1 if j1 >= t.cols else 0, 2 if j0 < 0 else 1):
            left, right = max(j0 + b * t.cols, 0), min(j1 + b * t.cols, t.cols - 1)
            if left <= right:
                window = (top, bottom, left, right)
                result = _patch(t, f, squares, r_m, table, last, factor, window, x + b * t.cols, y + a * t.rows)
                near += result
    return near if factor < 0.0 else result


@contracted
def _deform(t, f, total, squares, table, last, first_value, balanced, r_m, x, y):  # type: ignore[no-untyped-def]
    """The field after a plant at (x, y); returns its total. `last` is 0 if κ is `first_value` all over."""
    before = _patches(t, f, squares, r_m, table, 0.0, -1.0, x, y) if balanced else 0.0
    new = _patches(t, f, squares, r_m, table, last, first_value, x, y)
    if balanced and before > 0.0:
        after = _patches(t, f, squares, r_m, table, 0.0, -1.0, x, y)
        if after > before * LEAST_LEFT:
            new = _patches(t, f, squares, r_m, table, 0.0, before / after, x, y)
    return total if new < 0.0 else new  # < 0: no cell's middle is in reach


@contracted
def _build(t, f):  # type: ignore[no-untyped-def]
    """All sums of a field; its total."""
    for b in range(t.strips):
        line = f * t.cell_stride + b * t.rows * LANES
        node = f * t.node_stride + (b // LANES) * t.rows * LANES + b % LANES
        for i in range(t.rows):
            store(t.nodes, node + i * LANES, sum_line(t.cells, line + i * LANES))
    return _renew(t, f, 0, t.rows - 1, 0, t.strips - 1)


@contracted
def _kept(t, f, total, exponents):  # type: ignore[no-untyped-def]
    """Scale a field whose total has become too great or too small; its total."""
    if total == 0.0 or SMALLEST_TOTAL <= total <= GREATEST_TOTAL:
        return total
    _, exponent = frexp(total)
    factor = ldexp(1.0, -exponent)
    for k in range(f * t.cell_stride, (f + 1) * t.cell_stride):
        value = load(t.cells, k) * factor
        store(t.cells, k, value if value >= SMALLEST else 0.0)
    exponents[f] += exponent
    return _build(t, f)


@contracted
def build(trees, exponents):  # type: ignore[no-untyped-def]
    """All sums of all fields."""
    t = _pointed(trees)
    for f in range(len(exponents)):
        _kept(t, f, _build(t, f), exponents)


@contracted
def total_of(trees, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    return total_of_pointed(_pointed(trees), f)


@contracted
def draw_all(trees, f, uniform, places):  # type: ignore[no-untyped-def]
    """Places, (N, 2) in cells, of (N, 2) numbers; the field stays."""
    t = _pointed(trees)
    total = total_of_pointed(t, f)
    for n in range(len(uniform)):
        places[n, 0], places[n, 1] = _draw(t, f, total, uniform[n, 0], uniform[n, 1])


@contracted
def _ask_ahead(t, totals, lines, species, uniform, first, end, rows, panels, rests):  # type: ignore[no-untyped-def]
    """Ask for the memory that plants first .. end - 1 will need, where they would stand in the field as it is now.

    Few of them will stand far from there: one plant moves the next by a small fraction of a cell. It changes no result.
    """
    least = min(t.node_levels - 1, 1)
    for n in range(first, end):
        f, m = species[n], n - first
        row, _ = _row(t, f, uniform[n, 0] * totals[f])
        panel, rest = _strips(t, f, row, uniform[n, 1] * load(t.sums, f * t.sum_stride + row), least)
        rows[m], panels[m], rests[m] = row, panel, rest
        panel = panel if least else 0
        for i in range(max(row - lines[n, 0], 0), min(row + lines[n, 0], t.rows - 1) + 1):
            ask_for(t.nodes, f * t.node_stride + (panel * t.rows + i) * LANES)
    for n in range(first, end):
        f, m = species[n], n - first
        row, strip, rest = rows[m], panels[m], rests[m]
        if least:
            k, rest = _pick(t.nodes, f * t.node_stride + (strip * t.rows + row) * LANES, rest)
            strip = strip * LANES + k
        near = 2.0 * rest < load(t.nodes, f * t.node_stride + (strip // LANES * t.rows + row) * LANES + strip % LANES)
        left = strip - lines[n, 1] + (not near)
        for b in range(max(left, 0), min(left + 2 * lines[n, 1] - 1, t.strips - 1) + 1):
            start = f * t.cell_stride + b * t.rows * LANES
            for i in range(max(row - lines[n, 0], 0), min(row + lines[n, 0], t.rows - 1) + 1):
                ask_for(t.cells, start + i * LANES)


@contracted
def _lines(t, effects, species, radius_m):  # type: ignore[no-untyped-def]
    """(N, 2) rows above and below, and strips to each side, that plants reach in their own field; 0 if too many."""
    lines = np.zeros((len(species), 2), np.int64)
    for n in range(len(species)):
        k = effects.which[species[n], species[n]]
        reach_m = 0.0 if k < 0 else effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
        up, aside = reach_m / t.height_m + 0.5, reach_m / t.width_m / LANES + 1.0
        if up * aside < FAR:
            lines[n, 0], lines[n, 1] = int(up), int(aside)
    return lines


@contracted
def place_all(trees, exponents, effects, species, radius_m, uniform, places):  # type: ignore[no-untyped-def]
    """Draw each plant from its species' field and deform all fields.

    `places`, (N, 2) in cells, stay as they are where none is left. With `uniform` empty, they are given.
    """
    t = _pointed(trees)
    lines = _lines(t, effects, species, radius_m)
    eight, totals = np.empty(LANES), np.empty(len(exponents))
    rows, panels, rests = np.empty(AHEAD, np.int64), np.empty(AHEAD, np.int64), np.empty(AHEAD)
    squares, tables, length = pointer(eight), effects.tables, effects.tables.shape[1]
    for f in range(len(exponents)):
        totals[f] = total_of_pointed(t, f)
    for n in range(len(species)):
        f = species[n]
        if len(uniform) > 0:
            if n % AHEAD == 0:
                end = min(n + AHEAD, len(species))
                _ask_ahead(t, totals, lines, species, uniform, n, end, rows, panels, rests)
            if not totals[f] > 0.0:
                continue
            places[n, 0], places[n, 1] = _draw(t, f, totals[f], uniform[n, 0], uniform[n, 1])
        for g in range(len(exponents)):
            k = effects.which[g, f]
            if k < 0:
                continue
            r_m = effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
            if r_m > 0.0 and totals[g] > 0.0:
                last = 0.0 if effects.constant[k] else float(length - 2)
                table, balanced = pointer(tables[k]), effects.balanced[k]
                x, y = places[n, 0], places[n, 1]
                new = _deform(t, g, totals[g], squares, table, last, tables[k, 0], balanced, r_m, x, y)
                totals[g] = _kept(t, g, new, exponents)
    return eight[0] + totals[0]  # held until here
