"""Detail for a field of clouds: the edge inside each cell, folded by turbulence, and the water of the cell kept.

A simulation's cell at the edge of a cloud holds the mean of cloud and clear air. Real cumulus has its full water some
metres behind its edge, and that edge is folded at all scales. So, cell by cell:

1. The inside: the extinction that the cell's cloud has where it is cloud. That is the cell's own mean in the middle of
   a cloud, and at its edge the largest of the neighbours beside it and below: water grows upwards.
2. The depth below the edge: from the share of the cell that its water fills at that extinction, and in cells that are
   full or empty from the distance to the nearest edge. It is read by cubic B-splines.
3. The folds: places are displaced by a flow without divergence (the curl of a random potential), and the depth gets
   billows, octave by octave, of half the wavelength: round outwards, with creases between. A billow is the paraboloid
   1 - (d / spacing)² about the nearest of random points (Worley 1996), so that creases lie on the borders between
   them. Its height falls with wavelength as lambda^_ROUGHNESS. Below a cloud there are hardly any: condensation keeps
   bases flat.
4. The water: each cell's depth is shifted until the cell's mean is the simulation's, then the inside is scaled until
   the columns' water is.

References
----------
Worley, S. (1996): A cellular texture basis function. SIGGRAPH 96, 291-294.
Bridson, R., Hourihan, J., Nordenstam, M. (2007): Curl-noise for procedural fluid flow. ACM Trans. Graph. 26(3), 46.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.cloud_detail import EDGE_M, EMPTY, FULL, SUB, TILE, Detail, share_inside, tile_value
from forestgen.atmosphere.simulate import COMPUTED_WITH, SOURCES, weather_key, weather_store
from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import BoundedCache, code_hash
from forestgen.core.compiled import compiled, inlined_exactly, unowned_view
from forestgen.core.randomness import child_rng
from forestgen.core.threads import parallel_for

_POINTS = 8  # of the billows' tile along its side: a wavelength is TILE / _POINTS of its cells
_LONGEST = 2.5  # wavelength, in cells of the grid
_SHORTEST_M = 6.0
_HEIGHT = 0.4  # of the longest billows over their wavelength
_ROUGHNESS = 0.85
_FLOWS = ((3.0, 0.25), (1.5, 0.12))  # wavelength and displacement (root mean square), in cells
_EDGE_CONTRAST = (0.5, 0.25)  # of a cell's least neighbour over its largest: inside a cloud above, at its edge below
_SAMPLES, _WATER_SAMPLES = 4, 10  # places in a cell along each axis, for the shifts and for the water
_ROUNDS, _COLUMN_ROUNDS = 10, 500
_MOST_SCALED = 1.5, 4.0  # by which the inside changes for the cells, and for the columns
_BORDER = 4
_KEPT_BYTES = 200_000_000
Floats = NDArray[np.float64]
Size = tuple[float, float, float]


class _Field(NamedTuple):
    """What the depth at a place is made from."""

    depth_m: NDArray[np.float64]  # (Z, Y, X), and the border
    billow: NDArray[np.float64]  # (Z, Y, X), and the border: how much of the billows there is
    flow: NDArray[np.float32]  # (TILE, TILE, TILE, 3) displacement, root mean square 1
    flows: NDArray[np.float64]  # (F, 9) tile cells a grid cell along x, y, z; shifts; grid cells of displacement
    tile: NDArray[np.float32]
    octave: NDArray[np.float64]  # (K, 7)


@cache
def billow_tile() -> NDArray[np.float32]:
    """(TILE, TILE, TILE) paraboloids about the nearest of random points, one in each of _POINTS³ boxes; mean 0."""
    from scipy.spatial import cKDTree

    rng = child_rng(0, "billows")
    corner = np.stack(np.meshgrid(*[np.arange(_POINTS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (corner + rng.random((len(corner), 3))) / _POINTS
    place = np.stack(np.meshgrid(*[np.arange(TILE) / TILE] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = np.reshape(cKDTree(points, boxsize=np.ones(3)).query(place)[0], (TILE, TILE, TILE)) * _POINTS
    value = np.maximum(1.0 - distance**2, -1.0)
    return np.ascontiguousarray(value - value.mean(), dtype=np.float32)


@cache
def flow_tile() -> NDArray[np.float32]:
    """(TILE, TILE, TILE, 3) along x, y and z: a random flow without divergence around one wavelength."""
    import scipy.fft

    rng = child_rng(0, "flow")
    wave = np.stack(np.meshgrid(*[scipy.fft.fftfreq(TILE, 1.0 / TILE)] * 3, indexing="ij"), axis=-1)[..., ::-1]
    size = np.linalg.norm(wave, axis=-1)
    band = np.exp(-(((size - _POINTS) / (0.35 * _POINTS)) ** 2))
    potential = [scipy.fft.fftn(rng.standard_normal((TILE,) * 3)) * band for _ in range(3)]
    curl = np.cross(wave, np.stack(potential, axis=-1))
    flow = np.stack([scipy.fft.ifftn(1j * curl[..., n]).real for n in range(3)], axis=-1)
    return np.ascontiguousarray(flow / flow.std(), dtype=np.float32)


@dataclass(frozen=True)
class _Kept:
    """What takes long to make of the detail."""

    inside_per_m: NDArray[np.float32]  # (Z, Y, X)
    brick: NDArray[np.int32]
    depth: NDArray[np.int16]
    octave: Floats
    unit: Floats


_kept: BoundedCache[_Kept] = BoundedCache(_KEPT_BYTES, lambda one: one.depth.nbytes)


def detail_of(
    extinction: NDArray[np.float32], smooth: NDArray[np.bool_], cell_m: Size, *, periodic: bool
) -> tuple[NDArray[np.float32], Detail]:
    """(Z, Y, X) extinction of the inside, and the detail, of a field that is to be kept cell by cell.

    Cells that are `smooth`, as of rain, get no edge. A `periodic` field goes on at its sides, and its detail too. The
    result is kept in memory and on disk.
    """
    key = weather_key(code_hash(SOURCES, COMPUTED_WITH), "detail", extinction, smooth, cell_m, periodic)

    def find() -> _Kept:
        store = weather_store()
        found: _Kept | None = None if store is None else read_packed(store, key, (_Kept,))
        if found is None:
            found = _made(extinction.astype(np.float64), smooth, cell_m, periodic)
            if store is not None:
                store.write(key, pack(found))
                store.trim()
        # Read-only arrays, as of the disk, would be a second kernel.
        return _Kept(*(np.require(getattr(found, one.name), None, ["C", "W"]) for one in fields(found)))

    kept = _kept.get(key, find)
    return kept.inside_per_m, Detail(kept.brick, kept.depth, billow_tile(), kept.octave, kept.unit)


def _made(mean: Floats, smooth: NDArray[np.bool_], cell_m: Size, periodic: bool) -> _Kept:
    inside, share, rain = _inside(mean, smooth, periodic)
    field = _field_of(_depth_m(share, cell_m, periodic), cell_m, periodic)
    cells = np.argwhere(_near(np.where(rain, 0.0, share), periodic) & ~rain).astype(np.int64)
    field = _shifted(field, cells, mean, inside, cell_m, periodic)
    # Rain fades out into the next cell, if no cloud reaches there.
    beside_rain, cloud = (_around(one, (-1, 0, 1), periodic).any(axis=0) for one in (rain, (inside > 0) & ~rain))
    full = (share >= 0.5) | (beside_rain & ~cloud)
    detail = _bricks(field, cells, full, cell_m)
    return _Kept(_scaled(mean, inside, detail, periodic), detail.brick, detail.depth, detail.octave, detail.unit)


def _over(cells: NDArray[np.int64], work: Callable[[int, int], Any]) -> None:
    """Call `work` for ranges of cells, each of which takes long enough for a thread."""
    parallel_for(len(cells) * 64, lambda first, end: work(-(-first // 64), -(-end // 64)))


def _around(values: NDArray[Any], layers: tuple[int, ...], periodic: bool) -> NDArray[Any]:
    """(9 L, Z, Y, X) each cell's neighbours beside it and itself, in layers so many above."""
    sides = ((1, 1), (1, 1))
    padded = np.pad(values, ((1, 1), (0, 0), (0, 0)), mode="edge")
    padded = np.pad(padded, ((0, 0), *sides), mode="wrap" if periodic else "edge")
    z, y, x = values.shape
    return np.stack([
        padded[1 + k : 1 + k + z, j : j + y, i : i + x] for k in layers for j in range(3) for i in range(3)
    ])  # fmt: skip


