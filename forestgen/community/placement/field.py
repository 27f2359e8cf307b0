"""The probability field that kernels deform, and draws from it.

The field is a grid of cells, each of one density. A place is drawn by the inverse transformation method: first its row
by the rows' sums and its y inside the row by linear interpolation, then its column by that row's partial sums and its
x in the same way. That is exact: the density is constant in a cell.

Each row is a tree of sums: its cells, the sums of eight cells, of 64, ..., up to the last eight numbers, whose sum is
the row's. The rows' sums are the leaves of one more such tree. A draw walks down both; a plant changes the cells in
its kernel's reach and what stands above them, so that it costs what the reach asks for, and the logarithm of the
field's size. Each node is the sum of its children, taken anew and always in the same order: no rounding error grows
with the number of plants.

Reference: Lane 2002, sections 5.1 and 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, frexp, ldexp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.kernels import GREATEST, SAMPLES, KernelTable
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled, inlined, inlined_exactly, unowned_view

SMALLEST = 1e-290  # a cell below is 0: products stay clear of the slow numbers near the smallest
GREATEST_TOTAL, SMALLEST_TOTAL = 1e250, 1e-150  # outside, a field is scaled by a power of two
EDGE = 2.0**-32  # of a cell: places keep this far from its edges, so that rounding moves none into the next cell
LEAST_LEFT = 1e-200  # of the sum within reach: a balanced kernel that leaves less bars all of it


class Trees(NamedTuple):
    """Cells and sums of F fields of the same shape, one after another; a level of a tree follows the one below."""

    cells: Floats  # (F * rows * row_stride,) of each row its cells, zeros up to a multiple of eight, then its sums
    sums: Floats  # (F * sum_stride,) of the rows, then of eight rows, ...
    row_levels: NDArray[np.int64]  # (levels,) where in a row's tree each level begins
    sum_levels: NDArray[np.int64]  # (levels,)
    row_stride: int  # numbers of a row's tree
    sum_stride: int
    rows: int
    cols: int
    width_m: float  # of a cell
    height_m: float
    periodic: bool
    squares: Floats  # (columns,) scratch: squared distances along x
    eight: Floats  # (8,) scratch
    windows: NDArray[np.int64]  # (4, 6) scratch: first and last row and column in reach, and images along y and x


class Effects(NamedTuple):
    """The kernels, K in all."""

    which: NDArray[np.int64]  # (F, S) kernel of a plant of species S on field F; -1: none
    tables: Floats  # (K, samples + 2): κ at even distances up to the reach, the last one twice
    constant: NDArray[np.bool_]  # (K,) κ is the same all over
    balanced: NDArray[np.bool_]  # (K,)
    reach: Floats  # (K,) in radii or metres
    in_radii: NDArray[np.bool_]  # (K,)


@inlined_exactly
def _sum(tree, at):  # type: ignore[no-untyped-def]
    """Sum of eight numbers."""
    even = (tree[at] + tree[at + 4]) + (tree[at + 2] + tree[at + 6])
    return even + ((tree[at + 1] + tree[at + 5]) + (tree[at + 3] + tree[at + 7]))


@inlined_exactly
def _pick(tree, at, u):  # type: ignore[no-untyped-def]
    """Of eight numbers the k in which the partial sums pass u, and what of u is left there; never one that is 0."""
    two, next_two = tree[at + 1] + tree[at], tree[at + 5] + tree[at + 4]
    four = (tree[at + 3] + tree[at + 2]) + two
    six, seven = next_two + four, (tree[at + 6] + next_two) + four
    k, before = 0, 0.0
    for total in (tree[at], two, tree[at + 2] + two, four, tree[at + 4] + four, six, seven):
        if total > u:
            break
        k, before = k + 1, total
    value = tree[at + k]
    if u - before < value:
        return k, u - before
    while k > 0 and not value > 0.0:  # u has reached the sum, by rounding: the last that is not 0
        k -= 1
        value = tree[at + k]
    return k, value


@inlined_exactly
def _find(tree, at, levels, u):  # type: ignore[no-untyped-def]
    """The leaf in which the partial sums pass u, and what of u is left there."""
    leaf = 0
    for level in range(len(levels) - 1, -1, -1):
        k, u = _pick(tree, at + levels[level] + leaf * 8, u)
        leaf = leaf * 8 + k
    return leaf, u


@inlined_exactly
def _renew(tree, at, levels, first, last):  # type: ignore[no-untyped-def]
    """Take all sums above the leaves `first` to `last` anew; the sum of all leaves."""
    for level in range(1, len(levels)):
        first, last = first // 8, last // 8
        for node in range(first, last + 1):
            tree[at + levels[level] + node] = _sum(tree, at + levels[level - 1] + node * 8)
    return _sum(tree, at + levels[len(levels) - 1])


@inlined_exactly
def _inside(u, value):  # type: ignore[no-untyped-def]
    """How far into a cell of `value`, or a row, u lies."""
    return min(max(u / value, EDGE), 1.0 - EDGE)


@inlined_exactly
def _draw(t, f, total, u, v):  # type: ignore[no-untyped-def]
    """x, y in cells, of two numbers in [0, 1)."""
    row, u = _find(t.sums, f * t.sum_stride, t.sum_levels, u * total)
    line, of_row = (f * t.rows + row) * t.row_stride, t.sums[f * t.sum_stride + row]
    col, v = _find(t.cells, line, t.row_levels, v * of_row)
    return col + _inside(v, t.cells[line + col]), row + _inside(u, of_row)


@inlined_exactly
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


@inlined_exactly
def _windows(t, r_m, x, y):  # type: ignore[no-untyped-def]
    """Set `t.windows` to where a disc around (x, y) meets the site; their number, up to four if it is periodic."""
    i0, i1 = _reached(y, r_m / t.height_m, t.rows, t.periodic)
    j0, j1 = _reached(x, r_m / t.width_m, t.cols, t.periodic)
    count = 0
    for a in range(-1 if i1 >= t.rows else 0, 2 if i0 < 0 else 1):
        top, bottom = max(i0 + a * t.rows, 0), min(i1 + a * t.rows, t.rows - 1)
        for b in range(-1 if j1 >= t.cols else 0, 2 if j0 < 0 else 1):
            left, right = max(j0 + b * t.cols, 0), min(j1 + b * t.cols, t.cols - 1)
            if top <= bottom and left <= right:
                one = t.windows[count]
                one[0], one[1], one[2], one[3], one[4], one[5] = top, bottom, left, right, a, b
                count += 1
    return count


@inlined_exactly
def _measure(t, window, x):  # type: ignore[no-untyped-def]
    """Set `t.squares`, from the window's first eight columns on, to squared distances from x in metres."""
    start = t.windows[window, 2] // 8 * 8
    for j in range(start, (t.windows[window, 3] // 8 + 1) * 8):
        dx = (j + 0.5 - (x + t.windows[window, 5] * t.cols)) * t.width_m
        t.squares[j - start] = dx * dx if t.windows[window, 2] <= j <= t.windows[window, 3] else np.inf


@inlined
def _kappa(table, at):  # type: ignore[no-untyped-def]
    """The kernel's value between two of its table."""
    k = int(at)
    return table[k] + (at - k) * (table[k + 1] - table[k])


@inlined_exactly
def _multiply(t, f, count, r_m, table, last, factor, x, y):  # type: ignore[no-untyped-def]
    """Multiply the cells in reach by `table`, or by `factor` if `last` is 0; the field's total."""
    total, r2, scale = 0.0, r_m * r_m, last / r_m
    for window in range(count):
        _measure(t, window, x)
        i0, i1, j0, j1 = t.windows[window, 0], t.windows[window, 1], t.windows[window, 2], t.windows[window, 3]
        squares = t.squares[j0 % 8 : j0 % 8 + j1 - j0 + 1]
        for i in range(i0, i1 + 1):
            dy = (i + 0.5 - (y + t.windows[window, 4] * t.rows)) * t.height_m
            dy2, line = dy * dy, (f * t.rows + i) * t.row_stride
            cells = t.cells[line + j0 : line + j1 + 1]
            for k in range(len(cells)):
                d2, kappa = squares[k] + dy2, factor
                if last > 0.0:
                    kappa = _kappa(table, min(sqrt(d2) * scale, last))
                value = cells[k] * (kappa if d2 <= r2 else 1.0)
                cells[k] = value if value >= SMALLEST else 0.0
            t.sums[f * t.sum_stride + i] = _renew(t.cells, line, t.row_levels, j0, j1)
        total = _renew(t.sums, f * t.sum_stride, t.sum_levels, i0, i1)
    return total


@inlined_exactly
def _within(t, f, count, r_m, x, y):  # type: ignore[no-untyped-def]
    """Sum of the cells in reach."""
    total, r2 = 0.0, r_m * r_m
    for window in range(count):
        _measure(t, window, x)
        here, start = 0.0, t.windows[window, 2] // 8 * 8
        for first in range(start, t.windows[window, 3] + 1, 8):
            for i in range(t.windows[window, 0], t.windows[window, 1] + 1):
                dy = (i + 0.5 - (y + t.windows[window, 4] * t.rows)) * t.height_m
                dy2, line = dy * dy, (f * t.rows + i) * t.row_stride
                for k in range(8):
                    near = t.squares[first - start + k] + dy2 <= r2
                    t.eight[k] = t.cells[line + first + k] if near else 0.0
                here += _sum(t.eight, 0)
        total += here
    return total


@compiled
def _deform(t, f, total, table, last, balanced, r_m, x, y):  # type: ignore[no-untyped-def]
    """The field after a plant at (x, y); its total. `last` is 0 if κ is the same all over."""
    count = _windows(t, r_m, x, y)
    if count == 0:  # no cell's middle is in reach
        return total
    before = _within(t, f, count, r_m, x, y) if balanced else 0.0
    total = _multiply(t, f, count, r_m, table, last, table[0], x, y)
    if before > 0.0:
        after = _within(t, f, count, r_m, x, y)
        if after > before * LEAST_LEFT:
            total = _multiply(t, f, count, r_m, table, 0.0, before / after, x, y)
    return total


@compiled
def _build(t, f):  # type: ignore[no-untyped-def]
    """All sums of a field; its total."""
    for i in range(t.rows):
        line = (f * t.rows + i) * t.row_stride
        t.sums[f * t.sum_stride + i] = _renew(t.cells, line, t.row_levels, 0, t.cols - 1)
    return _renew(t.sums, f * t.sum_stride, t.sum_levels, 0, t.rows - 1)


@compiled
def _kept(t, f, total, exponents):  # type: ignore[no-untyped-def]
    """Scale a field whose total has become too great or too small; its total."""
    if total == 0.0 or SMALLEST_TOTAL <= total <= GREATEST_TOTAL:
        return total
    _, exponent = frexp(total)
    factor = ldexp(1.0, -exponent)
    for line in range(f * t.rows, (f + 1) * t.rows):
        for k in range(line * t.row_stride, line * t.row_stride + t.cols):
            value = t.cells[k] * factor
            t.cells[k] = value if value >= SMALLEST else 0.0
    exponents[f] += exponent
    return _build(t, f)


@compiled
def build(trees, exponents):  # type: ignore[no-untyped-def]
    """All sums of all fields."""
    for f in range(len(exponents)):
        _kept(trees, f, _build(trees, f), exponents)


@compiled
def _draw_all(trees, uniform, places):  # type: ignore[no-untyped-def]
    """Places, (N, 2) in cells, of (N, 2) numbers, in the first field, which stays."""
    t = unowned_view(trees)
    total = _sum(t.sums, t.sum_levels[len(t.sum_levels) - 1])
    for n in range(len(uniform)):
        places[n, 0], places[n, 1] = _draw(t, 0, total, uniform[n, 0], uniform[n, 1])


@compiled
def _place_all(trees, exponents, effects, species, radius_m, uniform, places):  # type: ignore[no-untyped-def]
    """Draw each plant from its species' field and deform all fields.

    `places`, (N, 2) in cells, stay as they are where none is left. With `uniform` empty, they are given.
    """
    t, kernels = unowned_view(trees), unowned_view(effects)
    last, totals = float(kernels.tables.shape[1] - 2), np.empty(len(exponents))
    for f in range(len(exponents)):
        totals[f] = _sum(t.sums, f * t.sum_stride + t.sum_levels[len(t.sum_levels) - 1])
    for n in range(len(species)):
        mine = species[n]
        if len(uniform):
            if not totals[mine] > 0.0:
                continue
            places[n, 0], places[n, 1] = _draw(t, mine, totals[mine], uniform[n, 0], uniform[n, 1])
        for f in range(len(exponents)):
            k = kernels.which[f, mine]
            if k < 0 or not totals[f] > 0.0:
                continue
            r_m = kernels.reach[k] * (radius_m[n] if kernels.in_radii[k] else 1.0)
            if r_m > 0.0:
                table, far, balanced = kernels.tables[k], 0.0 if kernels.constant[k] else last, kernels.balanced[k]
                new = _deform(t, f, totals[f], table, far, balanced, r_m, places[n, 0], places[n, 1])
                totals[f] = _kept(t, f, new, exponents)


class DensityField:
    """A field over the site [0, W] x [0, H]; deforming changes it in place.

    Its sum may neither overflow nor vanish, however often it is deformed: a field whose sum leaves 1e-150 to 1e250 is
    divided by a power of two, which `exponent` remembers. A cell below 1e-290 counts as 0.

    It begins as a copy of a density (rows, cols), >= 0 and finite, or else a ValueError; row 0 lies at y = 0, column 0
    at x = 0. If `periodic`, opposite edges meet: kernels reach across them, and a cell is deformed once, at its least
    distance.
    """

    def __init__(self, density: Floats, size_m: tuple[float, float], *, periodic: bool) -> None:
        density = np.asarray(density, dtype=np.float64)
        least, greatest = float(density.min()), float(density.max())
        if not (least >= 0.0 and np.isfinite(greatest)):
            raise ValueError("densities are numbers from 0 up, and finite")
        (rows, cols), (width_m, height_m) = density.shape, size_m
        self.shape, self.size_m, self.periodic = density.shape, size_m, periodic
        self._exponents = np.zeros(1, dtype=np.int64)
        (row_levels, row_stride), (sum_levels, sum_stride) = _levels(cols), _levels(rows)
        self._trees = Trees(
            np.zeros(rows * row_stride), np.zeros(sum_stride), row_levels, sum_levels, row_stride, sum_stride,
            rows, cols, width_m / cols, height_m / rows, bool(periodic),
            np.empty(row_stride), np.empty(8), np.empty((4, 6), dtype=np.int64),
        )  # fmt: skip
        cells = self._cells
        cells[...] = density
        if greatest != 0.0 and not 1e-100 < greatest < 1e200:
            self._exponents[0] = int(np.frexp(greatest)[1])
            np.ldexp(cells, -int(self._exponents[0]), out=cells)
        np.copyto(cells, 0.0, where=cells < SMALLEST)
        build(self._trees, self._exponents)

    @property
    def _cells(self) -> Floats:
        """(rows, cols), a view."""
        return self._trees.cells.reshape(self._trees.rows, -1)[:, : self._trees.cols]

    @property
    def cells(self) -> Floats:
        """(rows, cols) as deformed so far, in units of 2 ** exponent; a copy."""
        return self._cells.copy()

    @property
    def exponent(self) -> int:
        """The density is `cells` times 2 to this power; 0 unless the field has left the range of sums."""
        return int(self._exponents[0])

    @property
    def total(self) -> float:
        """Sum of all cells; 0: no place is left."""
        last = self._trees.sums[self._trees.sum_levels[-1] :]
        return float(_sum(last, 0))

    def deform(self, position_m: Floats, radius_m: Floats, kernel: KernelTable) -> None:
        """Multiply by the kernels of plants at (N, 2) places with (N,) radii, metres."""
        places = np.ascontiguousarray(position_m, dtype=np.float64).reshape(-1, 2) / _cell_m(self)
        radius = np.array(radius_m, dtype=np.float64)  # never read-only, which would be a second kernel
        species, none = np.zeros(len(radius), dtype=np.int64), np.empty((0, 2))
        _place_all(self._trees, self._exponents, _effects([[kernel]]), species, radius, none, places)

    def draw(self, uniform: Floats) -> Floats:
        """(N, 2) places, metres, of (N, 2) numbers in [0, 1): the first chooses y, then x; `total` must be > 0."""
        if not self.total > 0.0:
            raise ValueError("nothing can be drawn from a field that is 0 everywhere")
        places = np.empty((len(uniform), 2))
        _draw_all(self._trees, np.ascontiguousarray(uniform, dtype=np.float64), places)
        return np.asarray(places * _cell_m(self))


@dataclass(frozen=True)
class Placement:
    """Where plants came to stand."""

    position_m: Floats  # (N, 2) metres; nan for one that found no place
    placed: NDArray[np.bool_]  # (N,)


def place(
    fields: Sequence[DensityField],
    species: NDArray[np.integer],
    radius_m: Floats,
    kernels: Sequence[Sequence[KernelTable]],
    uniform: Floats,
) -> Placement:
    """Place plants one by one, each of which deforms the fields of all species.

    A plant whose species' field is 0 everywhere finds no place; others go on. The fields are of one shape, and deformed
    in place. `species` and `radius_m` (N,) come in the order of placement; row k of `uniform` (N, 2), in [0, 1), is
    plant k's, used or not. kernels[i][j] is the effect of a plant of species j on the field of species i (Lane's M_ij).
    """
    places = np.full((len(species), 2), np.nan)
    if len(species) == 0:
        return Placement(places, np.zeros(0, dtype=np.bool_))
    together, exponents = fields[0]._trees, fields[0]._exponents
    if len(fields) > 1:
        cells, sums = (np.concatenate([getattr(one._trees, name) for one in fields]) for name in ("cells", "sums"))
        together, exponents = together._replace(cells=cells, sums=sums), np.concatenate([f._exponents for f in fields])
    chosen, radius = np.array(species, dtype=np.int64), np.array(radius_m, dtype=np.float64)  # as in `deform`
    uniform = np.array(uniform, dtype=np.float64)
    _place_all(together, exponents, _effects(kernels), chosen, radius, uniform, places)
    if len(fields) > 1:
        for index, one in enumerate(fields):
            one._trees.cells[:] = together.cells.reshape(len(fields), -1)[index]
            one._trees.sums[:] = together.sums.reshape(len(fields), -1)[index]
            one._exponents[0] = exponents[index]
    return Placement(np.asarray(places * _cell_m(fields[0])), ~np.isnan(places[:, 0]))


def _cell_m(field: DensityField) -> tuple[float, float]:
    """Width and height of a cell."""
    return field._trees.width_m, field._trees.height_m


def _levels(leaves: int) -> tuple[NDArray[np.int64], int]:
    """Where each level of a tree of sums begins, leaves first, and the length of all; a node has eight children."""
    starts, length = [], 0
    while True:
        nodes = -(-leaves // 8)
        starts.append(length)
        length += nodes * 8
        if nodes == 1:
            return np.array(starts, dtype=np.int64), length
        leaves = nodes


def _effects(kernels: Sequence[Sequence[KernelTable]]) -> Effects:
    used = list({id(one): one for row in kernels for one in row if not one.is_neutral}.values())
    numbers = {id(one): number for number, one in enumerate(used)}
    which = np.array([[numbers.get(id(one), -1) for one in row] for row in kernels], dtype=np.int64)
    tables = np.ones((max(len(used), 1), SAMPLES + 2))
    for k, kernel in enumerate(used):
        if not np.all((kernel.values >= 0.0) & (kernel.values <= GREATEST)):
            raise ValueError(f"a kernel's values are numbers from 0 to {GREATEST:g}")
        tables[k, :-1], tables[k, -1] = kernel.values, kernel.values[-1]
    return Effects(
        which,
        tables,
        np.array([np.ptp(kernel.values) == 0.0 for kernel in used], dtype=np.bool_),
        np.array([kernel.balanced for kernel in used], dtype=np.bool_),
        np.array([kernel.reach for kernel in used], dtype=np.float64),
        np.array([kernel.in_radii for kernel in used], dtype=np.bool_),
    )
