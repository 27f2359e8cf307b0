"""Compiled loops of the probability field: sums over its cells, draws from it, and its deformation.

A row's cells stand in blocks of eight, one cache line each. Above them a row has a tree of sums: of each block, of 16
blocks, of 16 of those; and the sums of the rows have such a tree too. A plant changes some rows, one or two nodes on
each level of each of them, and one or two nodes on each level above the rows. Each node is the sum of its children,
taken anew, so that no rounding error grows with the number of plants. A draw walks down both trees. What a plant costs
grows with the kernel's reach, and with the logarithm of the field's size.
"""

from __future__ import annotations

from math import ceil, floor, frexp, ldexp, sqrt
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from forestgen.core.compiled import borrowed, contracted

BLOCK = 8  # cells of a block: 64 bytes
FAN = 16  # children of a node
AHEAD = 16  # plants whose memory is asked for before the first of them is placed
FAR = 64  # blocks: a kernel that reaches more is not asked for ahead
SMALLEST = 1e-290  # a cell below is 0: products stay clear of the slow numbers near the smallest
GREATEST_TOTAL, SMALLEST_TOTAL = 1e250, 1e-150  # outside, a field is scaled by a power of two
LEAST_LEFT = 1e-200  # of the sum within reach: a balanced kernel that leaves less bars all of it
EDGE = 2.0**-32  # of a cell: places keep this far from its edges, so that rounding moves none into the next cell


class Trees(NamedTuple):
    """Cells and sums of one or more fields of the same shape, one after another."""

    cells: NDArray[np.float64]  # (F rows stride,); what lies beyond a row's last cell is 0
    nodes: NDArray[np.float64]  # (F rows node_stride,): level after level, blocks first
    sums: NDArray[np.float64]  # (F sum_stride,): of the rows, level after level
    node_level: NDArray[np.int64]  # where each level begins
    sum_level: NDArray[np.int64]
    rows: int
    cols: int
    stride: int
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


@intrinsic
def _ask_for(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Have the memory at an element brought near, and go on meanwhile."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        number = ir.IntType(32)
        kinds = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        place = builder.bitcast(builder.gep(view.data, [arguments[1]]), cgutils.voidptr_t)
        call = cgutils.get_or_insert_function(builder.module, kinds, "llvm.prefetch.p0")
        builder.call(call, [place, number(1), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), code


def _vector(builder: Any, view: Any, index: Any, length: int) -> Any:
    """A pointer to `length` neighbouring elements as one vector of the processor's."""
    kind = ir.VectorType(ir.DoubleType(), length)
    return builder.bitcast(builder.gep(view.data, [index]), ir.PointerType(kind))


def _splat(builder: Any, value: Any, length: int) -> Any:
    kind = ir.VectorType(value.type, length)
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), length), [0] * length)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, one, zeros)


def _halves_added(builder: Any, vector: Any, length: int) -> Any:
    """The vector's sum, in an order that is the same on all processors."""
    while length > 1:
        length //= 2
        kind = ir.VectorType(ir.IntType(32), length)
        low = builder.shuffle_vector(vector, vector, ir.Constant(kind, list(range(length))))
        high = builder.shuffle_vector(vector, vector, ir.Constant(kind, list(range(length, 2 * length))))
        vector = builder.fadd(low, high)
    return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))