def _inside(mean: Floats, smooth: NDArray[np.bool_], periodic: bool) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Extinction where a cell is cloud, reaching two cells out of the clouds; the share that is cloud; cells of rain.

    Smooth cells beside a cloud count as its edge, so that drizzle does not blur it.
    """
    cloud = np.where(smooth, 0.0, mean)
    most = _around(cloud, (-1, 0), periodic).max(axis=0)
    least = _around(cloud, (0, 1), periodic).min(axis=0)
    high, low = _EDGE_CONTRAST
    edge = np.clip((high - least / np.maximum(most, 1e-30)) / (high - low), 0.0, 1.0)
    inside = np.maximum(mean + edge * (most - mean), mean)
    rain = smooth & (most == 0.0)
    share = np.where(rain, 1.0, mean / np.maximum(inside, 1e-30))
    inside = np.where(rain, 0.0, inside)
    for _ in range(2):
        inside = np.where(inside > 0, inside, _around(inside, (-1, 0, 1), periodic).max(axis=0))
    # Rain is read between the cells' values as they are: what reaches out of a cloud must not be one of them.
    beside_rain = _around(rain, (-1, 0, 1), periodic).any(axis=0)
    return np.where(rain | (beside_rain & (share == 0)), mean, inside), share, rain


def _depth_m(share: Floats, cell_m: Size, periodic: bool) -> Floats:
    """Depth of the cells' centres below the edge."""
    from scipy.ndimage import distance_transform_edt

    around = 8 if periodic else 0
    ways = ((0, 0), (min(around, share.shape[1]),) * 2, (min(around, share.shape[2]),) * 2)
    wide = np.pad(share, ways, mode="wrap")
    inner = tuple(slice(low, low + n) for (low, _), n in zip(ways, share.shape, strict=True))
    size, half = cell_m[::-1], min(cell_m) / 2.0
    full = wide >= 0.5
    most = 4.0 * max(cell_m)
    within = distance_transform_edt(full, size) if not full.all() else np.full(wide.shape, most)
    out = distance_transform_edt(~full, size) if full.any() else np.full(wide.shape, most)
    depth = np.where(full, within - 2.0 * half, -(out - 2.0 * half)) + (wide - 0.5) * 2.0 * half
    return np.clip(depth, -most, most)[inner]


