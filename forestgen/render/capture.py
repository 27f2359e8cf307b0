"""Images taken with a camera of any kind.

Some projections are the renderer's own, as `Projection.sensor` says. Images of the others, such as fisheyes and
panoramas, are assembled: the faces of a cube around the camera are cut into square tiles, each rendered by a pinhole
whose pixels, here called cells, are so small that an image pixel holds as many of them as it shall have samples, with
one random ray through each. The ray's place in its cell depends on the seed alone, and `ray_places` repeats the draw
of the renderer's pinned version. So each sample's direction is known exactly, and it is counted in the image pixel that
`scene/projection.py` gives for it: edges are as sharp as by rays through the image's own pixels, and faces have no
seams. A pixel is the mean of its samples, each weighted by the solid angle of its cell.

Decisions
---------
- Faces are not interpolated: that would blur by a face's pixel and see other edges than the labels do.
- A tile has as many cells as its image pixels have samples together. Tiles are halved where image pixels differ much
  in size (a panorama's poles), where the fisheye's circle cuts them, and where they are large.
- A pixel of the size of six cells or more holds a whole cell, so it has a sample: `LEAST_SAMPLES`, to which fewer are
  raised. Only beside a panorama's poles, where pixels are long and narrow, some stay empty; they take the mean of the
  samples of their neighbours, of one row where that has any.
- A mean of a varying number of samples gives those of cells at the pixel's border a little less weight: 3% less at
  eight samples a pixel, 0.2% at 64. That narrows a pixel; it changes no brightness.
- A pixel that the fisheye's circle cuts is multiplied with the share of it inside: outside there is no light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.cache import BoundedCache
from forestgen.core.randomness import child_seed
from forestgen.render.variant import BLOCK_PX, SAMPLER, interruptible, mi
from forestgen.scene.projection import project, projection_of, rays
from forestgen.scene.spec import Camera

_NEAR_M, _FAR_M = 1e-3, 1e7  # the identity pass starts at the camera itself; the sun's disc stands at 1e6 m
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
LEAST_SAMPLES = 8  # a pixel, in one capture
_FIRST_LEVEL = 1  # a face is cut into 2^level by 2^level tiles
_LAST_LEVEL = 14
_MOST_CELLS = 512  # along a tile's side
_FEWEST_CELLS = 12  # below that a tile is not halved for the sake of its samples' evenness
_UNEVEN = 1.35  # largest over mean density of image pixels in a tile
_PROBES = 8  # along a tile's side
_VIEWS_PROBED = 96  # along an image's side
_RIM_PARTS = 16  # along a pixel's side
# Columns: a face's x, y and z in the camera's axes.
_FACES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    ],
    dtype=np.float64,
)


@dataclass(frozen=True)
class FilmWindow:
    """Rows and columns of the image that a pass renders."""

    offset_x: int
    offset_y: int
    width: int
    height: int


def is_assembled(camera: Camera) -> bool:
    """Whether images of this camera are assembled from others; they need `LEAST_SAMPLES` in each capture."""
    return projection_of(camera).sensor(camera) is None


def sensor_of(camera: Camera, samples: int, window: FilmWindow | None = None) -> Any:
    """A Mitsuba sensor at the origin, of a camera that is not assembled."""
    sensor = projection_of(camera).sensor(camera)
    assert sensor is not None
    axes = camera.world_from_camera * [sensor.scale, sensor.scale, 1.0]
    return _sensor(sensor.plugin, axes, film(camera.size_px, window), {"type": SAMPLER, "sample_count": samples})


def square_view(world_from_view: Floats, size_px: int, window: FilmWindow) -> Any:
    """A pinhole of 90 degrees across a square, with one random ray through each pixel of the window."""
    pinhole = {"type": "perspective", "fov": 90.0, "fov_axis": "x"}
    sampler = {"type": "independent", "sample_count": 1}
    return _sensor(pinhole, world_from_view, film((size_px, size_px), window), sampler)


def _sensor(plugin: Mapping[str, Any], world_from_camera: Floats, film: dict[str, Any], sampler: dict[str, Any]) -> Any:
    matrix = np.eye(4)
    matrix[:3, :3] = world_from_camera * [-1.0, -1.0, 1.0]  # the renderer's x points left and its y up
    place = {"near_clip": _NEAR_M, "far_clip": _FAR_M, "to_world": mi.ScalarTransform4f(matrix)}
    return mi.load_dict({**plugin, **place, "film": film, "sampler": sampler})


def film(size_px: tuple[int, int], window: FilmWindow | None = None, pixel_format: str = "rgba") -> dict[str, Any]:
    """A film of Mitsuba's, without a reconstruction filter."""
    result: dict[str, Any] = {"type": "hdrfilm", "width": size_px[0], "height": size_px[1], "rfilter": {"type": "box"}}
    result |= {"pixel_format": pixel_format, "component_format": "float32"}
    crop = {} if window is None else {f"crop_{name}": value for name, value in vars(window).items()}
    return result | crop


