"""The probability field in memory: its cells, sums over them, and draws.

Cells stand in strips of eight columns, one row of a strip after another: a row of a strip is one line of the
processor's memory, and the rows that a plant reaches are neighbours in memory. Above the cells each row has a tree of
sums: of its strips, of eight strips (a panel), of 64 ... Sums of strips stand like cells: a row's eight that have one
parent are a line. Above them a line has one node's sums of eight rows, and the lines of nodes that have one parent are
a block: their sum, number by number, is that of eight rows at once. The sums of whole rows have a tree too, eight
numbers of one parent a line. A plant changes some rows, and one or two nodes on each level of each of them and above.
Each node is the sum of its children, taken anew, so that no rounding error grows with the number of plants. A draw
walks down both trees. What a plant costs grows with the kernel's reach, and with the logarithm of the field's size.
"""

from __future__ import annotations

from math import frexp, ldexp
from typing import Any, NamedTuple

from forestgen.community.placement.field_lanes import (
    LANES,
    SMALLEST,
    load,
    load_across,
    load_line,
    passed,
    passed_as_guessed,
    plus,
    pointer,
    store,
    store_line,
    sum_of,
    with_number,
)
from forestgen.core.compiled import fma_njit, inlined

GREATEST_TOTAL, SMALLEST_TOTAL = 1e250, 1e-150  # outside, a field is scaled by a power of two
EDGE = 2.0**-32  # of a cell: places keep this far from its edges, so that rounding moves none into the next cell


class Trees(NamedTuple):
    """Cells and sums of one or more fields of the same shape, one after another; inside kernels, pointers to them."""

    cells: Any  # (F, strips, rows, 8) float64; what lies beyond a row's last cell is 0
    nodes: Any  # (F, panels, rows, 8) float64: sums of strips
    upper: Any  # (F, upper_stride) float64: sums of panels, of eight panels, ...; see `block_of`
    sums: Any  # (F, sum_stride) float64: of the rows, of eight rows, ...
    upper_level: Any  # (levels,) int64: where each level begins
    upper_lines: Any  # (levels,) int64: lines of a block, 4 or 8
    sum_level: Any  # (levels,) int64
    upper_levels: int
    sum_levels: int
    rows: int
    cols: int
    strips: int
    groups: int  # of eight rows
    cell_stride: int  # numbers of a field
    node_stride: int
    upper_stride: int
    sum_stride: int
    width_m: float  # of a cell
    height_m: float
    periodic: bool


@fma_njit
def pointed(t):  # type: ignore[no-untyped-def]
    """The trees by pointers: Numba would count references to arrays in every call."""
    memory = (pointer(t.cells), pointer(t.nodes), pointer(t.upper), pointer(t.sums))
    levels = (pointer(t.upper_level), pointer(t.upper_lines), pointer(t.sum_level))
    return Trees(*(memory + levels + t[7:]))


@inlined
def block_of(t, f, level, q, g):  # type: ignore[no-untyped-def]
    """Where the block of node q's children begins, for the rows of group g: a line for each child, its rows in it."""
    lines = load(t.upper_lines, level)
    return f * t.upper_stride + load(t.upper_level, level) + (q * t.groups + g) * lines * LANES


@inlined
def pick(line, i, u):  # type: ignore[no-untyped-def]
    """Of eight numbers the k in which the partial sums pass u, and what of u is left there; never one that is 0."""
    k, u = passed(load_line(line, i), u)
    value = load(line, i + k)
    if u < value:
        return k, u
    while k > 0 and not value > 0.0:  # u has reached the sum, by rounding: the last that is not 0
        k -= 1
        value = load(line, i + k)
    return k, value


@inlined
def pick_across(line, i, lines, u):  # type: ignore[no-untyped-def]
    """The same among numbers at one place of lines that follow one another."""
    k, u = passed(load_across(line, i, lines), u)
    k = min(k, lines - 1)
    value = load(line, i + k * LANES)
    if u < value:
        return k, u
    while k > 0 and not value > 0.0:
        k -= 1
        value = load(line, i + k * LANES)
    return k, value


