"""Patterns of bark: relief and tone of one tile that repeats, made of noise and cells.

Each pattern is a function of the tile, a stream of random numbers, the size of its features and the share of its marks
(lenticels, fissures, checks). It returns a `Relief`. Sizes beside the pattern's `scale_m` are shares of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled

Image = NDArray[np.float32]
Rng = np.random.Generator

_JITTER = 0.85  # a cell's point lies in the middle 85% of its square, so that the 3 x 3 squares around hold the nearest


@dataclass(frozen=True)
class Tile:
    """A grid of texels over one repeat. Rows run up the stem, columns round it; both wrap."""

    rows: int
    columns: int
    size_m: tuple[float, float]  # round the stem, up the stem

    def noise(self, rng: np.random.Generator, scale_m: tuple[float, float], steepness: float = 3.0) -> Image:
        """(rows, columns) Gaussian noise of mean 0 and deviation 1.

        `scale_m`: size of its largest features round and up the stem, metres. `steepness`: power of the amplitude's
        fall with frequency beyond that size; 1 is rough, 3 is smooth.
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


@dataclass(frozen=True)
class Relief:
    """Arrays are (rows, columns)."""

    height: Image  # 0 at the bottom of the deepest crack, 1 at the top
    tone: Image  # 0: the dark colour, 1: the light one
    marks: Image | None = None  # 1 where the marks' own colour covers the rest


@dataclass(frozen=True)
class Pattern:
    """A pattern and what it is by default."""

    make: Callable[[Tile, Rng, float, float], Relief]
    scale_m: float  # width of a ridge, a plate, a scale, a ring or a mark
    depth_m: float
    marks: float  # share of the surface


