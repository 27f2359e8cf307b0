"""The probability field that kernels deform, and draws from it.

The field is a grid of cells, each of one density. A place is drawn by the inverse transformation method: first its row
by the rows' sums and its y inside the row by linear interpolation, then its column by that row's partial sums and its
x in the same way. That is exact: the density is constant in a cell. Sums are kept in trees (`field_trees`), so that a
plant costs what its kernel's reach asks for, however large the field is.

References
----------
Lane 2002, sections 5.1 and 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.field_kernel import Effects, place_all
from forestgen.community.placement.field_lanes import LANES, LARGE_PAGE, SMALLEST
from forestgen.community.placement.field_trees import Trees, build, draw_all, total_of
from forestgen.community.placement.kernels import GREATEST, NEUTRAL, SAMPLES, KernelTable


class DensityField:
    """A field over the site [0, W] x [0, H]; deforming changes it in place.

    Its sum may neither overflow nor vanish, however often it is deformed: a field whose sum leaves 1e-150 to 1e250 is
    divided by a power of two, which `exponent` remembers. A cell below 1e-290 counts as 0.

    It begins as a copy of a density (rows, cols), >= 0 and finite, or else a ValueError; row 0 lies at y = 0, column 0
    at x = 0. If `periodic`, opposite edges meet: kernels reach across them, and a cell is deformed once, at its least
    distance.
    """

    def __init__(self, density: NDArray[np.float64], size_m: tuple[float, float], *, periodic: bool) -> None:
        density = np.asarray(density, dtype=np.float64)
        least, greatest = float(density.min()), float(density.max())
        if not (least >= 0.0 and np.isfinite(greatest)):
            raise ValueError("densities are numbers from 0 up, and finite")
        self.shape, self.size_m, self.periodic = density.shape, size_m, periodic
        self._fields, self._index = _Fields.empty(1, density.shape, size_m, periodic), 0
        self._fields.set_grid(density)
        cells = self._fields.trees.cells
        if greatest != 0.0 and not 1e-100 < greatest < 1e200:
            self._fields.exponents[0] = int(np.frexp(greatest)[1])
            np.ldexp(cells, -int(self._fields.exponents[0]), out=cells)
        np.copyto(cells, 0.0, where=cells < SMALLEST)
        build(self._fields.trees, self._fields.exponents)

    @property
    def cells(self) -> NDArray[np.float64]:
        """(rows, cols) as deformed so far, in units of 2 ** exponent; a copy."""
        return self._fields.grid(self._index)

    @property
    def exponent(self) -> int:
        """The density is `cells` times 2 to this power; 0 unless the field has left the range of sums."""
        return int(self._fields.exponents[self._index])

    @property
    def total(self) -> float:
        """Sum of all cells; 0: no place is left."""
        return float(total_of(self._fields.trees, self._index))

    def deform(self, position_m: NDArray[np.float64], radius_m: NDArray[np.float64], kernel: KernelTable) -> None:
        """Multiply by the kernels of plants at (N, 2) places with (N,) radii, metres."""
        fields = self._fields
        radius = np.ascontiguousarray(radius_m, dtype=np.float64)
        places = np.ascontiguousarray(position_m, dtype=np.float64).reshape(-1, 2) / fields.cell_m
        effects = _effects([[kernel if index == self._index else NEUTRAL] for index in range(len(fields.exponents))])
        species, none = np.zeros(len(radius), dtype=np.int64), np.empty((0, 2))
        place_all(fields.trees, fields.exponents, effects, species, radius, none, places)

    def draw(self, uniform: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 2) places, metres, of (N, 2) numbers in [0, 1): the first chooses y, then x; `total` must be > 0."""
        if not self.total > 0.0:
            raise ValueError("nothing can be drawn from a field that is 0 everywhere")
        uniform = np.ascontiguousarray(uniform, dtype=np.float64)
        places = np.empty((len(uniform), 2))
        draw_all(self._fields.trees, self._index, uniform, places)
        return np.asarray(places * self._fields.cell_m)


@dataclass(frozen=True)
class Placement:
    """Where plants came to stand."""

    position_m: NDArray[np.float64]  # (N, 2) metres; nan for one that found no place
    placed: NDArray[np.bool_]  # (N,)


def place(
    fields: Sequence[DensityField],
    species: NDArray[np.integer],
    radius_m: NDArray[np.float64],
    kernels: Sequence[Sequence[KernelTable]],
    uniform: NDArray[np.float64],
) -> Placement:
    """Place plants one by one, each of which deforms the fields of all species.

    A plant whose species' field is 0 everywhere finds no place; others go on. The fields are of one shape, and deformed
    in place. `species` and `radius_m` (N,) come in the order of placement; row k of `uniform` (N, 2), in [0, 1), is
    plant k's, used or not. kernels[i][j] is the effect of a plant of species j on the field of species i (Lane's M_ij).
    """
    places = np.full((len(species), 2), np.nan)
    if len(species) == 0:
        return Placement(places, np.zeros(0, dtype=np.bool_))
    together = _together(fields)
    chosen = np.ascontiguousarray(species, dtype=np.int64)
    radius = np.ascontiguousarray(radius_m, dtype=np.float64)
    uniform = np.ascontiguousarray(uniform, dtype=np.float64)
    place_all(together.trees, together.exponents, _effects(kernels), chosen, radius, uniform, places)
    return Placement(np.asarray(places * together.cell_m), ~np.isnan(places[:, 0]))


