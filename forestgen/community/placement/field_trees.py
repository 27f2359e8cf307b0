"""The probability field in memory: its cells, sums over them, and draws.

Cells stand in strips of eight columns, one row of a strip after another: a row of a strip is one line of the
processor's memory, and the rows that a plant reaches are neighbours in memory. Above the cells each row has a tree of
sums: of its strips, of eight strips, of 64 ...; eight sums that have one parent are again one line. The sums of whole
rows have such a tree too. A plant changes some rows, and one or two nodes on each level of each of them and above them.
Each node is the sum of its children, taken anew, so that no rounding error grows with the number of plants. A draw
walks down both trees. What a plant costs grows with the kernel's reach, and with the logarithm of the field's size.

A change here reaches the machine code kept on disk for field_kernel.py when that file is touched (`core.compiled`).
"""

from __future__ import annotations

from math import frexp, ldexp
from typing import Any, NamedTuple

from forestgen.community.placement.field import LANES
from forestgen.community.placement.field_lanes import (
    SMALLEST,
    load,
    load_line,
    passed,
    pointer,
    store,
    store_line,
    sum_of,
    with_number,
)
from forestgen.core.compiled import contracted, inlined

GREATEST_TOTAL, SMALLEST_TOTAL = 1e250, 1e-150  # outside, a field is scaled by a power of two
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


@contracted
def pointed(t):  # type: ignore[no-untyped-def]
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
def row_of(t, f, u):  # type: ignore[no-untyped-def]
    """The row in which the partial sums of the rows pass u, and what of u is left."""
    at, base = 0, f * t.sum_stride
    for level in range(t.sum_levels - 1, -1, -1):
        k, u = pick(t.sums, base + load(t.sum_level, level) + at * LANES, u)
        at = at * LANES + k
    return at, u


@inlined
def strip_of(t, f, row, v, least):  # type: ignore[no-untyped-def]
    """The same along a row: the node of level `least`, where the strips are level 0."""
    at, base = 0, f * t.node_stride
    for level in range(t.node_levels - 1, least - 1, -1):
        k, v = pick(t.nodes, base + load(t.node_level, level) + (at * t.rows + row) * LANES, v)
        at = at * LANES + k
    return at, v


@inlined
def _inside(u, value):  # type: ignore[no-untyped-def]
    return min(max(u / value, EDGE), 1.0 - EDGE)


@inlined
def draw(t, f, total, u, v):  # type: ignore[no-untyped-def]
    """x, y in cells, of two numbers in [0, 1)."""
    row, u = row_of(t, f, u * total)
    of_row = load(t.sums, f * t.sum_stride + row)
    strip, v = strip_of(t, f, row, v * of_row, 0)
    line = f * t.cell_stride + (strip * t.rows + row) * LANES
    k, v = pick(t.cells, line, v)
    return strip * LANES + k + _inside(v, load(t.cells, line + k)), row + _inside(u, of_row)


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
def renew_row(t, f, i, panel, total):  # type: ignore[no-untyped-def]
    """The sums of row i above a panel, whose own sum is `total`, up to that of the row."""
    base = f * t.node_stride + i * LANES
    for level in range(1, t.node_levels):
        line = base + load(t.node_level, level) + panel // LANES * t.rows * LANES
        total = put(t.nodes, line, panel % LANES, total)
        panel //= LANES
    put(t.sums, f * t.sum_stride + i // LANES * LANES, i % LANES, total)


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


@contracted
def _build(t, f):  # type: ignore[no-untyped-def]
    """All sums of a field; its total."""
    memory, start, strips = t.cells, f * t.cell_stride, t.strips
    for level in range(t.node_levels):
        nodes = f * t.node_stride + load(t.node_level, level)
        for panel in range(-(-strips // LANES)):
            first, last = panel * LANES, min(panel * LANES + LANES, strips)
            for i in range(t.rows):
                line = nodes + (panel * t.rows + i) * LANES
                eight = load_line(t.nodes, line)
                for b in range(first, last):
                    eight = with_number(eight, b - first, _sum(memory, start + (b * t.rows + i) * LANES))
                store_line(t.nodes, line, eight)
        memory, start, strips = t.nodes, nodes, -(-strips // LANES)
    for i in range(t.rows):
        put(t.sums, f * t.sum_stride + i // LANES * LANES, i % LANES, _sum(t.nodes, start + i * LANES))
    return renew_rows(t, f, 0, t.rows - 1)


@contracted
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


@contracted
def build(trees, exponents):  # type: ignore[no-untyped-def]
    """All sums of all fields."""
    t = pointed(trees)
    for f in range(len(exponents)):
        kept(t, f, _build(t, f), pointer(exponents))


@contracted
def total_of(trees, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    return total_of_pointed(pointed(trees), f)


@contracted
def draw_all(trees, f, uniform, places):  # type: ignore[no-untyped-def]
    """Places, (N, 2) in cells, of (N, 2) numbers; the field stays."""
    t = pointed(trees)
    total = total_of_pointed(t, f)
    for n in range(len(uniform)):
        places[n, 0], places[n, 1] = draw(t, f, total, uniform[n, 0], uniform[n, 1])
