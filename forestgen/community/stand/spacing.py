"""Places of stems: random, regular or clumped, and no two nearer than their diameters allow.

Trees are placed one after the other, the thickest first, at random places of the ground that their density allows; a
place is refused where another stem is too near, and another one is tried. Two stems are at least the sum of their
diameters apart, from pith to pith. A regular pattern also keeps trees of a storey apart, by

    (s_i + s_j) / 2,    s = δ / sqrt(λ) * sqrt(D / mean D),

with λ the stems per area: the greater the stem, the more room it has. In a clumped pattern stems stand around random
centres, of eight trees each in the mean, at a normal distance of w / sqrt(λ) along each axis (Thomas 1949).

What is asked for is Clark and Evans' index R (1954, Ecology 35): the mean distance to the nearest stem over that of
independent random places. δ and w follow from R by `_REGULAR` and `_CLUMPED`, which were measured with 4000 stems on a
torus. A tree that finds no place in `_TRIES` tries gives up half of its s, and then all of it.
"""

from __future__ import annotations

from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.competition.grid import span, wrapped
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled, inlined_exactly
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed

LEAST_R, MOST_R = 0.55, 1.6
_RANDOM_R = 0.99  # from here on no clumps
_REGULAR = (
    (1.0, 1.02, 1.05, 1.08, 1.155, 1.245, 1.353, 1.468, 1.587, 1.65),  # R
    (0.0, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75),  # δ
)
_CLUMPED = (
    (0.54, 0.632, 0.705, 0.763, 0.813, 0.883, 0.933, 0.965, 0.98),  # R
    (0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.3, 1.6, 2.0),  # w
)
_TREES_PER_CLUMP = 8.0
_TRIES = 300
_DRAWS = 200_000  # of a tree, places without density included
_TO_UNIT = 2.0**-53
_mixed = inlined_exactly(mixed)


class StemGrid(NamedTuple):
    """The stems placed so far, in cells at least as wide as the greatest distance that any two must keep."""

    x: Floats  # (M,) metres; all stems that there will be
    y: Floats
    dbh: Floats  # (M,)
    apart: Floats  # (M,) s
    storey: NDArray[np.int64]  # (M,)
    head: NDArray[np.int64]  # (cells,) last stem in each cell, -1 for none
    next: NDArray[np.int64]  # (M,) the stem before it in its cell
    n: tuple[int, int]
    size_m: tuple[float, float]
    periodic: bool


class Places(NamedTuple):
    """Where a storey's trees may stand."""

    open: Floats  # (rows, cols) relative density, at most 1; row 0 at y = 0
    shaded: Floats  # (rows, cols) 1 below the crowns of taller storeys, 0 elsewhere
    centre: Floats  # (K, 2) of clumps; none: trees stand anywhere
    width: float  # standard deviation of a clump, metres


@compiled
def _random(state):  # type: ignore[no-untyped-def]
    """A number in [0, 1) of SplitMix64; `state` (1,) uint64 moves on."""
    state[0] += SPLIT_MIX_STEP
    return float(_mixed(state[0]) >> np.uint64(11)) * _TO_UNIT


@compiled
def _is_free(grid, i, x, y, give, storey):  # type: ignore[no-untyped-def]
    """Whether stem i may stand at x, y; `give`: what is left of its s."""
    width, height = grid.size_m
    per_x, per_y = grid.n[0] / width, grid.n[1] / height
    x0, across = span(x * per_x, 1.0, grid.n[0], grid.periodic)
    y0, along = span(y * per_y, 1.0, grid.n[1], grid.periodic)
    for b in range(along):
        for a in range(across):
            j = grid.head[wrapped(y0 + b, grid.n[1]) * grid.n[0] + wrapped(x0 + a, grid.n[0])]
            while j >= 0:
                dx, dy = abs(x - grid.x[j]), abs(y - grid.y[j])
                if grid.periodic:
                    dx, dy = min(dx, width - dx), min(dy, height - dy)
                least = grid.dbh[i] + grid.dbh[j]
                if grid.storey[j] == storey:
                    least = max(least, 0.5 * give * (grid.apart[i] + grid.apart[j]))
                if dx * dx + dy * dy < least * least:
                    return False
                j = grid.next[j]
    return True


@compiled
def _proposal(places, size_m, periodic, state):  # type: ignore[no-untyped-def]
    """A random place, in a clump or anywhere; perhaps beyond a site that does not repeat."""
    u, v = _random(state), _random(state)
    if len(places.centre) == 0:
        return u * size_m[0], v * size_m[1]
    k = int(_random(state) * len(places.centre))
    r = places.width * np.sqrt(-2.0 * np.log(1.0 - u))
    x = places.centre[k, 0] + r * np.cos(2.0 * np.pi * v)
    y = places.centre[k, 1] + r * np.sin(2.0 * np.pi * v)
    return (x % size_m[0], y % size_m[1]) if periodic else (x, y)