@dataclass(frozen=True)
class _Fields:
    """Memory of fields of one shape that are deformed together."""

    trees: Trees
    exponents: NDArray[np.int64]  # (F,)

    @classmethod
    def empty(cls, count: int, shape: tuple[int, ...], size_m: tuple[float, float], periodic: bool) -> _Fields:
        rows, cols = shape
        strips, groups = -(-cols // LANES), -(-rows // LANES)
        panels = -(-strips // LANES)
        upper_level, upper_lines, upper_stride = _upper_levels(panels, groups)
        sum_level, sum_stride = _levels(rows)
        cell_stride, node_stride = strips * rows * LANES, panels * rows * LANES
        trees = Trees(
            _aligned(count * cell_stride), _aligned(count * node_stride), _aligned(count * upper_stride),
            _aligned(count * sum_stride), upper_level, upper_lines, sum_level, len(upper_level), len(sum_level),
            rows, cols, strips, groups, cell_stride, node_stride, upper_stride, sum_stride,
            size_m[0] / cols, size_m[1] / rows, bool(periodic),
        )  # fmt: skip
        return cls(trees, np.zeros(count, dtype=np.int64))

    @property
    def cell_m(self) -> tuple[float, float]:
        """Width and height of a cell."""
        return self.trees.width_m, self.trees.height_m

    def strips(self, index: int) -> NDArray[np.float64]:
        """(strips, rows, 8) cells of a field, a view."""
        t = self.trees
        return np.asarray(t.cells.reshape(len(self.exponents), t.strips, t.rows, LANES)[index])

    def grid(self, index: int) -> NDArray[np.float64]:
        """(rows, cols) cells of a field, a copy."""
        t = self.trees
        return self.strips(index).transpose(1, 0, 2).reshape(t.rows, t.strips * LANES)[:, : t.cols]

    def set_grid(self, cells: NDArray[np.float64]) -> None:
        """Set the first field's (rows, cols) cells, not its sums."""
        for strip, ours in enumerate(self.strips(0)):
            theirs = cells[:, strip * LANES : (strip + 1) * LANES]
            ours[:, : theirs.shape[1]] = theirs


def _memories(trees: Trees) -> tuple[NDArray[np.float64], ...]:
    """What each field has a part of."""
    return trees.cells, trees.nodes, trees.upper, trees.sums


def _together(fields: Sequence[DensityField]) -> _Fields:
    """The fields one after another in one memory, to which they refer from now on."""
    first = fields[0]._fields
    if len(first.exponents) == len(fields) and all(f._fields is first and f._index == i for i, f in enumerate(fields)):
        return first
    new = _Fields.empty(len(fields), fields[0].shape, fields[0].size_m, fields[0].periodic)
    for index, field in enumerate(fields):
        old, at = field._fields, field._index
        for theirs, ours in zip(_memories(old.trees), _memories(new.trees), strict=True):
            ours.reshape(len(fields), -1)[index] = theirs.reshape(len(old.exponents), -1)[at]
        new.exponents[index] = old.exponents[at]
        field._fields, field._index = new, index
    return new


def _aligned(count: int) -> NDArray[np.float64]:
    """Zeros that begin with a line of memory; many of them with a large page."""
    unit = LARGE_PAGE if count > LARGE_PAGE else LANES
    memory = np.empty(count + unit)
    start = -(memory.ctypes.data // memory.itemsize) % unit
    zeros: NDArray[np.float64] = memory[start : start + count]
    zeros[...] = 0.0
    return zeros


def _levels(leaves: int) -> tuple[NDArray[np.int64], int]:
    """Where each level of a tree of sums begins, leaves first, and the length of all; a node has eight children."""
    starts, length = [], 0
    while True:
        nodes = -(-leaves // LANES)
        starts.append(length)
        length += nodes * LANES
        if nodes == 1:
            return np.array(starts, dtype=np.int64), length
        leaves = nodes


def _upper_levels(panels: int, groups: int) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Where each level of sums of panels begins, how many lines its blocks have, and the length of all.

    Reading eight lines of a block of four passes its end: so a block of eight is left free at the end.
    """
    starts, lines, length = [], [], 0
    while panels > 1:
        starts.append(length)
        lines.append(4 if panels <= 4 else LANES)
        panels = -(-panels // LANES)
        length += panels * groups * lines[-1] * LANES
    return np.array(starts, dtype=np.int64), np.array(lines, dtype=np.int64), length + LANES * LANES


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