@intrinsic
def _sum_at(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Sum of a node's children, which begin at an index."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        children = builder.load(_vector(builder, view, arguments[1], FAN), align=8)
        return _halves_added(builder, children, FAN)

    return types.float64(array, types.int64), code


@intrinsic
def _block_at(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Sum of the block that begins at an index."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        return _halves_added(builder, builder.load(_vector(builder, view, arguments[1], BLOCK), align=8), BLOCK)

    return types.float64(array, types.int64), code


@intrinsic
def _disc_at(typing_context, array, index, squares, first, dy2, r2, factor):  # type: ignore[no-untyped-def]
    """Multiply the block that begins at an index by `factor` where squares + dy2 <= r2; its sum then.

    Compilers see no block in a loop of eight steps that may write over what it reads.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        cells = context.make_array(signature.args[0])(context, builder, arguments[0])
        apart = context.make_array(signature.args[2])(context, builder, arguments[2])
        dy2, r2, factor = (_splat(builder, value, BLOCK) for value in arguments[4:])
        kind = ir.VectorType(ir.DoubleType(), BLOCK)
        one, none, least = (ir.Constant(kind, [value] * BLOCK) for value in (1.0, 0.0, SMALLEST))
        place = _vector(builder, cells, arguments[1], BLOCK)
        d2 = builder.fadd(builder.load(_vector(builder, apart, arguments[3], BLOCK), align=8), dy2)
        times = builder.select(builder.fcmp_ordered("<=", d2, r2), factor, one)
        value = builder.fmul(builder.load(place, align=8), times)
        value = builder.select(builder.fcmp_ordered(">=", value, least), value, none)
        builder.store(value, place, align=8)
        return _halves_added(builder, value, BLOCK)

    number, real = types.int64, types.float64
    return real(array, number, squares, number, real, real, real), code


@contracted
def _borrowed(t):  # type: ignore[no-untyped-def]
    return Trees(
        borrowed(t.cells),
        borrowed(t.nodes),
        borrowed(t.sums),
        borrowed(t.node_level),
        borrowed(t.sum_level),
        t.rows,
        t.cols,
        t.stride,
        t.node_stride,
        t.sum_stride,
        t.width_m,
        t.height_m,
        t.periodic,
    )


@contracted
def _renew(tree, base, level, first, last):  # type: ignore[no-untyped-def]
    """All sums above leaves first .. last; the sum of all leaves."""
    for k in range(1, len(level)):
        first, last = first // FAN, last // FAN
        below, above = base + level[k - 1], base + level[k]
        for n in range(first, last + 1):
            tree[above + n] = _sum_at(tree, below + n * FAN)
    return _sum_at(tree, base + level[-1])


@contracted
def _pick(line, u):  # type: ignore[no-untyped-def]
    """The child k in which the partial sums pass u, and what of u is left there; never one that is 0."""
    total, below, k = 0.0, 0.0, 0
    for value in line:
        total += value
        k += total <= u
        below = total if total <= u else below
    if k < len(line):
        return k, u - below
    k = len(line) - 1  # u has reached the sum, by rounding: the last that is not 0
    while k > 0 and not line[k] > 0.0:
        k -= 1
    return k, line[k]


@contracted
def _descend(tree, base, level, u):  # type: ignore[no-untyped-def]
    at = 0
    for k in range(len(level) - 1, -1, -1):
        child = base + level[k] + at * FAN
        one, u = _pick(tree[child : child + FAN], u)
        at = at * FAN + one
    return at, u


@contracted
def _inside(u, value):  # type: ignore[no-untyped-def]
    return min(max(u / value, EDGE), 1.0 - EDGE)


@contracted
def _draw(t, f, total, u, v):  # type: ignore[no-untyped-def]
    """x, y in cells, of two numbers in [0, 1)."""
    row, u = _descend(t.sums, f * t.sum_stride, t.sum_level, u * total)
    of_row = t.sums[f * t.sum_stride + row]
    y = row + _inside(u, of_row)
    row += f * t.rows
    block, v = _descend(t.nodes, row * t.node_stride, t.node_level, v * of_row)
    start = row * t.stride + block * BLOCK
    k, v = _pick(t.cells[start : start + BLOCK], v)
    return block * BLOCK + k + _inside(v, t.cells[start + k]), y


@contracted
def _renew_blocks(cells, start, nodes):  # type: ignore[no-untyped-def]
    for b in range(len(nodes)):
        nodes[b] = _block_at(cells, start + b * BLOCK)


@contracted
def _multiply_disc(cells, start, nodes, squares, dy2, r2, factor):  # type: ignore[no-untyped-def]
    for b in range(len(nodes)):
        nodes[b] = _disc_at(cells, start + b * BLOCK, squares, b * BLOCK, dy2, r2, factor)


@contracted
def _multiply_table(line, squares, dy2, r2, scale, table):  # type: ignore[no-untyped-def]
    last = float(len(table) - 2)
    for k in range(len(line)):
        d2 = squares[k] + dy2
        at = min(sqrt(d2) * scale, last)
        n = np.uint32(at)
        factor = table[n] + (at - n) * (table[n + np.uint32(1)] - table[n])
        value = line[k] * (factor if d2 <= r2 else 1.0)
        line[k] = value if value >= SMALLEST else 0.0


@contracted
def _sum_disc(line, squares, dy2, r2):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(line)):
        total += line[k] if squares[k] + dy2 <= r2 else 0.0
    return total


@contracted
def _patch(t, f, squares, r_m, table, factor, window, x, y):  # type: ignore[no-untyped-def]
    """Multiply rows and columns of `window` by `table`, or by `factor` if the table is empty; a factor < 0 only sums.

    Returns the field's total, or the sum within reach.
    """
    i0, i1, j0, j1 = window
    b0 = j0 // BLOCK
    n = j1 // BLOCK - b0 + 1
    squares = squares[: n * BLOCK]
    for k in range(len(squares)):
        j = b0 * BLOCK + k
        dx = (j + 0.5 - x) * t.width_m
        squares[k] = dx * dx if (j >= j0) & (j <= j1) else np.inf
    r2, near = r_m * r_m, 0.0
    for i in range(i0, i1 + 1):
        row = f * t.rows + i
        dy = (i + 0.5 - y) * t.height_m
        start, node = row * t.stride + b0 * BLOCK, row * t.node_stride + b0
        line = t.cells[start : start + n * BLOCK]
        if len(table) > 0:
            _multiply_table(line, squares, dy * dy, r2, (len(table) - 2) / r_m, table)
            _renew_blocks(t.cells, start, t.nodes[node : node + n])
        elif factor >= 0.0:
            _multiply_disc(t.cells, start, t.nodes[node : node + n], squares, dy * dy, r2, factor)
        else:
            near += _sum_disc(line, squares, dy * dy, r2)
    if factor < 0.0:
        return near
    base = f * t.sum_stride
    for i in range(i0, i1 + 1):
        t.sums[base + i] = _renew(t.nodes, (f * t.rows + i) * t.node_stride, t.node_level, b0, b0 + n - 1)
    return _renew(t.sums, base, t.sum_level, i0, i1)


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
def _patches(t, f, squares, r_m, table, factor, x, y):  # type: ignore[no-untyped-def]
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
                result = _patch(t, f, squares, r_m, table, factor, window, x + b * t.cols, y + a * t.rows)
                near += result
    return near if factor < 0.0 else result


@contracted
def _deform(t, f, total, squares, tables, k, constant, balanced, r_m, x, y):  # type: ignore[no-untyped-def]
    """The field after a plant at (x, y); returns its total."""
    nothing = tables[0, :0]
    before = _patches(t, f, squares, r_m, nothing, -1.0, x, y) if balanced else 0.0
    new = _patches(t, f, squares, r_m, nothing if constant else tables[k], tables[k, 0] if constant else 0.0, x, y)
    if balanced and before > 0.0:
        after = _patches(t, f, squares, r_m, nothing, -1.0, x, y)
        if after > before * LEAST_LEFT:
            new = _patches(t, f, squares, r_m, nothing, before / after, x, y)
    return total if new < 0.0 else new  # < 0: no cell's middle is in reach


@contracted
def _build(t, f):  # type: ignore[no-untyped-def]
    """All sums of a field; its total."""
    base = f * t.sum_stride
    blocks = t.stride // BLOCK
    for i in range(t.rows):
        row = f * t.rows + i
        start, node = row * t.stride, row * t.node_stride
        _renew_blocks(t.cells, start, t.nodes[node : node + blocks])
        t.sums[base + i] = _renew(t.nodes, node, t.node_level, 0, blocks - 1)
    return _renew(t.sums, base, t.sum_level, 0, t.rows - 1)


@contracted
def _kept(t, f, total, exponents):  # type: ignore[no-untyped-def]
    """Scale a field whose total has become too great or too small; its total."""
    if total == 0.0 or SMALLEST_TOTAL <= total <= GREATEST_TOTAL:
        return total
    _, exponent = frexp(total)
    factor = ldexp(1.0, -exponent)
    line = t.cells[f * t.rows * t.stride : (f + 1) * t.rows * t.stride]
    for k in range(len(line)):
        value = line[k] * factor
        line[k] = value if value >= SMALLEST else 0.0
    exponents[f] += exponent
    return _build(t, f)


@contracted
def build(trees, exponents):  # type: ignore[no-untyped-def]
    """All sums of all fields."""
    t = _borrowed(trees)
    for f in range(len(exponents)):
        _kept(t, f, _build(t, f), exponents)


@contracted
def total_of(trees, f):  # type: ignore[no-untyped-def]
    """A field's sum."""
    t = _borrowed(trees)
    return _sum_at(t.sums, f * t.sum_stride + t.sum_level[-1])


@contracted
def draw_all(trees, f, uniform, places):  # type: ignore[no-untyped-def]
    """Places, (N, 2) in cells, of (N, 2) numbers; the field stays."""
    t = _borrowed(trees)
    total = total_of(trees, f)
    for n in range(len(uniform)):
        places[n, 0], places[n, 1] = _draw(t, f, total, uniform[n, 0], uniform[n, 1])


@contracted
def _ask_ahead(t, totals, effects, species, radius_m, uniform, first, last, rows):  # type: ignore[no-untyped-def]
    """Ask for the memory that plants first .. last - 1 will need, where they would stand in the field as it is now.

    Few of them will stand elsewhere: one plant moves the next by a small fraction of a cell. It changes no result.
    """
    for n in range(first, last):
        f = species[n]
        rows[n - first], _ = _descend(t.sums, f * t.sum_stride, t.sum_level, uniform[n, 0] * totals[f])
        for k in range(1, len(t.node_level)):
            node = (f * t.rows + rows[n - first]) * t.node_stride + t.node_level[k]
            _ask_for(t.nodes, node)
            _ask_for(t.nodes, node + FAN // 2)
    for n in range(first, last):
        f, row = species[n], rows[n - first]
        of_row = t.sums[f * t.sum_stride + row]
        block, _ = _descend(t.nodes, (f * t.rows + row) * t.node_stride, t.node_level, uniform[n, 1] * of_row)
        k = effects.which[f, f]
        reach_m = 0.0 if k < 0 else effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
        up, aside = min(reach_m / t.height_m, FAR) + 1.0, min(reach_m / t.width_m / BLOCK, FAR) + 1.0
        if up * aside > FAR:
            continue
        for i in range(max(row - int(up), 0), min(row + int(up), t.rows - 1) + 1):
            start, node = (f * t.rows + i) * t.stride, (f * t.rows + i) * t.node_stride
            for b in range(max(block - int(aside), 0), min(block + int(aside), t.stride // BLOCK - 1) + 1):
                _ask_for(t.cells, start + b * BLOCK)
            _ask_for(t.nodes, node + block)


@contracted
def place_all(trees, exponents, effects, species, radius_m, uniform, places):  # type: ignore[no-untyped-def]
    """Draw each plant from its species' field and deform all fields.

    `places`, (N, 2) in cells, stay as they are where none is left. With `uniform` empty, they are given.
    """
    t = _borrowed(trees)
    e = Effects(
        borrowed(effects.which),
        borrowed(effects.tables),
        borrowed(effects.constant),
        borrowed(effects.balanced),
        borrowed(effects.reach),
        borrowed(effects.in_radii),
    )
    squares_kept, rows_kept, totals_kept = np.empty(t.stride), np.empty(AHEAD, np.int64), np.empty(len(exponents))
    squares, rows, totals = borrowed(squares_kept), borrowed(rows_kept), borrowed(totals_kept)
    species, radius_m, uniform = borrowed(species), borrowed(radius_m), borrowed(uniform)
    for f in range(len(exponents)):
        totals[f] = total_of(trees, f)
    for n in range(len(species)):
        f = species[n]
        if len(uniform) > 0:
            if n % AHEAD == 0:
                last = min(n + AHEAD, len(species))
                _ask_ahead(t, totals, e, species, radius_m, uniform, n, last, rows)
            if not totals[f] > 0.0:
                continue
            places[n, 0], places[n, 1] = _draw(t, f, totals[f], uniform[n, 0], uniform[n, 1])
        for g in range(len(exponents)):
            k = e.which[g, f]
            if k >= 0:
                r_m = e.reach[k] * (radius_m[n] if e.in_radii[k] else 1.0)
                if r_m > 0.0 and totals[g] > 0.0:
                    constant, balanced = e.constant[k], e.balanced[k]
                    new = _deform(
                        t, g, totals[g], squares, e.tables, k, constant, balanced, r_m, places[n, 0], places[n, 1]
                    )
                    totals[g] = _kept(t, g, new, exponents)
    return squares_kept[0] + rows_kept[0] + totals_kept[0]  # held until here
