"""The ground's height on a raster of nodes, values carried over to the cells of any grid, and moisture.

Moisture is the topographic wetness index ln(a / tan β) (Beven and Kirkby 1979; a, the area upslope by width of contour,
metres; tan β, the gradient) in a form that is also right on a crest and on level ground::

    W = (a + a0) / (tan β + t0)        a0 = 20 m, t0 = 0.1
    moisture = W / (W + W0)            W0 = a0 / t0, W on a plain

- 0.5: as wet as level ground that drinks its own rain alone. 0.8: four times the plain's W. Towards 1: hollows and
  valley floors. Towards 0: steep ground below nothing, as on crests and spurs.
- Water runs by the D∞ method (Tarboton 1997): downhill along the steepest of eight triangular facets, shared between
  the two neighbours that its direction lies between. A node with no lower neighbour is a pit, and keeps its water,
  unless there is lower ground within five nodes: gaps of the raster in a narrow valley are no pits.
- Water moves slowly, and most is drunk on its way (Barling et al. 1994). By Darcy's law it moves in proportion to the
  gradient, so the share that arrives after a way s is exp(-s / (ℓ tan β)), ℓ = 1000 m.
- a and tan β (its root mean square) are smoothed by a Gaussian with σ = 5 m, which roots and soil even out in nature;
  so moisture hardly depends on the raster's cells.
- Water that crosses a raster at an angle ϑ to its rows or columns is counted by cells that are narrower than their
  side, by cos ϑ + sin ϑ ϑ/(π/4): on a plane a is the way to the divide, in any direction.

References
----------
K. Beven and M. Kirkby, A physically based, variable contributing area model of basin hydrology, Hydrological Sciences
Bulletin 24 (1979). D. Tarboton, A new method for the determination of flow directions and upslope areas in grid digital
elevation models, Water Resources Research 33 (1997), Table 1 and equations 1 to 4. R. Barling, I. Moore and R. Grayson,
A quasi-dynamic wetness index, Water Resources Research 30 (1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, exp, pi, sin

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import GroundHeight, Site
from forestgen.core.compiled import compiled

Floats = NDArray[np.float64]

MARGIN_M = 200.0  # of ground around the site whose water and whose crests count at full detail
FAR_M = 1000.0  # crests up to here count
UPSLOPE_M = 20.0  # a0
GRADIENT = 0.1  # t0
WAY_M = 1000.0  # ℓ: how far most water gets at a gradient of 1
SMOOTHED_M = 5.0  # standard deviation
_BREACH = 5  # nodes
# Facets: cardinal and diagonal neighbour as (row, column) steps.
_CARDINAL = np.array([(0, 1), (1, 0), (1, 0), (0, -1), (0, -1), (-1, 0), (-1, 0), (0, 1)], dtype=np.int64)
_DIAGONAL = np.array([(1, 1), (1, 1), (1, -1), (1, -1), (-1, -1), (-1, -1), (-1, 1), (-1, 1)], dtype=np.int64)
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
        (row, v), (col, u) = place_among(self.y_m, y_m), place_among(self.x_m, x_m)
        rows = values[row] * (1 - v[:, None]) + values[row + 1] * v[:, None]
        return np.asarray(rows[:, col] * (1 - u) + rows[:, col + 1] * u)


def place_among(nodes_m: Floats, at_m: Floats) -> tuple[NDArray[np.int64], Floats]:
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


@dataclass(frozen=True)
class Flow:
    """Water by D∞: where what falls on each node of a raster goes. Nodes are numbered row by row."""

    area_m2: NDArray[np.float64]  # (nodes,) drained by a node, its own cell included, less what was lost on the way
    contour_m: NDArray[np.float64]  # (nodes,) width of contour that the water of a node crosses
    receiver: NDArray[np.int64]  # (nodes, 2) nodes downhill; -1: none
    share: NDArray[np.float64]  # (nodes, 2) of the node's water; both 0: it stays, or leaves the raster
    lost_m2: float  # what was drunk on the way


def moisture(relief: Relief) -> NDArray[np.float64]:
    """(rows, cols) moisture at the nodes, above 0 and below 1."""
    from scipy.ndimage import gaussian_filter

    along_x, along_y = relief.slopes
    sigma = SMOOTHED_M / relief.cell_m
    gradient = np.sqrt(gaussian_filter(along_x**2 + along_y**2, sigma, mode="nearest"))
    flow = route(relief, gradient)
    upslope_m = (flow.area_m2 - relief.cell_m**2) / flow.contour_m
    upslope_m = gaussian_filter(upslope_m.reshape(relief.z_m.shape), sigma, mode="nearest")
    wetness = (1 + np.maximum(upslope_m, 0.0) / UPSLOPE_M) / (1 + gradient / GRADIENT)
    return np.asarray(wetness / (1 + wetness))


def route(relief: Relief, gradient: NDArray[np.float64] | None = None) -> Flow:
    """Let it rain on every node, and the water run; on its way it is drunk by the `gradient` (None: it is not)."""
    z = np.ascontiguousarray(relief.z_m)
    downhill_first = np.argsort(-z, axis=None, kind="stable")
    n = z.size
    receiver, share = np.full((n, 2), -1, dtype=np.int64), np.zeros((n, 2))
    contour_m = np.full(n, relief.cell_m)
    area_m2 = np.full(n, relief.cell_m**2)
    kept = np.full(z.shape, np.inf) if gradient is None else WAY_M * gradient
    _directions(z, relief.cell_m, _CARDINAL, _DIAGONAL, receiver, share, contour_m)
    lost_m2 = _run(downhill_first, receiver, share, contour_m, kept.ravel(), relief.cell_m, area_m2)
    return Flow(area_m2, contour_m, receiver, share, lost_m2)


@compiled
def _directions(z, cell_m, cardinal, diagonal, receiver, share, contour_m):  # type: ignore[no-untyped-def]
    rows, cols = z.shape
    for i in range(1, rows - 1):
        for j in range(1, cols - 1):
            steepest, chosen, angle = 0.0, -1, 0.0
            for f in range(8):
                e1 = z[i + cardinal[f, 0], j + cardinal[f, 1]]
                e2 = z[i + diagonal[f, 0], j + diagonal[f, 1]]
                s1, s2 = z[i, j] - e1, e1 - e2
                if s2 < 0.0:  # steepest along the facet's side
                    r, s = 0.0, s1
                elif s2 > s1:  # or along its diagonal
                    r, s = pi / 4, (s1 + s2) / 2**0.5
                else:
                    r, s = 0.5, (s1 * s1 + s2 * s2) ** 0.5
                if s > steepest:
                    steepest, chosen = s, f
                    angle = atan2(s2, s1) if r == 0.5 else r
            node = i * cols + j
            if chosen >= 0:
                along = angle / (pi / 4)
                receiver[node, 0] = node + cardinal[chosen, 0] * cols + cardinal[chosen, 1]
                receiver[node, 1] = node + diagonal[chosen, 0] * cols + diagonal[chosen, 1]
                share[node, 0], share[node, 1] = 1.0 - along, along
                contour_m[node] = cell_m / (cos(angle) + along * sin(angle))
            else:
                _breach(z, i, j, receiver, share)


@compiled
def _breach(z, i, j, receiver, share):  # type: ignore[no-untyped-def]
    """All water of a node without a lower neighbour goes to the nearest lower node, the lowest of those alike."""
    rows, cols = z.shape
    nearest = 2 * _BREACH * _BREACH + 1
    lowest = z[i, j]
    for k in range(max(0, i - _BREACH), min(rows, i + _BREACH + 1)):
        for m in range(max(0, j - _BREACH), min(cols, j + _BREACH + 1)):
            away = (k - i) ** 2 + (m - j) ** 2
            if z[k, m] < z[i, j] and (away < nearest or (away == nearest and z[k, m] < lowest)):
                nearest, lowest = away, z[k, m]
                receiver[i * cols + j, 0] = k * cols + m
                share[i * cols + j, 0] = 1.0


@compiled
def _run(downhill_first, receiver, share, contour_m, way_m, cell_m, area_m2):  # type: ignore[no-untyped-def]
    lost_m2 = 0.0
    for node in downhill_first:
        for side in range(2):
            if share[node, side] > 0.0:
                step_m = cell_m * cell_m / contour_m[node]
                arriving = exp(-step_m / way_m[node]) if way_m[node] > 0.0 else 0.0
                water = share[node, side] * area_m2[node]
                area_m2[receiver[node, side]] += arriving * water
                lost_m2 += (1.0 - arriving) * water
    return lost_m2