def furrowed(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Long ridges that part and meet again, broken by cracks across, with dark furrows between (oak, old poplar)."""
    s = scale_m
    lean = (0.24 * s * tile.noise(rng, (4 * s, 9 * s)), 0.5 * s * tile.noise(rng, (4 * s, 9 * s)))
    rough = 0.035 * s * tile.noise(rng, (0.5 * s, 0.9 * s), 2.0)
    cells = tile.cells(rng, (s, 7.0 * s), (lean[0] + rough, lean[1]))
    ridge = np.asarray(1.0 - np.exp(-((cells.border_m / (0.24 * s)) ** 1.6)), dtype=np.float32)
    blocks = tile.cells(rng, (0.9 * s, 1.7 * s), (0.7 * lean[0], lean[1] + 3.0 * rough))
    across = step(blocks.border_m, 0.01 * s, 0.10 * s)
    grain = tile.noise(rng, (0.18 * s, 0.9 * s), 1.8)
    fine = tile.noise(rng, (0.10 * s, 0.12 * s), 1.5)
    height = ridge * (0.80 + 0.20 * across) + 0.05 * grain + 0.02 * fine
    age = cells.values(rng) - 0.5
    patina = tile.noise(rng, (4 * s, 6 * s))
    tone = 0.92 * ridge**1.3 * (0.72 + 0.28 * across) + 0.09 * grain * ridge + 0.05 * fine + 0.16 * age * ridge
    return Relief(height, tone + 0.07 * patina * ridge)


def plated(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Long uneven plates of thin scales on each other, between furrows with ragged edges; their flanks and fresh scales
    are `marks` (pine).

    Furrows along the stem part and meet; they are shallow and dark, with red edges. Cracks across fade out where a
    noise is low, so that plates differ in length and many cracks end within a plate. Warps move places by less than
    they stretch: none folds into a curl.
    """
    s = scale_m
    sway = (0.14 * s * tile.noise(rng, (2.5 * s, 5 * s)), 0.25 * s * tile.noise(rng, (2.5 * s, 4 * s)))
    fray = 0.025 * s * tile.noise(rng, (0.4 * s, 0.6 * s), 2.3)
    uneven = tile.noise(rng, (0.9 * s, 2 * s))
    plates = tile.cells(rng, (s, 3.6 * s), (sway[0] + fray, sway[1] + fray))
    blocks = tile.cells(rng, (1.4 * s, 2.2 * s), (sway[0] + 2 * fray, sway[1] + 2 * fray))
    ragged = np.exp(0.35 * uneven + 0.22 * tile.noise(rng, (0.15 * s, 0.4 * s), 1.8))
    furrow = np.clip(plates.border_m / (0.27 * s * ragged), 0.0, 1.0)
    fading = step(uneven, -1.2, 0.6)
    crack = 1.0 - fading * (1.0 - np.clip(blocks.border_m / (0.11 * s * ragged), 0.0, 1.0))
    deep = 0.68 + 0.32 * step(uneven + tile.noise(rng, (0.5 * s, 1.5 * s)), -1.0, 0.8)
    between = np.asarray(np.minimum(furrow, 0.25 + 0.75 * crack), dtype=np.float32)
    wall = np.asarray(1.0 - deep * (1.0 - step(between, 0.0, 1.0)), dtype=np.float32)
    scales, fresh, rim = _scales(tile, rng, s, 1.5, (sway[0] + 2 * fray, sway[1] + 2 * fray), (0.6, 0.4, 0.25))
    lean = blocks.values(rng) - 0.5, plates.values(rng) - 0.5
    tilt = 0.10 * (lean[0] * blocks.offset_u - blocks.offset_v * (0.35 + lean[1]))
    grain = tile.noise(rng, (0.06 * s, 0.35 * s), 1.6)
    fine = tile.noise(rng, (0.05 * s, 0.05 * s), 1.2)
    height = wall * (0.62 + 0.22 * scales + 0.08 * rim + tilt) + 0.015 * grain + 0.012 * fine
    tone = 0.38 + 0.30 * scales + 0.24 * rim + 0.34 * lean[0] + 0.28 * lean[1] + 0.09 * grain + 0.10 * fine
    red = np.maximum(marks * fresh, 0.7 * step(wall, 0.98, 0.7)) * step(wall, 0.2, 0.5)
    return Relief(height, wall * (0.25 + 0.75 * wall) * tone, red)


def _scales(
    tile: Tile, rng: Rng, s: float, tall: float, warp_m: tuple[Image, Image], sizes: tuple[float, ...] = (0.7, 0.45)
) -> tuple[Image, Image, Image]:
    """Scales of some sizes on each other: how high the uppermost is, 0 to 1, if fresh, and its loose lower rim."""
    high, fresh, rim = (np.zeros((tile.rows, tile.columns), np.float32) for _ in range(3))
    for layer, size in enumerate(sizes):
        scale = tile.cells(rng, (size * s, tall * size * s), warp_m)
        draw = scale.values(rng)
        on = step(scale.border_m, 0.0, 0.02 * s) * (draw < np.float32(0.55))
        high += on * (np.float32((layer + 1) / len(sizes)) + 0.3 * (draw - 0.2) - high)
        fresh += on * ((draw < np.float32(0.15)).astype(np.float32) - fresh)
        rim += on * (step(scale.border_m, 0.05 * s, 0.015 * s) * step(scale.offset_v, 0.1, -0.4) - rim)
    return high, fresh, rim


def scaly(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Small rounded scales on each other that come loose at their lower edge; fresh ones are `marks` (spruce)."""
    s = scale_m
    warp = [0.10 * s * tile.noise(rng, (1.6 * s, 1.6 * s), 2.6) for _ in range(2)]
    below = tile.cells(rng, (1.1 * s, 1.4 * s), (warp[0], warp[1]))
    high, fresh, rim = _scales(tile, rng, 1.6 * s, 1.15, (warp[0], warp[1]))
    gap = step(below.border_m, 0.0, 0.12 * s)
    fine = tile.noise(rng, (0.16 * s, 0.2 * s), 1.5)
    old = tile.noise(rng, (5 * s, 8 * s))
    ground = (high <= 0.0) * (0.25 + 0.75 * gap)
    height = 0.25 * ground + high * (0.75 + 0.2 * rim) + 0.03 * fine
    tone = (0.30 + 0.25 * below.values(rng)) * ground + (high > 0.0) * (0.32 + 0.45 * high + 0.22 * rim)
    return Relief(height, tone + 0.05 * fine + 0.07 * old, marks * fresh)


def smooth(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Smooth bark in wrinkles and folds across, with pale crusts, dark streaks where water runs and scars of branches,
    and dark lozenges where it breathes (beech, young poplar)."""
    s = scale_m
    blotch = tile.noise(rng, (12 * s, 9 * s), 1.8)
    crust = upper_share(tile.noise(rng, (5 * s, 4 * s), 1.6) + 0.9 * blotch, 0.3, 0.35)
    folds = tile.noise(rng, (7 * s, 1.1 * s), 2.4)
    lines = tile.noise(rng, (3.0 * s, 0.25 * s), 2.0)
    fine = tile.noise(rng, (0.3 * s, 0.3 * s), 1.3)
    damp = upper_share(tile.noise(rng, (3 * s, 24 * s), 1.9) + 0.5 * blotch, 0.2, 0.6)
    scar = _scars(tile, rng, s, 0.5)
    tone = 0.58 + 0.08 * blotch + 0.26 * crust - 0.26 * damp + 0.03 * folds + 0.05 * lines + 0.05 * fine - 0.45 * scar
    height = 0.75 + 0.06 * folds + 0.02 * lines + 0.01 * fine + 0.03 * crust - 0.2 * scar
    if marks <= 0:
        return Relief(height, tone)
    dark, lip = _lozenges(tile, rng, s, marks)
    return Relief(height - 0.40 * dark + 0.16 * lip, tone + 0.10 * lip, dark)


def _scars(tile: Tile, rng: Rng, s: float, share: float) -> Image:
    """Where branches were, in a share of places: an eye about 3 `s` wide, below two lines that fall to both sides."""
    pitch = 26 * s, 20 * s
    wave = 0.3 * s * tile.noise(rng, (5 * s, 5 * s))
    spots = tile.cells(rng, pitch, (wave, wave))
    size = (0.5 + 0.9 * spots.values(rng)) * s
    u, v = np.abs(spots.offset_u) * pitch[0] / size, spots.offset_v * pitch[1] / size
    eye = step(np.asarray((u / 1.7) ** 1.3 + np.abs(v) ** 1.3, dtype=np.float32), 1.5, 0.5)
    off = np.asarray(np.abs(v - 1.4 + 0.55 * u) / np.maximum(0.35 - 0.06 * u, 0.01), dtype=np.float32)
    line = step(off, 1.2, 0.6) * (u < 5.5)
    return np.asarray((spots.values(rng) < np.float32(share)) * np.maximum(eye, 0.8 * line), dtype=np.float32)


def _lozenges(tile: Tile, rng: Rng, s: float, marks: float) -> tuple[Image, Image]:
    """Diamond-shaped lenticels about `s` wide, in loose rows across, and the raised lips about them."""
    pitch = s * np.sqrt(0.30 / marks)
    wave = 0.25 * s * tile.noise(rng, (8 * s, 8 * s))
    spots = tile.cells(rng, (1.2 * pitch, 0.9 * pitch), (wave, wave))
    size = (0.35 + 0.75 * spots.values(rng) ** 2) * s
    u, v = np.abs(spots.offset_u) * 1.2 * pitch, np.abs(spots.offset_v) * 0.9 * pitch
    far = (u + 0.85 * v) / (0.5 * size) + 0.07 * tile.noise(rng, (0.3 * s, 0.3 * s), 2.0)
    dark = step(far, 1.05, 0.8)
    slit = step(u / (0.55 * size) + v / (0.10 * size), 1.2, 0.7)
    return np.asarray(dark * (0.72 + 0.28 * slit)), step(far, 1.7, 1.1) * (1.0 - dark)


def papery(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """White bark that peels across the stem, with dark dashes in crowded bands, black scars of branches and, where it
    is old, black rough patches."""
    s = scale_m
    blotch = tile.noise(rng, (5 * s, 3 * s), 1.8)
    bands = tile.noise(rng, (9 * s, 0.16 * s), 1.6)
    fine = tile.noise(rng, (0.5 * s, 0.05 * s), 1.2)
    wave = 0.05 * s * tile.noise(rng, (3 * s, 1.5 * s))
    crowded = np.exp(1.1 * tile.noise(rng, (8 * s, 1.8 * s), 2.2) - 0.6)
    dashes = np.zeros_like(fine)
    for width, pitch_v in ((2.4, 0.55), (1.0, 0.26), (0.4, 0.13)):
        pitch = (1.7 * width * s, pitch_v * s)
        spots = tile.cells(rng, pitch, (wave, wave))
        long = (0.1 + 0.9 * spots.values(rng) ** 2.5) * 0.6 * width * s
        u, v = np.abs(spots.offset_u) * pitch[0] / long, np.abs(spots.offset_v) * pitch[1] / (0.02 * s + 0.035 * long)
        kept = spots.values(rng) < 6.0 * np.float32(marks) * crowded
        dashes = np.maximum(dashes, kept * step(u * u + v * v + 0.25 * fine, 1.1, 0.5))
    rough = tile.noise(rng, (0.35 * s, 0.22 * s), 1.5)
    patch = upper_share(tile.noise(rng, (2.2 * s, 3.2 * s), 2.2) + 0.30 * rough, 0.4 * marks, 0.12)
    scar = step(_scars(tile, rng, 0.35 * s, 0.6) * (1.0 + 0.4 * rough), 0.3, 0.7)
    dark = np.maximum(np.maximum(dashes, patch), scar)
    sheets = tile.cells(rng, (6 * s, 0.8 * s), (3.0 * wave, wave))
    loose = (sheets.values(rng) < np.float32(2.0 * marks)).astype(np.float32)
    curl = loose * step(sheets.border_m, 0.09 * s, 0.03 * s)
    peel = np.maximum(step(bands, 1.1, 1.9), 0.8 * (loose - curl))
    tone = 0.80 + 0.10 * blotch + 0.05 * bands + 0.04 * fine - 0.30 * peel + 0.12 * curl
    height = (
        0.62
        + 0.03 * bands
        + 0.35 * curl
        - 0.06 * peel
        - 0.10 * dashes
        - np.maximum(patch, scar) * (0.30 - 0.16 * rough)
    )
    return Relief(height, tone, dark)


def ringed(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Scars of fallen leaves round the stem, one above the other, and cracks along it (palm)."""
    _, v = tile.places_m()
    rings = max(1, round(tile.size_m[1] / scale_m))
    s = tile.size_m[1] / rings
    wobble = 0.10 * tile.noise(rng, (0.6 * tile.size_m[0], 2 * s)) + 0.03 * tile.noise(rng, (1.2 * s, s), 2.0)
    phase = v / s + wobble
    inside = (phase - np.floor(phase)).astype(np.float32)
    fibre = tile.noise(rng, (0.07 * s, 0.8 * s), 1.8)
    fine = tile.noise(rng, (0.1 * s, 0.1 * s), 1.4)
    groove = step(inside, 0.0, 0.10) * step(inside, 1.0, 0.93)
    cracks = upper_share(tile.noise(rng, (0.22 * s, 1.6 * s), 2.2), marks, 0.12)
    height = groove * (0.62 + 0.30 * (1.0 - inside) ** 2) + 0.03 * fibre - 0.25 * cracks
    shade = rng.random(rings, dtype=np.float32)[np.floor(phase).astype(np.int64) % rings]
    tone = groove * (0.50 + 0.22 * (1.0 - inside) + 0.20 * (shade - 0.5)) + 0.09 * fibre + 0.05 * fine
    return Relief(height, tone * (1.0 - 0.75 * cracks) + 0.06 * tile.noise(rng, (4 * s, 5 * s)))


def fibrous(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """Fibres along the stem and long checks: weathered wood, cedar, stems of herbs."""
    s = scale_m
    sway = 0.35 * s * tile.noise(rng, (5 * s, 30 * s))
    strands = tile.cells(rng, (s, 22 * s), (sway + 0.06 * s * tile.noise(rng, (s, 6 * s), 2.0), 4 * sway))
    fibre = tile.noise(rng, (0.12 * s, 7 * s), 1.7)
    fine = tile.noise(rng, (0.08 * s, 1.0 * s), 1.4)
    band = tile.noise(rng, (1.5 * s, 25 * s), 2.0)
    checks = upper_share(tile.noise(rng, (0.7 * s, 26 * s), 2.2) + 0.12 * fibre, marks, 0.10)
    round_top = 1.0 - np.exp(-strands.border_m / (0.18 * s))
    height = 0.55 + 0.20 * round_top + 0.07 * fibre + 0.02 * fine - 0.55 * checks
    tone = 0.40 + 0.20 * round_top + 0.10 * fibre + 0.07 * fine + 0.11 * band + 0.18 * (strands.values(rng) - 0.5)
    return Relief(height, tone * (1.0 - 0.85 * checks))


def end_grain(tile: Tile, rng: Rng, scale_m: float, marks: float) -> Relief:
    """A cut stem's year rings about the middle of a square tile, with radial checks and a rim of bark."""
    u, v = (place / size - 0.5 for place, size in zip(tile.places_m(), tile.size_m, strict=True))
    size_m = tile.size_m
    uneven = 0.012 * tile.noise(rng, (0.45 * size_m[0], 0.45 * size_m[1]), 2.5)
    radius = (np.hypot(u, v) * 2.0).astype(np.float32)  # 1 at the rim
    warped = radius * (1.0 + uneven)
    count = max(3, round(0.5 * size_m[0] / scale_m))
    widths = rng.lognormal(0.0, 0.35, count) * np.linspace(1.5, 0.7, count)  # young rings are wide
    bounds = np.append(0.0, np.cumsum(widths) / widths.sum())
    year = np.interp(np.minimum(warped, 1.0), bounds, np.arange(count + 1)).astype(np.float32)
    late = (year - np.floor(year)) ** 3
    angle = np.arctan2(v, u).astype(np.float32)
    ray = rng.standard_normal(720)
    rays = np.interp(angle, np.linspace(-np.pi, np.pi, 721), np.append(ray, ray[0])).astype(np.float32)
    checks = _radial_checks(rng, angle, warped, marks)
    fine = tile.noise(rng, (0.006, 0.006), 1.3)
    heart = step(warped, 0.62, 0.50)
    rim = step(warped, 0.955, 0.975)
    tone = 0.82 - 0.42 * late - 0.20 * heart + 0.03 * rays + 0.03 * fine
    tone = tone * (1.0 - 0.85 * checks) * (1.0 - 0.9 * rim)
    height = 0.8 - 0.05 * late + 0.03 * fine - 0.7 * checks + 0.1 * rim
    return Relief(height, tone)


def _radial_checks(rng: Rng, angle: Image, radius: Image, marks: float) -> Image:
    """Wedges that open towards the rim."""
    checks = np.zeros_like(radius)
    for _ in range(round(60 * marks)):
        towards, inner, width = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.75), rng.uniform(0.010, 0.035)
        turn = np.abs(np.angle(np.exp(1j * (angle - towards + 0.05 * np.sin(9.0 * radius + towards)))))
        checks = np.maximum(checks, step((turn * radius).astype(np.float32), width * 0.5, 0.0) * step(radius, inner, 1))
    return np.asarray(checks, dtype=np.float32)


PATTERNS = {
    "furrowed": Pattern(furrowed, 0.045, 0.016, 0.0),
    "plated": Pattern(plated, 0.05, 0.014, 0.5),
    "scaly": Pattern(scaly, 0.022, 0.004, 0.0),
    "smooth": Pattern(smooth, 0.016, 0.003, 0.0),
    "papery": Pattern(papery, 0.05, 0.004, 0.08),
    "ringed": Pattern(ringed, 0.06, 0.012, 0.06),
    "fibrous": Pattern(fibrous, 0.012, 0.006, 0.05),
    "end_grain": Pattern(end_grain, 0.004, 0.003, 0.10),
}