@compiled
def _place(grid, first, last, storey, tolerance, places, tries, draws, state):  # type: ignore[no-untyped-def]
    """Give stems first to last - 1 their places, in place; the first stem that has none, or `last`."""
    width, height = grid.size_m
    rows, cols = places.open.shape
    for i in range(first, last):
        tried, drawn, found = 0, 0, False
        while tried < 3 * tries and drawn < draws and not found:
            drawn += 1
            x, y = _proposal(places, grid.size_m, grid.periodic, state)
            if x < 0.0 or y < 0.0 or x >= width or y >= height:
                continue
            row, col = min(int(y / height * rows), rows - 1), min(int(x / width * cols), cols - 1)
            chance = places.open[row, col] * (1.0 - places.shaded[row, col] * (1.0 - tolerance[i]))
            if _random(state) >= chance:
                continue
            give = 1.0 if tried < tries else (0.5 if tried < 2 * tries else 0.0)
            tried += 1
            found = _is_free(grid, i, x, y, give, storey)
        if not found:
            return i
        grid.x[i], grid.y[i], grid.storey[i] = x, y, storey
        cell = min(floor(y / height * grid.n[1]), grid.n[1] - 1) * grid.n[0]
        cell += min(floor(x / width * grid.n[0]), grid.n[0] - 1)
        grid.next[i], grid.head[cell] = grid.head[cell], i
    return last


def empty_grid(stems: int, widest_m: float, size_m: tuple[float, float], *, periodic: bool) -> StemGrid:
    """A grid for so many stems, of which none has a place yet; `widest_m`: the greatest distance two must keep."""
    side = max(widest_m, np.sqrt(size_m[0] * size_m[1] / max(stems, 1)))
    n = (max(1, min(int(size_m[0] / side), 20_000)), max(1, min(int(size_m[1] / side), 20_000)))
    x, y, dbh, apart = np.full((4, stems), np.nan)
    storey, before = np.full((2, stems), -1, dtype=np.int64)
    return StemGrid(x, y, dbh, apart, storey, np.full(n[0] * n[1], -1, dtype=np.int64), before, n, size_m, periodic)


def insert(grid: StemGrid, position_m: Floats, dbh_m: Floats) -> None:
    """Put the first stems of a grid at (N, 2) places that are known."""
    count = len(dbh_m)
    grid.x[:count], grid.y[:count] = position_m.T
    grid.dbh[:count], grid.apart[:count] = dbh_m, 0.0
    at = np.minimum((position_m / grid.size_m * grid.n).astype(np.int64), np.array(grid.n) - 1)
    for one, cell in enumerate((at[:, 1] * grid.n[0] + at[:, 0]).tolist()):
        grid.next[one], grid.head[cell] = grid.head[cell], one


def own_distance_m(dbh_m: Floats, area_m2: float, clark_evans: float) -> Floats:
    """(N,) s of a storey's trees: 0 unless their pattern is regular."""
    delta = np.interp(clark_evans, *_REGULAR)
    if not len(dbh_m) or delta <= 0.0:
        return np.zeros(len(dbh_m))
    root = np.sqrt(dbh_m)
    return np.asarray(delta * np.sqrt(area_m2 / len(dbh_m)) * root / root.mean())


def place_storey(
    grid: StemGrid,
    first: int,
    dbh_m: Floats,
    tolerance: Floats,
    clark_evans: float,
    ground: tuple[Floats, Floats],
    rng: np.random.Generator,
) -> int:
    """Place the trees of a storey, (N,) DBH from the thickest on, as stems `first` on of a grid; how many have places.

    `tolerance`: (N,) chance of a place below the crowns of taller storeys, against one in the open. `ground`: see
    `Places.open` and `shaded`.
    """
    last, area_m2 = first + len(dbh_m), grid.size_m[0] * grid.size_m[1]
    clumps = max(1, round(len(dbh_m) / _TREES_PER_CLUMP)) if clark_evans < _RANDOM_R else 0
    centre = rng.random((clumps, 2)) * grid.size_m
    width = float(np.interp(clark_evans, *_CLUMPED) * np.sqrt(area_m2 / max(len(dbh_m), 1)))
    grid.dbh[first:last] = dbh_m
    grid.apart[first:last] = own_distance_m(dbh_m, area_m2, clark_evans)
    chance = np.zeros(last)
    chance[first:] = tolerance
    opened, shaded = (np.ascontiguousarray(one, dtype=np.float64) for one in ground)
    places = Places(opened, shaded, centre, width)
    state = rng.integers(0, 2**64, 1, dtype=np.uint64)
    return int(_place(grid, first, last, int(first), chance, places, _TRIES, _DRAWS, state)) - first
