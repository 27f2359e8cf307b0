"""Noise and cells on a tile that repeats: what bark patterns are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Image = NDArray[np.float32]

_JITTER = 0.85  # a cell's point lies in the middle 85% of its square, so that the 3 x 3 squares around hold the nearest


@dataclass(frozen=True)
class Tile:
    """A grid of texels over one repeat. Rows run up the stem, columns round it; both wrap."""

    rows: int
    columns: int
    size_m: tuple[float, float]  # round the stem, up the stem

    def noise(self, rng: np.random.Generator, scale_m: tuple[float, float], steepness: float = 3.0) -> Image:
        """(rows, columns) Gaussian noise of mean 0 and deviation 1.

        Parameters
        ----------
        scale_m : size of its largest features round and up the stem, metres.
        steepness : power of the amplitude's fall with frequency beyond that size; 1 is rough, 3 is smooth.
        """
        import scipy.fft

        white = rng.standard_normal((self.rows, self.columns), dtype=np.float32)
        u = (scipy.fft.rfftfreq(self.columns, self.size_m[0] / self.columns) * scale_m[0]).astype(np.float32)
        v = (scipy.fft.fftfreq(self.rows, self.size_m[1] / self.rows) * scale_m[1]).astype(np.float32)
        gain = (1.0 + (u * u)[None, :] + (v * v)[:, None]) ** np.float32(-0.5 * steepness)
        gain[0, 0] = 0.0
        field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=white.shape)
        deviation = np.sqrt(np.vdot(field, field) / field.size)
        return np.asarray(field / max(deviation, np.float32(1e-30)), dtype=np.float32)

    def places_m(self) -> tuple[Image, Image]:
        """Places of the texels' centres round (1, columns) and up (rows, 1) the stem, metres."""
        u = (np.arange(self.columns, dtype=np.float32) + 0.5) * (self.size_m[0] / self.columns)
        v = (np.arange(self.rows, dtype=np.float32) + 0.5) * (self.size_m[1] / self.rows)
        return u[None, :], v[:, None]

    def cells(
        self, rng: np.random.Generator, scale_m: tuple[float, float], warp_m: tuple[Image, Image] | None = None
    ) -> Cells:
        """Voronoi cells of about `scale_m`, whose places are moved by `warp_m` before the cells are looked up."""
        across = max(1, round(self.size_m[0] / scale_m[0]))
        along = max(1, round(self.size_m[1] / scale_m[1]))
        points = 0.5 + _JITTER * (rng.random((along, across, 2)) - 0.5)
        pitch = (self.size_m[0] / across, self.size_m[1] / along)
        u, v = self.places_m()
        if warp_m is not None:
            u, v = u + warp_m[0], v + warp_m[1]
        shape = (self.rows, self.columns)
        u, v = (np.ascontiguousarray(np.broadcast_to(x / p, shape)) for x, p in zip((u, v), pitch, strict=True))
        border, offset_u, offset_v, index = _nearest(u, v, points.astype(np.float32), np.array(pitch, np.float32))
        return Cells(border, offset_u, offset_v, index, along * across)


@dataclass(frozen=True)
class Cells:
    """Voronoi cells seen from every texel; arrays are (rows, columns)."""

    border_m: Image  # distance to the nearest edge between cells, metres
    offset_u: Image  # from the cell's point to the texel, in cells
    offset_v: Image
    index: NDArray[np.int32]  # which cell
    count: int

    def values(self, rng: np.random.Generator) -> Image:
        """A random number in [0, 1) for each cell, at each texel."""
        return np.asarray(rng.random(self.count, dtype=np.float32)[self.index], dtype=np.float32)


@compiled
def _edges(points, pitch):  # type: ignore[no-untyped-def]
    """(along, across, 24, 3): unit normal, and offset from the cell's own point in metres, of the bisectors about it.

    A place p (in cells from the cell's point) is ``offset - normal . p`` metres from the edge; the normal is that of
    cell space, divided so that the result is metres along the metric normal.
    """
    along, across = points.shape[:2]
    edges = np.empty((along, across, 24, 3), np.float32)
    for j in range(along):
        for i in range(across):
            place = 0
            for k in range(25):
                step_i, step_j = k % 5 - 2, k // 5 - 2
                if k == 12:
                    continue
                other = points[(j + step_j) % along, (i + step_i) % across]
                dx = step_i + other[0] - points[j, i, 0]
                dy = step_j + other[1] - points[j, i, 1]
                steepness = max(np.sqrt((dx / pitch[0]) ** 2 + (dy / pitch[1]) ** 2), 1e-9)
                edges[j, i, place, 0], edges[j, i, place, 1] = dx / steepness, dy / steepness
                edges[j, i, place, 2] = 0.5 * (dx * dx + dy * dy) / steepness
                place += 1
    return edges


@compiled
def _nearest(u, v, points, pitch):  # type: ignore[no-untyped-def]
    """Distance to the cell's edge (metres), offset from its point (cells) and index, for places in units of cells.

    Nearness counts in units of cells, so that cells are as long as their pitch; the distance to an edge is that to the
    bisector of two points, turned into metres along its normal.
    """
    rows, columns = u.shape
    along, across = points.shape[:2]
    edges = _edges(points, pitch)
    border, index = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.int32)
    offset_u, offset_v = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    for row in range(rows):
        for column in range(columns):
            x, y = u[row, column], v[row, column]
            cell_x, cell_y = int(np.floor(x)), int(np.floor(y))
            best, best_i, best_j = np.float32(1e9), 0, 0
            best_x, best_y = np.float32(0.0), np.float32(0.0)
            for j in range(cell_y - 1, cell_y + 2):
                wrapped_j = j % along
                for i in range(cell_x - 1, cell_x + 2):
                    wrapped_i = i % across
                    dx = x - (np.float32(i) + points[wrapped_j, wrapped_i, 0])
                    dy = y - (np.float32(j) + points[wrapped_j, wrapped_i, 1])
                    squared = dx * dx + dy * dy
                    if squared < best:
                        best, best_i, best_j, best_x, best_y = squared, wrapped_i, wrapped_j, dx, dy
            own = edges[best_j, best_i]
            edge = np.float32(1e9)
            for k in range(24):
                edge = min(edge, own[k, 2] - own[k, 0] * best_x - own[k, 1] * best_y)
            border[row, column] = max(edge, np.float32(0.0))
            offset_u[row, column], offset_v[row, column] = best_x, best_y
            index[row, column] = best_j * across + best_i
    return border, offset_u, offset_v, index


def step(field: Image, low: float, high: float) -> Image:
    """0 below `low`, 1 above `high`, a smooth rise between; falls if `high` is the smaller."""
    t = np.clip((field - np.float32(low)) / np.float32(high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), dtype=np.float32)


def upper_share(field: Image, share: float, softness: float = 0.1) -> Image:
    """About 1 on the `share` of texels where the field is largest, 0 elsewhere; `softness` in units of the field."""
    if share <= 0:
        return np.zeros_like(field)
    edge = float(np.quantile(field[::2, ::2], 1.0 - min(share, 1.0)))
    return step(field, edge - softness, edge + softness)
