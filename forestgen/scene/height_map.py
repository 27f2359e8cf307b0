"""The ground of a map of heights: cubic between its cells' middles, going over into a plain beyond the site."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.terrain import HeightField, smooth_step

_PAD = 2  # cells around the map


@dataclass(frozen=True, eq=False)
class MappedHeight(HeightField):
    """Height of the ground by a map.

    On the site it is a cubic convolution of the cells' values (Keys 1981): it goes through every one of them at the
    cell's middle, its slope has no jumps, and a plane stays a plane. Beyond, the edge's height goes on outward and
    over into the edge's mean within the site's longer side.
    """

    cells_m: NDArray[np.float64]  # (rows + 4, cols + 4) heights, row 0 in the south; two more cells on every side
    plain_m: float  # height far away

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        width, depth = self.size_m
        rows, cols = (side - 2 * _PAD for side in self.cells_m.shape)
        col, along_x = _cell(np.clip(x_m, 0.0, width) / width * cols, cols)
        row, along_y = _cell(np.clip(y_m, 0.0, depth) / depth * rows, rows)
        z = np.zeros(x_m.shape)
        weights_x, weights_y = _weights(along_x), _weights(along_y)
        for j in range(4):
            line = np.zeros(x_m.shape)
            for i in range(4):
                line += weights_x[i] * self.cells_m[row + j, col + i]
            z += weights_y[j] * line
        away = self.distance_m(x_m, y_m)
        return np.asarray(z + (self.plain_m - z) * smooth_step(away / max(self.size_m)))


def mapped(size_m: tuple[float, float], heights_m: NDArray[np.float64]) -> MappedHeight:
    """The ground of (rows, cols) heights in metres, at least 2 each way, row 0 in the north, over the whole site."""
    south_first = np.asarray(heights_m, dtype=np.float64)[::-1]
    padded = np.pad(south_first, _PAD, mode="reflect", reflect_type="odd") if min(south_first.shape) > _PAD else None
    if padded is None:  # two cells have no second neighbour to reflect
        padded = south_first
        for _ in range(_PAD):
            padded = np.pad(padded, 1, mode="reflect", reflect_type="odd")
    none = np.zeros(0)
    field = MappedHeight(size_m, np.zeros((0, 2)), none, none, np.zeros(0, dtype=bool), padded, 0.0)
    x, y = (np.linspace(0.0, side, 101) for side in size_m)
    edge = np.concatenate([field(x, 0 * x), field(x, 0 * x + size_m[1]), field(0 * y, y), field(0 * y + size_m[0], y)])
    return MappedHeight(size_m, np.zeros((0, 2)), none, none, np.zeros(0, dtype=bool), padded, float(edge.mean()))


def _cell(at: NDArray[np.float64], cells: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """First of the four padded cells around a place given in cells from the edge, and the share of the way between."""
    middle = at - 0.5 + _PAD
    before = np.clip(np.floor(middle), 1, cells + 1)
    return before.astype(np.int64) - 1, middle - before


def _weights(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Of the four cells around a place, `t` of the way from the second to the third (Keys 1981, a = -1/2)."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