@dataclass(frozen=True)
class Tile:
    """A square of a face, and how finely it is rendered."""

    face: int
    level: int
    column: int
    row: int
    cells: int  # along its side

    @property
    def size_px(self) -> int:
        """Cells along the side of the face."""
        return self.cells << self.level

    @property
    def window(self) -> FilmWindow:
        return FilmWindow(self.column * self.cells, self.row * self.cells, self.cells, self.cells)


_kept: BoundedCache[list[Tile]] = BoundedCache(16, lambda tiles: 1)  # slices of an image have the same tiles


def assemble(
    integrator: Any, scene: Any, camera: Camera, *, samples: int, seed: int, window: FilmWindow | None = None
) -> Floats:
    """(H, W, 4) as `capture` gives it; the integrator's blocks are `BLOCK_PX` wide."""
    part = FilmWindow(0, 0, *camera.size_px) if window is None else window
    total = np.zeros((part.height, part.width, 5))  # four channels and the weight
    first = child_seed(seed, "tiles") % 2**32
    for tile in tiles_of(camera, max(samples, LEAST_SAMPLES), part):
        # The renderer numbers a film's rays from its seed times its pixels on: no two tiles share a number.
        own = -(-first // tile.cells**2) % 2**32
        first = (own + 1) * tile.cells**2
        view = square_view(camera.world_from_camera @ _FACES[tile.face], tile.size_px, tile.window)
        image = interruptible(integrator, scene, view, own, 1)
        _sort_into(total, camera, part, tile, ray_places(tile.cells, own), image)
    return _developed(total, camera, part)


def _sort_into(
    total: Floats, camera: Camera, part: FilmWindow, tile: Tile, places: Floats, image: NDArray[np.float32]
) -> None:
    """Add a tile's samples to the pixels that their rays go through."""
    across = (tile.window.offset_x + places[..., 0].ravel()) * (2.0 / tile.size_px) - 1.0
    down = (tile.window.offset_y + places[..., 1].ravel()) * (2.0 / tile.size_px) - 1.0
    toward = np.stack([across, down, np.ones_like(across)], axis=-1) @ _FACES[tile.face].T
    there = project(camera, toward)
    column = np.floor(there.x_px).astype(np.int64) - part.offset_x
    row = np.floor(there.y_px).astype(np.int64) - part.offset_y
    if projection_of(camera).wraps_x:  # its ends are one place; and rounding may reach past a pole
        column, row = column % camera.size_px[0], np.minimum(row, camera.size_px[1] - 1 - part.offset_y)
    kept = there.in_front & (column >= 0) & (column < part.width) & (row >= 0) & (row < part.height)
    if not kept.any():
        return
    weight = (across * across + down * down + 1.0)[kept] ** -1.5 / tile.size_px**2
    values = image.reshape(-1, image.shape[-1])[kept]
    column, row = column[kept], row[kept]
    low_x, low_y, high_x, high_y = column.min(), row.min(), column.max() + 1, row.max() + 1
    place, shape = (row - low_y) * (high_x - low_x) + column - low_x, (high_y - low_y, high_x - low_x)
    box = total[low_y:high_y, low_x:high_x]
    for channel in range(4):
        box[..., channel] += _summed(place, weight * values[:, channel], shape)
    box[..., 4] += _summed(place, weight, shape)


def _summed(place: Ints, value: Floats, shape: tuple[int, int]) -> Floats:
    return np.asarray(np.bincount(place, value, shape[0] * shape[1]).reshape(shape), dtype=np.float64)


def _developed(total: Floats, camera: Camera, part: FilmWindow) -> Floats:
    """Sums over weights; see the module's decisions for empty pixels and the rim."""
    inside, wraps_x = _share_inside(camera, part), projection_of(camera).wraps_x
    empty = (total[..., 4] == 0) & (inside > 0)
    for reach in range(1, 6):
        if not empty.any():
            break
        pooled = _pooled(total, reach, wraps=part.width == camera.size_px[0] and wraps_x)
        total = np.where(empty[..., None], pooled, total)
        empty = (total[..., 4] == 0) & (inside > 0)
    weight = total[..., 4:]
    mean = np.divide(total[..., :4], weight, out=np.zeros_like(total[..., :4]), where=weight > 0)
    return np.asarray(mean * inside[..., None])


def _pooled(total: Floats, reach: int, *, wraps: bool) -> Floats:
    """Sums over the neighbours in the row; from a reach of 4 on those above and below too."""
    from scipy.ndimage import uniform_filter1d

    summed = uniform_filter1d(total, 2 * 2**reach + 1, axis=1, mode="wrap" if wraps else "nearest")
    return uniform_filter1d(summed, 3, axis=0, mode="nearest") if reach > 3 else summed


def _share_inside(camera: Camera, part: FilmWindow) -> Floats:
    """(H, W) share of each pixel in which the image shows anything: inside of a fisheye's circle."""
    x = np.arange(part.offset_x, part.offset_x + part.width + 1.0)
    y = np.arange(part.offset_y, part.offset_y + part.height + 1.0)
    corner = rays(camera, x, y[:, None]).valid
    centre = rays(camera, x[:-1] + 0.5, y[:-1, None] + 0.5).valid
    share = centre.astype(np.float64)
    corners = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]])
    row, column = np.nonzero((corners != centre).any(axis=0))
    offset = (np.arange(_RIM_PARTS) + 0.5) / _RIM_PARTS
    fine = rays(camera, x[column, None, None] + offset, y[row, None, None] + offset[:, None])
    share[row, column] = fine.valid.mean(axis=(1, 2))
    return np.asarray(share)


