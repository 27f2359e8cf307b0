"""Compiled loops that place plants: the field's deformation, and requests for memory ahead of it.

The field's cells and sums are those of `field_trees`. Small functions become part of `place_all`, and the lines of
memory that a plant needs are asked for in four steps while plants before it are placed. The steps leave a guess: the
plant's place, and the rows and strips in its reach. When its turn comes, its x is right if no plant since has changed
its row; its y is drawn anew, and mostly lies in the row that was guessed. Then nothing waits for an address. Else it is
drawn, or deforms, as if there had been no guess. Results are the same to the bit.
"""

from __future__ import annotations

from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.field_lanes import (
    LANES,
    ask_for,
    distances,
    load,
    load_line,
    only_near,
    pointer,
    store,
    store_line,
    sum_of,
    times,
    times_table,
)
from forestgen.community.placement.field_trees import (
    GREATEST_TOTAL,
    SMALLEST_TOTAL,
    block_of,
    draw,
    inside,
    kept,
    panel_of,
    pick,
    pointed,
    put,
    put_row,
    renew_groups,
    renew_rows,
    row_as_guessed,
    row_of,
    total_of_pointed,
)
from forestgen.core.compiled import fma_njit, inlined

AHEAD = 1  # plants between one request for a plant's memory and the next; there are four before it is placed
MARGIN = 0.03  # cells: a plant will seldom stand farther from where it would when it was asked for
GUESSES = LANES  # numbers of `_Plan.guesses` for a plant
RING = 8 * AHEAD  # plants that are remembered meanwhile
FAR = 64  # lines: a kernel that reaches more is not asked for ahead
LEAST_LEFT = 1e-200  # of the sum within reach: a balanced kernel that leaves less bars all of it


class Effects(NamedTuple):
    """The kernels, K in all."""

    which: NDArray[np.int64]  # (F, S) kernel of a plant of species S on field F; -1: none
    tables: NDArray[np.float64]  # (K, samples + 2): κ at even distances up to the reach, the last one twice
    constant: NDArray[np.bool_]  # (K,) κ is the same all over
    balanced: NDArray[np.bool_]  # (K,)
    reach: NDArray[np.float64]  # (K,) in radii or metres
    in_radii: NDArray[np.bool_]  # (K,)


class _Plan(NamedTuple):
    """What requests for memory look at, and remember: pointers."""

    guesses: Any  # (RING, 8) int64 of plants asked for, see below
    memory: Any  # (RING, 2) float64 of the same plants: y in cells; what of v is left, later x in cells
    totals: Any  # (F,) of the fields
    species: Any  # (N,)
    reach: Any  # (N, 2) columns and rows
    uniform: Any  # (N, 2)
    plants: int  # N; 0: nothing is asked for


# A guess: -1 in ROW for none, in FIRST_STRIP for none of the strips; AT is a node, then a panel, then a strip.
ROW, AT, FIRST_ROW, LAST_ROW, FIRST_STRIP, LAST_STRIP = range(6)
FIRST_CHANGED, LAST_CHANGED = 6, 7  # rows that the plant has changed, once it is placed


