"""Compiled loops that place plants: the field's deformation, and requests for memory ahead of it.

The field's cells and sums are those of `field_trees`. Small functions become part of `place_all`, and the lines of
memory that a plant needs are asked for in three steps while plants before it are placed.
"""

from __future__ import annotations

from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.field import LANES
from forestgen.community.placement.field_lanes import (
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
    draw,
    kept,
    pick,
    pointed,
    put,
    renew_row,
    renew_rows,
    row_of,
    strip_of,
    total_of_pointed,
)
from forestgen.core.compiled import contracted, inlined

AHEAD = 2  # plants between one request for a plant's memory and the next; there are three before it is placed
RING = 4 * AHEAD  # plants that are remembered meanwhile
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
    """What requests for memory look at: pointers."""

    memory: Any  # (RING, 4) float64 of plants asked for: y in cells, or -1; panel, later strip; what of v is left
    totals: Any  # (F,) of the fields
    species: Any  # (N,)
    reach: Any  # (N, 2) columns and rows
    uniform: Any  # (N, 2)
    plants: int  # N; 0: nothing is asked for


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
                renew_row(t, f, i, b // LANES, total)
    return near if factor < 0.0 else renew_rows(t, f, i0, i1)


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


@contracted
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
def _deform(t, f, total, table, last, first_value, balanced, r_m, x, y):  # type: ignore[no-untyped-def]
    """The field after a plant at (x, y); returns its total. `last` is 0 if κ is `first_value` all over."""
    if balanced:
        new = _balanced(t, f, table, last, first_value, r_m, x, y)
    else:
        new = _patches(t, f, r_m, table, last, first_value, x, y)
    return total if new < 0.0 else new  # < 0: no cell's middle is in reach


@inlined
def _ask_for_rows(memory, start, first, last):  # type: ignore[no-untyped-def]
    for i in range(first, last + 1):
        ask_for(memory, start + i * LANES)


@inlined
def _ask(t, plan, step, n):  # type: ignore[no-untyped-def]
    """Ask for memory of plant n, where it would stand in the field as it is now; it changes no result.

    In three steps, each of which looks at what the one before has asked for: the sums of its strip and seven others,
    the rows in its strip, and those in the next strip. Few plants will stand far from there: one plant moves the next
    by a small fraction of a cell. Few requests at a time, with work between them: the processor waits where there are
    too many.
    """
    if n >= plan.plants:
        return
    f, memory, slot = load(plan.species, n), plan.memory, n % RING * 4
    nodes, columns, rows = f * t.node_stride, load(plan.reach, 2 * n), load(plan.reach, 2 * n + 1)
    if step == 0:
        store(memory, slot, -1.0)
        total = load(plan.totals, f)
        if not total > 0.0:
            return
        row, u = row_of(t, f, load(plan.uniform, 2 * n) * total)
        of_row = load(t.sums, f * t.sum_stride + row)
        y = row + min(u / of_row, 1.0)
        panel, v = strip_of(t, f, row, load(plan.uniform, 2 * n + 1) * of_row, 1)
        store(memory, slot, y), store(memory, slot + 1, float(panel)), store(memory, slot + 2, v)
        first, last = _reached(y, rows, t.rows, False)
        _ask_for_rows(t.nodes, nodes + panel * t.rows * LANES, first, last)
        _ask_for_rows(t.nodes, nodes + load(t.node_level, 1) + panel // LANES * t.rows * LANES, first, last)
        return
    y, strip = load(memory, slot), int(load(memory, slot + 1))
    if y < 0.0:
        return
    row = min(int(y), t.rows - 1)
    first, last = _reached(y, rows, t.rows, False)
    if step == 1:
        k, v = pick(t.nodes, nodes + (strip * t.rows + row) * LANES, load(memory, slot + 2))
        strip = strip * LANES + k
        store(memory, slot + 1, float(strip)), store(memory, slot + 2, v)
        _ask_for_rows(t.cells, f * t.cell_stride + strip * t.rows * LANES, first, last)
        return
    k, v = pick(t.cells, f * t.cell_stride + (strip * t.rows + row) * LANES, load(memory, slot + 2))
    left, right = _reached(strip * LANES + k + 0.5, columns, t.cols, False)
    for b in range(left // LANES, right // LANES + 1):
        if b != strip:
            _ask_for_rows(t.cells, f * t.cell_stride + b * t.rows * LANES, first, last)
            if b // LANES != strip // LANES:
                _ask_for_rows(t.nodes, nodes + b // LANES * t.rows * LANES, first, last)


@contracted
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


@contracted
def place_all(trees, exponents, effects, species, radius_m, uniform, places):  # type: ignore[no-untyped-def]
    """Draw each plant from its species' field and deform all fields.

    `places`, (N, 2) in cells, stay as they are where none is left. With `uniform` empty, they are given.
    """
    t, totals, powers = pointed(trees), np.empty(len(exponents)), pointer(exponents)
    tables, length, to_draw = effects.tables, effects.tables.shape[1], len(uniform) > 0
    reach, memory = _reaches(t, effects, species, radius_m), np.full((RING, 4), -1.0)
    asked = len(species) if to_draw and t.node_levels > 1 else 0
    plan = _Plan(pointer(memory), pointer(totals), pointer(species), pointer(reach), pointer(uniform), asked)
    for f in range(len(exponents)):
        totals[f] = total_of_pointed(t, f)
    for n in range(len(species)):
        f = species[n]
        if to_draw:
            _ask(t, plan, 0, n + 3 * AHEAD)
            if totals[f] > 0.0:
                places[n, 0], places[n, 1] = draw(t, f, totals[f], uniform[n, 0], uniform[n, 1])
            _ask(t, plan, 1, n + 2 * AHEAD)
            if not totals[f] > 0.0:
                continue
        for g in range(len(exponents)):
            k = effects.which[g, f]
            if k < 0:
                continue
            r_m = effects.reach[k] * (radius_m[n] if effects.in_radii[k] else 1.0)
            if r_m > 0.0 and totals[g] > 0.0:
                last = 0.0 if effects.constant[k] else float(length - 2)
                table, balanced = pointer(tables[k]), effects.balanced[k]
                x, y = places[n, 0], places[n, 1]
                new = _deform(t, g, totals[g], table, last, tables[k, 0], balanced, r_m, x, y)
                if new != 0.0 and not SMALLEST_TOTAL <= new <= GREATEST_TOTAL:
                    new = kept(t, g, new, powers)
                totals[g] = new
        _ask(t, plan, 2, n + AHEAD)
    return totals[0] + exponents[0] + memory[0, 0] + len(reach)  # held until here