def _padded(values: Floats, periodic: bool) -> Floats:
    """With `_BORDER` more cells on each side, for splines at displaced places."""
    side = (_BORDER, _BORDER)
    up = np.pad(values, (side, (0, 0), (0, 0)), mode="edge")
    return np.ascontiguousarray(np.pad(up, ((0, 0), side, side), mode="wrap" if periodic else "edge"))


def _field_of(depth_m: Floats, cell_m: Size, periodic: bool) -> _Field:
    """Billows grow where the edge does not face down."""
    padded = _padded(depth_m, periodic)
    gradient = np.stack(list(np.gradient(padded, *cell_m[::-1])))
    facing_down = gradient[0] / np.maximum(np.linalg.norm(gradient, axis=0), 1e-9)
    billow = np.clip(1.0 - 1.3 * facing_down, 0.05, 1.0)
    shape = depth_m.shape
    wide_m = max(cell_m)
    flows = [
        [*_scales(shape, cell_m, length * wide_m, n), *(size * wide_m / np.array(cell_m))]
        for n, (length, size) in enumerate(_FLOWS)
    ]
    octaves = _octaves(shape, cell_m)
    return _Field(padded, billow, flow_tile(), np.array(flows), billow_tile(), octaves)


def _scales(shape: tuple[int, ...], cell_m: Size, length_m: float, number: int) -> list[float]:
    """Tile cells a grid cell along x, y, z, and shifts: whole tiles along x and y of the grid."""
    tile_m = length_m * _POINTS
    along = [TILE * max(1, round(n * side / tile_m)) / n for n, side in zip(shape[:0:-1], cell_m[:2], strict=True)]
    return [*along, TILE * cell_m[2] / tile_m, *(child_rng(0, "shift", number).random(3) * TILE)]