def tiles_of(camera: Camera, samples: int, part: FilmWindow) -> list[Tile]:
    """The tiles that together see a part of an image, with `samples` cells for each of its pixels."""
    lens = camera.projection, camera.size_px, camera.hfov_deg, tuple(sorted(camera.numbers.items()))
    return _kept.get((*lens, samples, part), lambda: _tiles(camera, samples, part))


def _tiles(camera: Camera, samples: int, part: FilmWindow) -> list[Tile]:
    (directions, gap), count = _seen(camera, part), 1 << _FIRST_LEVEL
    coarse = product(range(6), range(count), range(count))
    return [
        tile
        for face, row, column in coarse
        for tile in _halved(camera, samples, directions, gap, Tile(face, _FIRST_LEVEL, column, row, 0))
    ]


def _halved(camera: Camera, samples: int, directions: Floats, gap: float, tile: Tile) -> Iterator[Tile]:
    """The tile with its number of cells, or its quarters, or nothing if the image does not see it."""
    side = 2.0 / (1 << tile.level)
    step = (np.arange(_PROBES) + 0.5) / _PROBES
    across = -1.0 + (tile.column + step) * side
    down = (-1.0 + (tile.row + step) * side)[:, None]
    middle = np.array([-1.0 + (tile.column + 0.5) * side, -1.0 + (tile.row + 0.5) * side, 1.0])
    reach = side / np.sqrt(2.0) / float(np.hypot(np.hypot(middle[0], middle[1]), 1.0))  # at least its angular radius
    toward = _FACES[tile.face] @ (middle / np.linalg.norm(middle))
    near = float(np.arccos(np.clip(np.max(directions @ toward), -1.0, 1.0)))
    if near > reach + gap:
        return
    density = _pixels_per_area(camera, tile.face, across, down)
    mean = float(density.mean())
    cells = max(1, int(np.ceil(np.sqrt(mean * samples) * side)))
    uneven = cells > _FEWEST_CELLS and float(density.max()) > _UNEVEN * mean
    if tile.level < _LAST_LEVEL and (cells > _MOST_CELLS or uneven or (cells > 4 * _FEWEST_CELLS and near > gap)):
        for row in (2 * tile.row, 2 * tile.row + 1):
            for column in (2 * tile.column, 2 * tile.column + 1):
                yield from _halved(camera, samples, directions, gap, Tile(tile.face, tile.level + 1, column, row, 0))
    else:
        yield Tile(tile.face, tile.level, tile.column, tile.row, cells)