@inlined
def row_of(t, f, u):  # type: ignore[no-untyped-def]
    """The row in which the partial sums of the rows pass u, and what of u is left."""
    at, base = 0, f * t.sum_stride
    for level in range(t.sum_levels - 1, -1, -1):
        k, u = pick(t.sums, base + load(t.sum_level, level) + at * LANES, u)
        at = at * LANES + k
    return at, u


@inlined
def panel_of(t, f, row, v, at, top, least):  # type: ignore[no-untyped-def]
    """The same along a row, from node `at` of level `top` down to one of level `least`; the panels are level 0."""
    for level in range(top - 1, least - 1, -1):
        line = block_of(t, f, level, at, row // LANES) + row % LANES
        k, v = pick_across(t.upper, line, load(t.upper_lines, level), v)
        at = at * LANES + k
    return at, v


@inlined
def strip_of(t, f, row, v):  # type: ignore[no-untyped-def]
    """The same among its strips."""
    panel, v = panel_of(t, f, row, v, 0, t.upper_levels, 0)
    k, v = pick(t.nodes, f * t.node_stride + (panel * t.rows + row) * LANES, v)
    return panel * LANES + k, v


@inlined
def inside(u, value):  # type: ignore[no-untyped-def]
    """How far into a cell of `value`, or a row, u lies."""
    return min(max(u / value, EDGE), 1.0 - EDGE)


@inlined
def draw(t, f, total, u, v):  # type: ignore[no-untyped-def]
    """x, y in cells, of two numbers in [0, 1)."""
    row, u = row_of(t, f, u * total)
    of_row = load(t.sums, f * t.sum_stride + row)
    strip, v = strip_of(t, f, row, v * of_row)
    line = f * t.cell_stride + (strip * t.rows + row) * LANES
    k, v = pick(t.cells, line, v)
    return strip * LANES + k + inside(v, load(t.cells, line + k)), row + inside(u, of_row)


@inlined
def row_as_guessed(t, f, u, row):  # type: ignore[no-untyped-def]
    """Whether `row_of` comes to a row that was guessed, and what of u is left if so; in a fraction of the time.

    A walk waits at each node to know the next one. Here all are known, and u only confirms them.
    """
    same = True
    for level in range(t.sum_levels - 1, -1, -1):
        at = row >> (3 * level)
        line, k = f * t.sum_stride + load(t.sum_level, level) + at // LANES * LANES, at % LANES
        here, u = passed_as_guessed(load_line(t.sums, line), u, k)
        same &= here & (u < load(t.sums, line + k))
    return same, u


@inlined
def put(memory, line, k, value):  # type: ignore[no-untyped-def]
    """Write number k of a line; the line's sum."""
    eight = with_number(load_line(memory, line), k, value)
    store_line(memory, line, eight)
    return sum_of(eight)


@inlined
def _sum(memory, line):  # type: ignore[no-untyped-def]
    return sum_of(load_line(memory, line))


@inlined
def put_row(t, f, i, panel, total):  # type: ignore[no-untyped-def]
    """Write the sum of a panel of row i among the sums of panels, or of rows if there is but one."""
    if t.upper_levels > 0:
        at = block_of(t, f, 0, panel // LANES, i // LANES) + panel % LANES * LANES
        store_line(t.upper, at, with_number(load_line(t.upper, at), i % LANES, total))
    else:
        at = f * t.sum_stride + i // LANES * LANES
        store_line(t.sums, at, with_number(load_line(t.sums, at), i % LANES, total))


@inlined
def _sum_lines(memory, at, lines):  # type: ignore[no-untyped-def]
    """Sum of four or eight lines, number by number, in the order of `sum_of`."""
    a, b = load_line(memory, at), load_line(memory, at + LANES)
    c, d = load_line(memory, at + 2 * LANES), load_line(memory, at + 3 * LANES)
    if lines > 4:
        a, b = plus(a, load_line(memory, at + 4 * LANES)), plus(b, load_line(memory, at + 5 * LANES))
        c, d = plus(c, load_line(memory, at + 6 * LANES)), plus(d, load_line(memory, at + 7 * LANES))
    return plus(plus(a, c), plus(b, d))


@inlined
def renew_groups(t, f, g0, g1, p0, p1):  # type: ignore[no-untyped-def]
    """The sums above those of panels p0 .. p1, of the rows of groups g0 .. g1, up to those of whole rows."""
    for level in range(t.upper_levels):
        lines = load(t.upper_lines, level)
        p0, p1 = p0 // LANES, p1 // LANES
        for q in range(p0, p1 + 1):
            for g in range(g0, g1 + 1):
                total = _sum_lines(t.upper, block_of(t, f, level, q, g), lines)
                if level + 1 < t.upper_levels:
                    store_line(t.upper, block_of(t, f, level + 1, q // LANES, g) + q % LANES * LANES, total)
                else:
                    store_line(t.sums, f * t.sum_stride + g * LANES, total)


@inlined
def renew_rows(t, f, i0, i1):  # type: ignore[no-untyped-def]
    """All sums above those of rows i0 .. i1, which are right; the field's total."""
    at = f * t.sum_stride
    for level in range(1, t.sum_levels):
        sums = f * t.sum_stride + load(t.sum_level, level)
        i0, i1 = i0 // LANES, i1 // LANES
        for i in range(i0, i1 + 1):
            put(t.sums, sums + i // LANES * LANES, i % LANES, _sum(t.sums, at + i * LANES))
        at = sums
    return total_of_pointed(t, f)


@inlined
def total_of_pointed(t, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    return _sum(t.sums, f * t.sum_stride + load(t.sum_level, t.sum_levels - 1))


@fma_njit
def _build(t, f):  # type: ignore[no-untyped-def]
    """All sums of a field; its total."""
    start, nodes, panels = f * t.cell_stride, f * t.node_stride, -(-t.strips // LANES)
    for panel in range(panels):
        first, last = panel * LANES, min(panel * LANES + LANES, t.strips)
        for i in range(t.rows):
            line = nodes + (panel * t.rows + i) * LANES
            eight = load_line(t.nodes, line)
            for b in range(first, last):
                eight = with_number(eight, b - first, _sum(t.cells, start + (b * t.rows + i) * LANES))
            store_line(t.nodes, line, eight)
            put_row(t, f, i, panel, sum_of(eight))
    renew_groups(t, f, 0, t.groups - 1, 0, panels - 1)
    return renew_rows(t, f, 0, t.rows - 1)


@fma_njit
def kept(t, f, total, powers):  # type: ignore[no-untyped-def]
    """Scale a field whose total has become too great or too small; its total."""
    if total == 0.0 or SMALLEST_TOTAL <= total <= GREATEST_TOTAL:
        return total
    _, exponent = frexp(total)
    factor = ldexp(1.0, -exponent)
    for k in range(f * t.cell_stride, (f + 1) * t.cell_stride):
        value = load(t.cells, k) * factor
        store(t.cells, k, value if value >= SMALLEST else 0.0)
    store(powers, f, load(powers, f) + exponent)
    return _build(t, f)


@fma_njit
def build(trees, exponents):  # type: ignore[no-untyped-def]
    """All sums of all fields."""
    t = pointed(trees)
    for f in range(len(exponents)):
        kept(t, f, _build(t, f), pointer(exponents))


@fma_njit
def total_of(trees, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    return total_of_pointed(pointed(trees), f)


@fma_njit
def draw_all(trees, f, uniform, places):  # type: ignore[no-untyped-def]
    """Places, (N, 2) in cells, of (N, 2) numbers; the field stays."""
    t = pointed(trees)
    total = total_of_pointed(t, f)
    for n in range(len(uniform)):
        places[n, 0], places[n, 1] = draw(t, f, total, uniform[n, 0], uniform[n, 1])
