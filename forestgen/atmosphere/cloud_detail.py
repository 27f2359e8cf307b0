"""What clouds are like inside a cell of their grid: a sharp edge, folded into billows; read place by place.

The extinction is that of the cloud's inside, trilinear between the cells' centres as without detail, times the share
of `share_inside`: 1 in the cloud, 0 out of it, with a ramp of `EDGE_M` between. Where a cell holds an edge, a brick has
the depth below the edge at 9 x 9 x 9 nodes, metres, negative outside. Billows smaller than the nodes' distance are
added when a place is looked up: octaves of one tile of noise that repeats in all directions, which costs no memory. The
edge of an underside is smooth: billows grow upwards and sideways. `forestgen.atmosphere.billows` makes the numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import inlined_exactly

SUB = 8  # parts of a cell along its side
FULL, EMPTY = -1, -2  # instead of a brick's number
TILE = 64  # values along the side of the tile
EDGE_M = 3.0  # width of the ramp
_LEAST_BILLOW = 0.15  # of undersides


class Detail(NamedTuple):
    """Tables of a field's detail; without layers: no detail. The kernels read them."""

    brick: NDArray[np.int32]  # (Z, Y, X) number of each cell's brick, or FULL or EMPTY
    depth: NDArray[np.int16]  # (B, 9, 9, 9) at the nodes, z, y, x, in units
    tile: NDArray[np.float32]  # (TILE, TILE, TILE) billows: between -1 and 1, mean 0
    octave: NDArray[np.float64]  # (K, 7) of each: tile cells a grid cell along x, y, z; shift along each; metres
    unit: NDArray[np.float64]  # (3,) metres: of a unit of depth; a part's height; depth from which on all is inside


NO_DETAIL = Detail(
    np.zeros((0, 0, 0), np.int32), np.zeros((0, SUB + 1, SUB + 1, SUB + 1), np.int16),
    np.zeros((0, 0, 0), np.float32), np.zeros((0, 7)), np.ones(3),
)  # fmt: skip


@inlined_exactly
def tile_value(tile, x, y, z):  # type: ignore[no-untyped-def]
    """The tile's noise, trilinear, at a place in its cells."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    i0, j0, k0 = i & (TILE - 1), j & (TILE - 1), k & (TILE - 1)
    i1, j1, k1 = (i + 1) & (TILE - 1), (j + 1) & (TILE - 1), (k + 1) & (TILE - 1)
    below = (tile[k0, j0, i0] * (1.0 - u) + tile[k0, j0, i1] * u) * (1.0 - v)
    below += (tile[k0, j1, i0] * (1.0 - u) + tile[k0, j1, i1] * u) * v
    above = (tile[k1, j0, i0] * (1.0 - u) + tile[k1, j0, i1] * u) * (1.0 - v)
    above += (tile[k1, j1, i0] * (1.0 - u) + tile[k1, j1, i1] * u) * v
    return below * (1.0 - w) + above * w


@inlined_exactly
def share_inside(detail, x, y, z):  # type: ignore[no-untyped-def]
    """The share of the inside's extinction at a place, in grid cells from the first one's centre."""
    layers, rows, columns = detail.brick.shape
    if layers == 0:
        return 1.0
    i = min(max(int(np.floor(x + 0.5)), 0), columns - 1)
    j = min(max(int(np.floor(y + 0.5)), 0), rows - 1)
    k = min(max(int(np.floor(z + 0.5)), 0), layers - 1)
    number = detail.brick[k, j, i]
    if number < 0:
        return 1.0 if number == FULL else 0.0
    u, v, w = (x + 0.5 - i) * SUB, (y + 0.5 - j) * SUB, (z + 0.5 - k) * SUB
    a, b, c = min(max(int(u), 0), SUB - 1), min(max(int(v), 0), SUB - 1), min(max(int(w), 0), SUB - 1)
    u, v, w = u - a, v - b, w - c
    near = detail.depth[number]
    below = (near[c, b, a] * (1.0 - u) + near[c, b, a + 1] * u) * (1.0 - v)
    below += (near[c, b + 1, a] * (1.0 - u) + near[c, b + 1, a + 1] * u) * v
    above = (near[c + 1, b, a] * (1.0 - u) + near[c + 1, b, a + 1] * u) * (1.0 - v)
    above += (near[c + 1, b + 1, a] * (1.0 - u) + near[c + 1, b + 1, a + 1] * u) * v
    unit, height, reach = detail.unit[0], detail.unit[1], detail.unit[2]
    depth = (below * (1.0 - w) + above * w) * unit
    if depth >= reach:
        return 1.0
    if depth <= -reach:
        return 0.0
    billow = min(max(1.0 - (above - below) * unit / height, _LEAST_BILLOW), 1.0)
    octave = detail.octave
    for n in range(len(octave)):
        depth += (
            billow
            * octave[n, 6]
            * tile_value(
                detail.tile,
                x * octave[n, 0] + octave[n, 3],
                y * octave[n, 1] + octave[n, 4],
                z * octave[n, 2] + octave[n, 5],
            )
        )
    return min(max(depth * (1.0 / EDGE_M) + 0.5, 0.0), 1.0)