def _pixels_per_area(camera: Camera, face: int, across: Floats, down: Floats) -> Floats:
    """Image pixels per area of a face, whose sides are 2 long, at its points."""
    squared = across * across + down * down + 1.0
    toward = np.stack(np.broadcast_arrays(across, down, 1.0), axis=-1) @ _FACES[face].T / np.sqrt(squared)[..., None]
    return np.asarray(projection_of(camera).pixels_per_sr(camera, toward) * squared**-1.5)


def _seen(camera: Camera, part: FilmWindow) -> tuple[Floats, float]:
    """(N, 3) unit directions that an image's part sees, own axes, and an angle within which there is always one."""
    x = np.linspace(part.offset_x, part.offset_x + part.width, _VIEWS_PROBED)
    y = np.linspace(part.offset_y, part.offset_y + part.height, _VIEWS_PROBED)
    ways = rays(camera, x, y[:, None])
    steps_px = (part.width / (_VIEWS_PROBED - 1), part.height / (_VIEWS_PROBED - 1))
    (width, height), projection = camera.size_px, projection_of(camera)
    gap = projection.step_rad(camera, x - width / 2, y - height / 2, steps_px)
    return ways.direction[ways.valid], gap


def ray_places(cells: int, seed: int) -> Floats:
    """(cells, cells, 2) x and y, in cells, at which the renderer's rays cross a square film with one ray a cell.

    The renderer seeds the sampler of each cell with the film's seed times its number of cells, plus the cell's own
    number; the sampler is O'Neill's PCG32, and its first two numbers are the place in the cell.

    References
    ----------
    O'Neill, M. E. (2014). PCG: a family of simple fast space-efficient statistically good algorithms for random number
    generation. Harvey Mudd College, HMC-CS-2014-0905.
    """
    number = (np.uint64(seed % 2**32) * np.uint64(cells**2) + _cell_numbers(cells)) & np.uint64(0xFFFFFFFF)
    multiplier, increment = np.uint64(6364136223846793005), np.uint64((0xDA3E39CB94B95BDB << 1 | 1) % 2**64)
    state = (number + increment) * multiplier + increment
    places = np.empty((cells, cells, 2))
    for axis in range(2):
        word = ((state >> np.uint64(18)) ^ state) >> np.uint64(27) & np.uint64(0xFFFFFFFF)
        turn = state >> np.uint64(59)
        word = (word >> turn | word << (np.uint64(32) - turn & np.uint64(31))) & np.uint64(0xFFFFFFFF)
        places[..., axis] = (word >> np.uint64(9)).astype(np.float64) * 2.0**-23
        state = state * multiplier + increment
    places += np.stack(np.meshgrid(np.arange(cells), np.arange(cells)), axis=-1)
    return places


@lru_cache(maxsize=64)
def _cell_numbers(cells: int) -> NDArray[np.uint64]:
    """(cells, cells) the renderer's number of each cell: blocks in a spiral, and along Morton's curve in each."""
    spiral = mi.Spiral(mi.ScalarVector2u(cells, cells), mi.ScalarVector2u(0, 0), BLOCK_PX, 1)
    x, y = np.meshgrid(np.arange(BLOCK_PX), np.arange(BLOCK_PX))
    morton = np.zeros((BLOCK_PX, BLOCK_PX), dtype=np.uint64)
    for bit in range(BLOCK_PX.bit_length() - 1):
        morton |= (((x >> bit & 1) << 2 * bit) | ((y >> bit & 1) << (2 * bit + 1))).astype(np.uint64)
    numbers = np.empty((cells, cells), dtype=np.uint64)
    for _ in range(spiral.block_count()):
        offset, size, block = spiral.next_block()
        (left, top), (width, height) = (int(v) for v in offset), (int(v) for v in size)
        numbers[top : top + height, left : left + width] = morton[:height, :width] + np.uint64(block * BLOCK_PX**2)
    return numbers


def capture(
    integrator: Any, scene: Any, camera: Camera, *, samples: int, seed: int, window: FilmWindow | None = None
) -> NDArray[np.float64]:
    """(H, W, 4) three channels and alpha, of a window that part; 0 outside of a fisheye's circle. Ctrl-C stops it."""
    if is_assembled(camera):
        return assemble(integrator, scene, camera, samples=samples, seed=seed, window=window)
    image = interruptible(integrator, scene, sensor_of(camera, samples, window), seed, samples)
    return image.astype(np.float64)
