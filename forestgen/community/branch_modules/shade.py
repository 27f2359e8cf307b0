"""Shade: what light the global shadow grid leaves to branch modules.

Reference: M. Makowski et al., Synthetic Silviculture, 2019, in the form of the book of 2023, section 2.6.2; shadow
propagation after W. Palubicki et al., Self-organizing tree models for image synthesis, SIGGRAPH 2009. ::

    S_k = spread(S_(k+1) + D_(k+1))          optical depth above layer k, from the highest layer to the ground
    Q_G = T exp(-(S_k + (D_k - own) / 2))

The paper names a grid whose cells lose light below a module, and no rule. Here light falls by Beer's law through layers
that count from the local ground. A module adds the optical depth -ln(1 - opacity) x area of its sphere's disc /
area of a cell to the cells that the disc covers (as a square of the same area), in the layer of its centre: D_k. S_k is
that of all layers above, spread by the kernel [s, 1 - 2 s, s] along x and y for each layer down. A module sees, over
its own disc, all layers above its own and half of its own layer less itself. At the edge of a bounded site what would
spread out is mirrored back: the stand goes on.

Obstacles are opaque: T, the share of the light that boxes let through, is 0 in them, 1 above them, and spreads down by
the same kernel; a cell of which a box takes a part has at most the light of the other part.

Depths are summed as whole numbers: the order of modules does not matter to the bit. Time is O(modules + cells).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import exp, floor, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes
from forestgen.core.compiled import compiled
from forestgen.core.errors import ResourceError

UNITS = 2.0**24  # of optical depth of a cell in whole numbers
_MOST_LAYERS = 2000
_PER_SIDE = 8  # points of a cell that decide how much of it a box covers
_CELLS_AT_ONCE = 16_384  # of which these points are held

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ShadowGrid:
    """Extent of the shadow grid; numbers of cells follow from it."""

    size_m: tuple[float, float]  # width and height of the site, which begins at 0, 0
    cell_m: float = 2.0  # about: cells tile the site
    layer_m: float = 2.0
    spread: float = 0.25  # s, 0 to 0.5: share that moves to each side for each layer down
    periodic: bool = False

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        return max(1, round(self.size_m[0] / self.cell_m)), max(1, round(self.size_m[1] / self.cell_m))

    @property
    def per_m(self) -> tuple[float, float]:
        return self.cells[0] / self.size_m[0], self.cells[1] / self.size_m[1]


@dataclass(frozen=True)
class Shade:
    """The light of all modules, and near the ground."""

    light: NDArray[np.float32]  # (M,) Q_G, 0 to 1
    grid: ShadowGrid
    ground_depth: Floats  # (ny, nx) optical depth above the lowest layer and of half of it
    ground_share: Floats  # (ny, nx) T of the lowest layer

    def light_at(self, position_m: Floats) -> Floats:
        """(N,) Q_G of points within the lowest layer, such as seeds, at (N, 2) world x and y on the site."""
        (nx, ny), (per_x, per_y) = self.grid.cells, self.grid.per_m
        column = np.floor(position_m[:, 0] * per_x).astype(np.int64)
        line = np.floor(position_m[:, 1] * per_y).astype(np.int64)
        if self.grid.periodic:
            column, line = column % nx, line % ny
        at = np.clip(line, 0, ny - 1), np.clip(column, 0, nx - 1)
        return np.asarray(self.ground_share[at] * np.exp(-self.ground_depth[at]))


@compiled
def _place(k, n, periodic):  # type: ignore[no-untyped-def]
    """Index of a cell that may lie beyond the edge: around the torus, or mirrored."""
    if periodic:
        return k % n
    k = -1 - k if k < 0 else (2 * n - 1 - k if k >= n else k)
    return min(max(k, 0), n - 1)


@compiled
def _covered(at, half, k):  # type: ignore[no-untyped-def]
    """Share of the interval at ± half, in cells, that lies in cell k."""
    return max(min(at + half, k + 1.0) - max(at - half, float(k)), 0.0) / (2.0 * half)


@compiled
def _deposit(rows, position, radius, depth, per_x, per_y, periodic, plane):  # type: ignore[no-untyped-def]
    """Add the optical depths of modules `rows`, all of one layer, to the whole numbers of `plane` (ny, nx)."""
    ny, nx = plane.shape
    for i in rows:
        side = 0.5 * sqrt(pi) * radius[i]
        x, y, half_x, half_y = position[i, 0] * per_x, position[i, 1] * per_y, side * per_x, side * per_y
        total = depth[i] * 4.0 * half_x * half_y * UNITS
        for b in range(floor(y - half_y), floor(y + half_y) + 1):
            share = total * _covered(y, half_y, b)
            line = _place(b, ny, periodic)
            for a in range(floor(x - half_x), floor(x + half_x) + 1):
                plane[line, _place(a, nx, periodic)] += np.int64(share * _covered(x, half_x, a) + 0.5)


@compiled
def _read(rows, position, radius, depth, per_x, per_y, periodic, plane, above, share, light):  # type: ignore[no-untyped-def]
    """Set the `light` of modules `rows`, all of one layer: of its depth `plane`, that `above`, and T, `share`."""
    ny, nx = plane.shape
    for i in rows:
        side = 0.5 * sqrt(pi) * radius[i]
        x, y, half_x, half_y = position[i, 0] * per_x, position[i, 1] * per_y, side * per_x, side * per_y
        total = depth[i] * 4.0 * half_x * half_y * UNITS
        seen, through = 0.0, 0.0
        for b in range(floor(y - half_y), floor(y + half_y) + 1):
            part_y, line = _covered(y, half_y, b), _place(b, ny, periodic)
            for a in range(floor(x - half_x), floor(x + half_x) + 1):
                part = part_y * _covered(x, half_x, a)
                column = _place(a, nx, periodic)
                own = np.int64(total * part_y * _covered(x, half_x, a) + 0.5)
                seen += part * (above[line, column] + 0.5 * (plane[line, column] - own) / UNITS)
                through += part * share[line, column]
        light[i] = through * exp(-max(seen, 0.0))


@compiled
def _spread(above, plane, s, periodic, out):  # type: ignore[no-untyped-def]
    """Set `out` to what lies above the next layer down: (`above` + `plane`), each cell's spread over 3 x 3."""
    ny, nx = above.shape
    line = np.empty((3, nx))
    filled = np.full(3, -9)
    for b in range(ny):
        for step in range(-1, 2):
            source = _place(b + step, ny, periodic)
            slot = (b + step) % 3
            if filled[slot] == b + step:
                continue
            filled[slot] = b + step
            for a in range(nx):
                left, right = _place(a - 1, nx, periodic), _place(a + 1, nx, periodic)
                beside = above[source, left] + plane[source, left] / UNITS
                beside = beside + above[source, right] + plane[source, right] / UNITS
                here = above[source, a] + plane[source, a] / UNITS
                line[slot, a] = (1.0 - 2.0 * s) * here + s * beside
        before, own, after = (b - 1) % 3, b % 3, (b + 1) % 3
        for a in range(nx):
            out[b, a] = (1.0 - 2.0 * s) * line[own, a] + s * (line[before, a] + line[after, a])