@inlined
def _patch(t, f, r_m, table, last, factor, window, x, y):  # type: ignore[no-untyped-def]
    """Multiply the cells of a window by `table`, or by `factor` if `last` is 0; a factor < 0 only sums.

    Returns the field's total, or the sum within reach.
    """
    i0, i1, j0, j1 = window
    b0, b1 = j0 // LANES, j1 // LANES
    r2, near, scale = r_m * r_m, 0.0, last / r_m
    nodes = f * t.node_stride
    for b in range(b0, b1 + 1):
        last_of_panel = b == b1 or b % LANES == LANES - 1
        squares = distances(b, x, t.width_m, j0, j1)
        line, node = f * t.cell_stride + b * t.rows * LANES, nodes + (b // LANES) * t.rows * LANES
        for i in range(i0, i1 + 1):
            dy = (i + 0.5 - y) * t.height_m
            dy2, at = dy * dy, line + i * LANES
            eight = load_line(t.cells, at)
            if last > 0.0:
                eight = times_table(eight, squares, dy2, r2, scale, last, table)
            elif factor >= 0.0:
                eight = times(eight, squares, dy2, r2, factor)
            else:
                near += sum_of(only_near(eight, squares, dy2, r2))
                continue
            store_line(t.cells, at, eight)
            total = put(t.nodes, node + i * LANES, b % LANES, sum_of(eight))
            if last_of_panel:
                put_row(t, f, i, b // LANES, total)
    if factor < 0.0:
        return near
    renew_groups(t, f, i0 // LANES, i1 // LANES, b0 // LANES, b1 // LANES)
    return renew_rows(t, f, i0, i1)


@inlined
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


@inlined
def _patches(t, f, r_m, table, last, factor, x, y):  # type: ignore[no-untyped-def]
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
                result = _patch(t, f, r_m, table, last, factor, window, x + b * t.cols, y + a * t.rows)
                near += result
    return near if factor < 0.0 else result


@fma_njit
def _balanced(t, f, table, last, first_value, r_m, x, y):  # type: ignore[no-untyped-def]
    """`_patches`, after which the sum within reach is what it was."""
    before = _patches(t, f, r_m, table, 0.0, -1.0, x, y)
    new = _patches(t, f, r_m, table, last, first_value, x, y)
    if before > 0.0:
        after = _patches(t, f, r_m, table, 0.0, -1.0, x, y)
        if after > before * LEAST_LEFT:
            new = _patches(t, f, r_m, table, 0.0, before / after, x, y)
    return new


@inlined
def _changes(plan, slot, first, last):  # type: ignore[no-untyped-def]
    store(plan.guesses, slot + FIRST_CHANGED, min(load(plan.guesses, slot + FIRST_CHANGED), first))
    store(plan.guesses, slot + LAST_CHANGED, max(load(plan.guesses, slot + LAST_CHANGED), last))


@inlined
def _patch_as_guessed(t, f, r_m, table, last, factor, x, y, plan, slot):  # type: ignore[no-untyped-def]
    """`_patch` of the rows and strips that were guessed, if they are enough; else, and without a guess, `_patches`.

    A cell out of reach stays as it is.
    """
    guesses = plan.guesses
    i0, i1 = load(guesses, slot + FIRST_ROW), load(guesses, slot + LAST_ROW)
    b0, b1 = load(guesses, slot + FIRST_STRIP), load(guesses, slot + LAST_STRIP)
    if b0 >= 0:
        top, bottom = _reached(y, r_m / t.height_m, t.rows, t.periodic)
        left, right = _reached(x, r_m / t.width_m, t.cols, t.periodic)
        j0, j1 = b0 * LANES, min(b1 * LANES + LANES, t.cols) - 1
        if (i0 <= top) & (bottom <= i1) & (j0 <= left) & (right <= j1):
            _changes(plan, slot, i0, i1)
            return _patch(t, f, r_m, table, last, factor, (i0, i1, j0, j1), x, y)
    _changes(plan, slot, 0, t.rows)
    return _patches(t, f, r_m, table, last, factor, x, y)


@inlined
def _deform(t, f, total, table, last, first_value, balanced, r_m, x, y, plan, slot):  # type: ignore[no-untyped-def]
    """The field after a plant at (x, y); returns its total. `last` is 0 if κ is `first_value` all over."""
    if balanced:
        _changes(plan, slot, 0, t.rows)
        new = _balanced(t, f, table, last, first_value, r_m, x, y)
    else:
        new = _patch_as_guessed(t, f, r_m, table, last, first_value, x, y, plan, slot)
    return total if new < 0.0 else new  # < 0: no cell's middle is in reach


@inlined
def _ask_for_rows(memory, start, first, last):  # type: ignore[no-untyped-def]
    for i in range(first, last + 1):
        ask_for(memory, start + i * LANES)


@inlined
def _ask_for_panels(t, plan, n):  # type: ignore[no-untyped-def]
    """Ask for memory of plant n, where it would stand in the field as it is now: the sums of its panel and of others.

    The first of four steps, each of which looks at what the one before has asked for. Few plants will stand far from
    there: one plant moves the next by a small fraction of a cell. Few requests at a time, with work between them: the
    processor waits where there are too many.
    """
    if n >= plan.plants:
        return
    f, guesses, slot, ring = load(plan.species, n), plan.guesses, n % RING * GUESSES, n % RING * 2
    total = load(plan.totals, f)
    if not total > 0.0:
        store(guesses, slot + ROW, -1)
        return
    row, u = row_of(t, f, load(plan.uniform, 2 * n) * total)
    of_row = load(t.sums, f * t.sum_stride + row)
    y = row + min(u / of_row, 1.0)
    node, v = panel_of(t, f, row, load(plan.uniform, 2 * n + 1) * of_row, 0, t.upper_levels, 1)
    first, last = _reached(y, load(plan.reach, 2 * n + 1) + MARGIN, t.rows, False)
    store(guesses, slot + ROW, row), store(guesses, slot + AT, node), store(guesses, slot + FIRST_STRIP, -1)
    store(guesses, slot + FIRST_ROW, first), store(guesses, slot + LAST_ROW, last)
    store(plan.memory, ring, y), store(plan.memory, ring + 1, v)
    for g in range(first // LANES, last // LANES + 1):
        _ask_for_rows(t.upper, block_of(t, f, 0, node, g), 0, load(t.upper_lines, 0) - 1)


@inlined
def _ask_for_strips(t, plan, n):  # type: ignore[no-untyped-def]
    """The second step: the sums of its strip and seven others."""
    guesses, slot, ring = plan.guesses, n % RING * GUESSES, n % RING * 2
    if n >= plan.plants or load(guesses, slot + ROW) < 0:
        return
    f, row, node = load(plan.species, n), load(guesses, slot + ROW), load(guesses, slot + AT)
    panel, v = panel_of(t, f, row, load(plan.memory, ring + 1), node, 1, 0)
    store(guesses, slot + AT, panel), store(plan.memory, ring + 1, v)
    start = f * t.node_stride + panel * t.rows * LANES
    _ask_for_rows(t.nodes, start, load(guesses, slot + FIRST_ROW), load(guesses, slot + LAST_ROW))


@inlined
def _ask_for_cells(t, plan, n):  # type: ignore[no-untyped-def]
    """The third step: the rows in its strip."""
    guesses, slot, ring = plan.guesses, n % RING * GUESSES, n % RING * 2
    if n >= plan.plants or load(guesses, slot + ROW) < 0:
        return
    f, row, panel = load(plan.species, n), load(guesses, slot + ROW), load(guesses, slot + AT)
    line = f * t.node_stride + (panel * t.rows + row) * LANES
    k, v = pick(t.nodes, line, load(plan.memory, ring + 1))
    strip = panel * LANES + k
    store(guesses, slot + AT, strip), store(plan.memory, ring + 1, v)
    start = f * t.cell_stride + strip * t.rows * LANES
    _ask_for_rows(t.cells, start, load(guesses, slot + FIRST_ROW), load(guesses, slot + LAST_ROW))


@inlined
def _ask_for_cells_beside(t, plan, n):  # type: ignore[no-untyped-def]
    """The fourth step: the rows in the strips beside; now there is a guess of all that the plant will change."""
    guesses, slot, ring = plan.guesses, n % RING * GUESSES, n % RING * 2
    if n >= plan.plants or load(guesses, slot + ROW) < 0:
        return
    f, row, strip = load(plan.species, n), load(guesses, slot + ROW), load(guesses, slot + AT)
    line = f * t.cell_stride + (strip * t.rows + row) * LANES
    k, v = pick(t.cells, line, load(plan.memory, ring + 1))
    value = load(t.cells, line + k)
    if not value > 0.0:  # a plant has changed the row meanwhile
        store(guesses, slot + ROW, -1)
        return
    x, y = strip * LANES + k + inside(v, value), load(plan.memory, ring)
    store(plan.memory, ring + 1, x)
    columns, rows = load(plan.reach, 2 * n), load(plan.reach, 2 * n + 1)
    left, right = _reached(x, columns + MARGIN, t.cols, False)
    if (rows > 0.0) & (abs(y - t.rows / 2) < t.rows / 2 - rows - 1) & (abs(x - t.cols / 2) < t.cols / 2 - columns - 1):
        store(guesses, slot + FIRST_STRIP, left // LANES), store(guesses, slot + LAST_STRIP, right // LANES)
    first, last = load(guesses, slot + FIRST_ROW), load(guesses, slot + LAST_ROW)
    for b in range(left // LANES, right // LANES + 1):
        if b != strip:
            _ask_for_rows(t.cells, f * t.cell_stride + b * t.rows * LANES, first, last)
            if b // LANES != strip // LANES:
                _ask_for_rows(t.nodes, f * t.node_stride + b // LANES * t.rows * LANES, first, last)


@inlined
def _is_as_asked(plan, n, row):  # type: ignore[no-untyped-def]
    """Whether no plant has changed a row since memory of plant n was first asked for."""
    same = True
    for before in range(1, 4 * AHEAD + 1):
        slot = (n - before) % RING * GUESSES
        first, last = load(plan.guesses, slot + FIRST_CHANGED), load(plan.guesses, slot + LAST_CHANGED)
        same &= (row < first) | (row > last)
    return same


@inlined
def _draw(t, plan, f, n):  # type: ignore[no-untyped-def]
    """x, y in cells of plant n: `draw`, or the same by the guess."""
    total, u, v = load(plan.totals, f), load(plan.uniform, 2 * n), load(plan.uniform, 2 * n + 1)
    row = load(plan.guesses, n % RING * GUESSES + ROW)
    if row >= 0 and _is_as_asked(plan, n, row):
        same, left = row_as_guessed(t, f, u * total, row)
        if same:
            return load(plan.memory, n % RING * 2 + 1), row + inside(left, load(t.sums, f * t.sum_stride + row))
    return draw(t, f, total, u, v)


@fma_njit
def _reaches(t, effects, species, radius_m):  # type: ignore[no-untyped-def]
    """(N, 2) columns and rows that plants reach in their own field; 0 if too many to be asked for."""
    reach = np.zeros((len(species), 2))
    for n in range(len(species)):
        k = effects.which[species[n], species[n]]
        reach_m = 0.0 if k < 0 else effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
        columns, rows = reach_m / t.width_m, reach_m / t.height_m
        if (rows + 0.5) * (columns / LANES + 1.0) < FAR:
            reach[n, 0], reach[n, 1] = columns, rows
    return reach


@fma_njit
def place_all(trees, exponents, effects, species, radius_m, uniform, places):  # type: ignore[no-untyped-def]
    """Draw each plant from its species' field and deform all fields.

    `places`, (N, 2) in cells, stay as they are where none is left. With `uniform` empty, they are given.
    """
    t, totals, powers = pointed(trees), np.empty(len(exponents)), pointer(exponents)
    tables, length, to_draw = effects.tables, effects.tables.shape[1], len(uniform) > 0
    reach, memory = _reaches(t, effects, species, radius_m), np.zeros((RING, 2))
    guesses = np.full((RING, GUESSES), -1)
    asked = len(species) if to_draw and t.upper_levels > 0 else 0
    ring = pointer(guesses), pointer(memory)
    plan = _Plan(ring[0], ring[1], pointer(totals), pointer(species), pointer(reach), pointer(uniform), asked)
    for f in range(len(exponents)):
        totals[f] = total_of_pointed(t, f)
    for n in range(len(species)):
        f, slot = species[n], n % RING * GUESSES
        stands = totals[f] > 0.0 or not to_draw
        store(plan.guesses, slot + FIRST_CHANGED, t.rows), store(plan.guesses, slot + LAST_CHANGED, -1)
        if to_draw:
            _ask_for_panels(t, plan, n + 4 * AHEAD)
            if stands:
                places[n, 0], places[n, 1] = _draw(t, plan, f, n)
            _ask_for_cells(t, plan, n + 2 * AHEAD)
            _ask_for_strips(t, plan, n + 3 * AHEAD)
        for g in range(len(exponents)):
            k = effects.which[g, f]
            if k < 0 or not stands:
                continue
            r_m = effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
            if r_m > 0.0 and totals[g] > 0.0:
                last = 0.0 if effects.constant[k] else float(length - 2)
                table, balanced, value = pointer(tables[k]), effects.balanced[k], tables[k, 0]
                x, y = places[n, 0], places[n, 1]
                new = _deform(t, g, totals[g], table, last, value, balanced, r_m, x, y, plan, slot)
                if new != 0.0 and not SMALLEST_TOTAL <= new <= GREATEST_TOTAL:
                    new = kept(t, g, new, powers)
                    _changes(plan, slot, 0, t.rows)
                totals[g] = new
        _ask_for_cells_beside(t, plan, n + AHEAD)
    return totals[0] + exponents[0] + memory[0, 0] + guesses[0, 0] + len(reach)  # held until here
