"""The ground's height on a raster of nodes, and values at nodes carried over to the cells of any grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import GroundHeight, Site

Floats = NDArray[np.float64]

MARGIN_M = 200.0  # of ground around the site whose water and whose crests count at full detail
FAR_M = 1000.0  # crests up to here count
_NODES = 480  # across the site and its margin, unless their distance would exceed the coarsest
_COARSEST_M = 4.0
_FAR_CELL_M = MARGIN_M / 8  # no coarser than the steps of a view at that distance


@dataclass(frozen=True)
class Nodes:
    """Where evenly spaced nodes stand."""

    x_m: Floats  # (cols,) world, ascending
    y_m: Floats  # (rows,) world, ascending

    def between(self, values: Floats, x_m: Floats, y_m: Floats) -> Floats:
        """(len(y_m), len(x_m)) values, (rows, cols) at the nodes, at other places: linear in x and in y."""
        row, v = self.rows(y_m)
        col, u = self.columns(x_m)
        rows = values[row] * (1 - v[:, None]) + values[row + 1] * v[:, None]
        return np.asarray(rows[:, col] * (1 - u) + rows[:, col + 1] * u)

    def rows(self, y_m: Floats) -> tuple[NDArray[np.int64], Floats]:
        """The row before each y, and the share of the way to the next."""
        return _place(self.y_m, y_m)

    def columns(self, x_m: Floats) -> tuple[NDArray[np.int64], Floats]:
        """The column before each x, and the share of the way to the next."""
        return _place(self.x_m, x_m)


def _place(nodes_m: Floats, at_m: Floats) -> tuple[NDArray[np.int64], Floats]:
    """The node before each place, and the share of the way to the next."""
    place = (at_m - nodes_m[0]) / (nodes_m[1] - nodes_m[0])
    index = np.clip(place.astype(np.int64), 0, len(nodes_m) - 2)
    return index, np.clip(place - index, 0.0, 1.0)


@dataclass(frozen=True)
class Relief:
    """Heights at the nodes of a square raster."""

    nodes: Nodes
    cell_m: float  # between nodes, in x and in y
    z_m: Floats  # (rows, cols)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats]:
        """dz/dx and dz/dy, (rows, cols) each: centred differences between the neighbouring nodes."""
        along_y, along_x = np.gradient(self.z_m, self.cell_m)
        return np.asarray(along_x), np.asarray(along_y)

    def over(self, site: Site) -> tuple[slice, slice]:
        """Rows and columns of the nodes that values between nodes depend on anywhere on the site."""
        x, y = (
            slice(int(np.searchsorted(at, 0.0, "right")) - 1, int(np.searchsorted(at, side, "left")) + 1)
            for at, side in zip((self.nodes.x_m, self.nodes.y_m), site.size_m, strict=True)
        )
        return y, x


def near_relief(height: GroundHeight, site: Site) -> Relief:
    """The ground of the site and `MARGIN_M` around it; the middle node lies in the site's middle."""
    span_m = max(site.size_m) + 2 * MARGIN_M
    return _relief(height, site, MARGIN_M, min(span_m / _NODES, _COARSEST_M))


def far_relief(height: GroundHeight, site: Site) -> Relief:
    """The ground up to `FAR_M` from the site, coarse."""
    return _relief(height, site, FAR_M, _FAR_CELL_M)


def _relief(height: GroundHeight, site: Site, margin_m: float, cell_m: float) -> Relief:
    half = [int(np.ceil((side / 2 + margin_m) / cell_m)) + 1 for side in site.size_m]
    xs, ys = (
        np.asarray(side / 2 + cell_m * np.arange(-n, n + 1), dtype=np.float64)
        for side, n in zip(site.size_m, half, strict=True)
    )
    z = np.broadcast_to(height(*np.meshgrid(xs, ys)), (len(ys), len(xs)))
    if not np.isfinite(z).all():
        row, col = np.argwhere(~np.isfinite(z))[0]
        raise ValueError(f"the ground's height must be finite; at x {xs[col]:g}, y {ys[row]:g} it is {z[row, col]}")
    return Relief(Nodes(xs, ys), cell_m, np.ascontiguousarray(z, dtype=np.float64))