def _open_shares(boxes: Boxes, box_layers: NDArray[np.int64], grid: ShadowGrid, top: int) -> Iterator[Floats]:
    """(ny, nx) share of each cell that no box takes, which bounds its light: of layer top - 1 down to the ground."""
    waiting, taken = np.argsort(box_layers, kind="stable").tolist(), np.zeros(grid.cells[::-1])  # the highest last
    for layer in range(top - 1, -1, -1):
        while waiting and layer < box_layers[waiting[-1]]:
            _add_cover(boxes, waiting.pop(), grid, taken)
        yield np.asarray(np.maximum(1.0 - taken, 0.0))


def _add_cover(boxes: Boxes, k: int, grid: ShadowGrid, taken: Floats) -> None:
    """Add to `taken` (ny, nx) the share of each cell that box k covers: that of points; O(cells near it)."""
    (nx, ny), (per_x, per_y) = grid.cells, grid.per_m
    one = Boxes(boxes.base_m[k : k + 1], boxes.size_m[k : k + 1], boxes.azimuth_rad[k : k + 1])
    period_m = grid.size_m if grid.periodic else None
    cell_reach = float(np.hypot(0.5 / per_x, 0.5 / per_y)) * (1 + 1e-6)
    reach = float(np.hypot(*boxes.size_m[k, :2])) / 2 + cell_reach
    near = []
    for d, (n, per) in enumerate(((nx, per_x), (ny, per_y))):
        offset = (np.arange(n) + 0.5) / per - boxes.base_m[k, d]
        if period_m is not None:
            offset -= np.round(offset / period_m[d]) * period_m[d]
        near.append(np.flatnonzero(np.abs(offset) <= reach))
    rows, cols = (one.ravel() for one in np.meshgrid(near[1], near[0], indexing="ij"))
    middle = np.column_stack([(cols + 0.5) / per_x, (rows + 0.5) / per_y])
    if not grid.periodic:  # on a torus, two points of a cell may be nearest to different images of a box
        wider = boxes.size_m[k] + [2 * cell_reach, 2 * cell_reach, 0.0]
        may_meet = Boxes(one.base_m, wider[None], one.azimuth_rad).cover(middle)
        rows, cols, middle = rows[may_meet], cols[may_meet], middle[may_meet]
    narrower = boxes.size_m[k] - [2 * cell_reach, 2 * cell_reach, 0.0]
    whole = np.zeros(len(rows), dtype=np.bool_)
    if narrower.min() > 0 and not grid.periodic:
        whole = Boxes(one.base_m, narrower[None], one.azimuth_rad).cover(middle)
    taken[rows[whole], cols[whole]] += 1.0
    rows, cols = rows[~whole], cols[~whole]
    point = (np.arange(_PER_SIDE) + 0.5) / _PER_SIDE
    for begin in range(0, len(rows), _CELLS_AT_ONCE):
        row, col = rows[begin : begin + _CELLS_AT_ONCE], cols[begin : begin + _CELLS_AT_ONCE]
        x, y = np.broadcast_arrays(
            (col[:, None, None] + point[None, None, :]) / per_x, (row[:, None, None] + point[None, :, None]) / per_y
        )
        inside = one.cover(np.column_stack([x.ravel(), y.ravel()]), period_m)
        taken[row, col] += np.count_nonzero(inside.reshape(len(row), -1), axis=1) / _PER_SIDE**2