def _octaves(shape: tuple[int, ...], cell_m: Size) -> Floats:
    """(K, 7) from the longest to the shortest."""
    longest = _LONGEST * max(cell_m)
    count = 1 + max(0, math.ceil(math.log2(longest / _SHORTEST_M)))
    lengths = longest * 0.5 ** np.arange(count)
    heights = _HEIGHT * longest * (lengths / longest) ** _ROUGHNESS
    return np.array([[*_scales(shape, cell_m, a, n), h] for n, (a, h) in enumerate(zip(lengths, heights, strict=True))])


def _finest(cell_m: Size) -> int:
    """Number of the first octave that nodes of the bricks are too far apart for: four in a wavelength."""
    longest = _LONGEST * max(cell_m)
    return max(0, math.floor(math.log2(longest / (4.0 * max(cell_m) / SUB)))) + 1


def _near(share: Floats, periodic: bool) -> NDArray[np.bool_]:
    """Cells that an edge may come to."""
    most = _around(share, (-1, 0, 1), periodic).max(axis=0)
    least = _around(share, (-1, 0, 1), periodic).min(axis=0)
    return np.asarray((most > 0) & (least < 1))


def _shifted(
    field: _Field, cells: NDArray[np.int64], mean: Floats, inside: Floats, cell_m: Size, periodic: bool
) -> _Field:
    """The field with the depths at which the cells have their water."""
    rng = child_rng(0, "places")
    corner = np.stack(np.meshgrid(*[np.arange(_SAMPLES)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    places = (corner + rng.random(corner.shape)) / _SAMPLES - 0.5
    given = np.empty((len(cells), len(places), 4), dtype=np.float32)
    _over(cells, lambda a, b: _folds(field, cells, places, a, b, given))
    (z, y, x), side = cells.T, min(cell_m)
    core = field.depth_m[(slice(_BORDER, -_BORDER),) * 3].copy()
    found, speed = np.empty(len(cells)), np.zeros(len(cells))
    wanted = mean[z, y, x]
    for _ in range(_ROUNDS):
        _over(cells, partial(_means, _padded(core, periodic), inside, cells, given, found))
        error = (wanted - found) / np.maximum(inside[z, y, x], 1e-30)
        speed = 0.6 * speed + side * error
        core[z, y, x] = np.clip(core[z, y, x] + speed, -4.0 * side, 4.0 * side)
    return field._replace(depth_m=_padded(core, periodic))


@inlined_exactly
def _spline(values, x, y, z):  # type: ignore[no-untyped-def]
    """Cubic B-spline of a field with its border, at a place in cells from the first one's centre."""
    layers, rows, columns = values.shape
    i = min(max(int(np.floor(x)), 1 - _BORDER), columns - _BORDER - 3)
    j = min(max(int(np.floor(y)), 1 - _BORDER), rows - _BORDER - 3)
    k = min(max(int(np.floor(z)), 1 - _BORDER), layers - _BORDER - 3)
    u, v, w = min(max(x - i, 0.0), 1.0), min(max(y - j, 0.0), 1.0), min(max(z - k, 0.0), 1.0)
    of_x, of_y, of_z = _weights(u), _weights(v), _weights(w)
    total = 0.0
    for c in range(4):
        for b in range(4):
            row = 0.0
            for a in range(4):
                row += of_x[a] * values[k + c + _BORDER - 1, j + b + _BORDER - 1, i + a + _BORDER - 1]
            total += of_z[c] * of_y[b] * row
    return total


@inlined_exactly
def _weights(u):  # type: ignore[no-untyped-def]
    v = 1.0 - u
    return (
        v * v * v / 6.0,
        (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
        (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0,
        u * u * u / 6.0,
    )


@inlined_exactly
def _displaced(field, x, y, z):  # type: ignore[no-untyped-def]
    """A place, moved by the flow, in grid cells."""
    for n in range(len(field.flows)):
        one = field.flows[n]
        u, v, w = x * one[0] + one[3], y * one[1] + one[4], z * one[2] + one[5]
        i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
        u, v, w = u - i, v - j, w - k
        du, dv, dw = 0.0, 0.0, 0.0
        for corner in range(8):
            a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
            near = field.flow[(k + c) & (TILE - 1), (j + b) & (TILE - 1), (i + a) & (TILE - 1)]
            weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
            du += weight * near[0]
            dv += weight * near[1]
            dw += weight * near[2]
        x, y, z = x + one[6] * du, y + one[7] * dv, z + one[8] * dw
    return x, y, z


@inlined_exactly
def _billows(field, x, y, z, first, last):  # type: ignore[no-untyped-def]
    total = 0.0
    for n in range(first, last):
        one = field.octave[n]
        total += one[6] * tile_value(field.tile, x * one[0] + one[3], y * one[1] + one[4], z * one[2] + one[5])
    return total


@compiled
def _folds(field, cells, places, first, last, out):  # type: ignore[no-untyped-def]
    """Displaced places and billows (N, P, 4) at places in cells."""
    field = unowned_view(field)
    for n in range(first, last):
        for p in range(len(places)):
            x, y, z = cells[n, 2] + places[p, 0], cells[n, 1] + places[p, 1], cells[n, 0] + places[p, 2]
            px, py, pz = _displaced(field, x, y, z)
            billow = _spline(field.billow, px, py, pz)
            out[n, p, 0], out[n, p, 1], out[n, p, 2] = px, py, pz
            out[n, p, 3] = billow * _billows(field, px, py, pz, 0, len(field.octave))


@compiled
def _means(depth_m, inside, cells, given, out, first, last):  # type: ignore[no-untyped-def]
    """Mean extinction (N,) of cells."""
    for n in range(first, last):
        total = 0.0
        for p in range(given.shape[1]):
            depth = _spline(depth_m, given[n, p, 0], given[n, p, 1], given[n, p, 2]) + given[n, p, 3]
            total += min(max(depth / EDGE_M + 0.5, 0.0), 1.0)
        out[n] = total / given.shape[1] * inside[cells[n, 0], cells[n, 1], cells[n, 2]]


def _bricks(field: _Field, cells: NDArray[np.int64], full: NDArray[np.bool_], cell_m: Size) -> Detail:
    """Bricks of the cells that the edge is in."""
    lookup = _finest(cell_m)
    octave = np.ascontiguousarray(field.octave[lookup:])
    tile = billow_tile()
    reach = float((octave[:, 6] * np.abs(tile).max()).sum()) + EDGE_M
    unit = reach * 1.05 / 32767
    brick = np.where(full, FULL, EMPTY).astype(np.int32)
    depth = np.empty((len(cells), SUB + 1, SUB + 1, SUB + 1), dtype=np.int16)
    kind = np.empty(len(cells), dtype=np.int32)
    args = (field, cells, lookup, unit, reach, depth, kind)
    _over(cells, partial(_nodes, *args))
    kept = kind == 0
    kind[kept] = np.arange(kept.sum())
    brick[tuple(cells.T)] = kind
    return Detail(brick, np.ascontiguousarray(depth[kept]), tile, octave, np.array([unit, cell_m[2] / SUB, reach]))


@compiled
def _nodes(field, cells, lookup, unit, reach, depth, kind, first, last):  # type: ignore[no-untyped-def]
    """Depth at the nodes of each cell, and whether the edge is in it (0) or not."""
    field = unowned_view(field)
    for n in range(first, last):
        least, most = np.inf, -np.inf
        for c in range(SUB + 1):
            for b in range(SUB + 1):
                for a in range(SUB + 1):
                    x = cells[n, 2] - 0.5 + a / SUB
                    y = cells[n, 1] - 0.5 + b / SUB
                    z = cells[n, 0] - 0.5 + c / SUB
                    px, py, pz = _displaced(field, x, y, z)
                    value = _spline(field.depth_m, px, py, pz)
                    value += _spline(field.billow, px, py, pz) * _billows(field, px, py, pz, 0, lookup)
                    least, most = min(least, value), max(most, value)
                    value = min(max(value / unit, -32767.0), 32767.0)
                    depth[n, c, b, a] = np.int16(np.rint(value))
        kind[n] = 0
        if least >= reach:
            kind[n] = FULL
        elif most <= -reach:
            kind[n] = EMPTY


def _scaled(mean: Floats, inside: Floats, detail: Detail, periodic: bool) -> NDArray[np.float32]:
    """The inside's extinction at which the columns have their water."""
    from scipy.sparse import coo_array

    cells = np.argwhere(detail.brick != EMPTY)
    shares = np.zeros((len(cells), 27))
    _over(cells, lambda a, b: _shares(detail, cells, _WATER_SAMPLES, a, b, shares))
    z, y, x = cells.T
    number = np.arange(mean.size, dtype=np.float64).reshape(mean.shape)
    around = _around(number, (-1, 0, 1), periodic)[:, z, y, x].T.astype(np.int64)
    most, most_of_column = _MOST_SCALED
    result = inside.copy()
    for _ in range(_ROUNDS):  # first the cells, gently
        found = (shares * result.ravel()[around]).sum(axis=1)
        result[z, y, x] *= (mean[z, y, x] / np.maximum(found, 1e-30)) ** 0.3
        result = np.clip(result, inside / most**2, inside * most)
    across = mean[0].size
    pairs = (np.broadcast_to((y * mean.shape[2] + x)[:, None], around.shape).ravel(), around.ravel() % across)
    water = coo_array(((shares * result.ravel()[around]).ravel(), pairs), (across, across)).tocsr()
    wanted, factor = mean.sum(axis=0).ravel(), np.ones(across)
    for _ in range(_COLUMN_ROUNDS):
        there = water @ factor
        factor *= np.where(there > 0, wanted / np.maximum(there, 1e-30), 1.0)
        factor = np.clip(factor, 1.0 / most_of_column**2, most_of_column)
    result *= factor.reshape(mean.shape[1:])
    total = float((shares * result.ravel()[around]).sum())  # with what has come into columns without water
    return np.ascontiguousarray(result * (mean.sum() / max(total, 1e-30)), dtype=np.float32)


@compiled
def _shares(detail, cells, samples, first, last, out):  # type: ignore[no-untyped-def]
    """(N, 27) what each cell's mean has of the insides of itself and its neighbours."""
    detail = unowned_view(detail)
    for cell in range(first, last):
        k, j, i = cells[cell]
        for place in range(samples**3):
            u = (place % samples + 0.5) / samples - 0.5
            v = (place // samples % samples + 0.5) / samples - 0.5
            w = (place // samples**2 + 0.5) / samples - 0.5
            share = share_inside(detail, i + u, j + v, k + w) / samples**3
            if share > 0.0:
                for n in range(27):
                    out[cell, n] += share * _hat(n % 3 - 1 - u) * _hat(n // 3 % 3 - 1 - v) * _hat(n // 9 - 1 - w)


@inlined_exactly
def _hat(x):  # type: ignore[no-untyped-def]
    return max(1.0 - abs(x), 0.0)