def shade(
    position_m: NDArray[np.floating],
    height_m: NDArray[np.floating],
    radius_m: NDArray[np.floating],
    depth: NDArray[np.floating],
    grid: ShadowGrid,
    boxes: Boxes = NO_BOXES,
) -> Shade:
    """The light that reaches each module.

    `position_m`, (M, 2) or (M, 3), are the centres of the modules' spheres, world x and y; beyond the site they count
    at its edge, or around the torus. `height_m` (M,) are their heights above the local ground, below which they count
    in the lowest layer. `depth` (M,) is the optical depth of each module over its sphere's disc: -ln(1 - opacity) x the
    share that is grown. Boxes stand on the local ground. More than 2000 layers are a ResourceError.
    """
    position, height = np.array(position_m[:, :2], dtype=np.float64), np.ascontiguousarray(height_m, dtype=np.float64)
    radius = np.maximum(np.ascontiguousarray(radius_m, dtype=np.float64), 1e-6)
    opaque = np.ascontiguousarray(depth, dtype=np.float64)
    (nx, ny), (per_x, per_y) = grid.cells, grid.per_m
    if grid.periodic:
        position %= grid.size_m
    else:
        np.clip(position, 0.0, np.array(grid.size_m) * (1 - 1e-12), out=position)
    box_layers = np.ceil(boxes.size_m[:, 2] / grid.layer_m - 1e-9).astype(np.int64)  # (B,)
    top = max(int(max(height.max(initial=0.0), 0.0) // grid.layer_m) + 1, int(box_layers.max(initial=0)))
    if top > _MOST_LAYERS:
        problem = "the trees are too tall for layers of light so thin"
        expected = f"at most {_MOST_LAYERS:,} layers of {grid.layer_m:g} m"
        got = f"modules {height.max():,.0f} m above the ground"
        raise ResourceError(problem, where="community.cell_m", expected=expected, got=got, hint="make cell_m larger")
    open_shares = _open_shares(boxes, box_layers, grid, top)
    layer = np.clip(np.floor(height / grid.layer_m), 0, top - 1).astype(np.int16)
    order = np.argsort(layer, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(layer, minlength=top))])
    light = np.empty(len(height), dtype=np.float32)
    above, following, share = np.zeros((ny, nx)), np.empty((ny, nx)), np.ones((ny, nx))
    plane, nothing = np.zeros((ny, nx), dtype=np.int64), np.zeros((ny, nx), dtype=np.int64)
    for k in range(top - 1, -1, -1):
        rows = order[start[k] : start[k + 1]]
        if len(boxes):
            np.minimum(share, next(open_shares), out=share)
        plane[:] = 0
        _deposit(rows, position, radius, opaque, per_x, per_y, grid.periodic, plane)
        _read(rows, position, radius, opaque, per_x, per_y, grid.periodic, plane, above, share, light)
        if k:
            _spread(above, plane, grid.spread, grid.periodic, following)
            above, following = following, above
            if len(boxes):
                share_below = np.empty((ny, nx))
                _spread(share, nothing, grid.spread, grid.periodic, share_below)
                share = share_below
    return Shade(light, grid, above + 0.5 * plane / UNITS, share)
