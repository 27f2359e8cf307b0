"""A cloud field as bricks, each a medium of its own, for the renderer's volume path tracer.

The renderer steps through a medium by its largest extinction. In one box around all clouds it would look up thousands
of places in clear air; small bricks with a largest value each, and none where there is no cloud, need few.

Decisions
---------
- Between two bricks there is one rectangle, with a medium on either side, or on one where a brick borders on nothing.
  Two boxes that touch leak: a ray that is lifted off the face of one may land inside the other without entering it.
- A brick holds its cells and one more on every side, so that interpolation between two bricks is the same from both; at
  the border of the field the cells at the border once more, as the renderer has it for the whole field.
- A ray that passes a face starts again behind it, by up to 9e-5 of its largest coordinate along the face's normal, and
  what lies between is not counted. Bricks are therefore large where the field has many cells.
- The camera stands in a small sphere of nothing, with the medium outside, which must not cut a face: so faces are
  placed such that the camera is near the middle of its brick.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import largest_in_boxes
from forestgen.core.errors import RenderError
from forestgen.render.build import ray_corners_m
from forestgen.render.sky import phase_function
from forestgen.render.variant import mi
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

SIDE_CELLS = 8  # of a brick
_MOST_BRICKS = 8000  # more make the scene slow to build, and their faces cost more than empty steps
_SHELL_M = 0.01  # around the camera's lens
_AXES = "xyz"
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Bricks:
    """A division of a field's cells into boxes."""

    cuts: tuple[NDArray[np.int64], ...]  # three: first cells of the bricks along x, y and z, and the end
    number: NDArray[np.int64]  # (bricks along x, y, z) number of a brick's medium from 0, -1: there is no cloud in it

    @property
    def count(self) -> int:
        return int(self.number.max()) + 1


def divide(clouds: CloudGrid, place_m: Floats, side_cells: int = SIDE_CELLS) -> Bricks:
    """Bricks of `side_cells` or, where that makes too many, twice as large; `place_m` lies near the middle of one."""
    counts = clouds.extinction_per_m.shape[::-1]
    at = ((place_m - np.asarray(clouds.low_m)) / np.asarray(clouds.cell_m)).clip(-1e6, 1e6)
    while True:
        cuts = tuple(_cuts(count, int(np.floor(one)), side_cells) for count, one in zip(counts, at, strict=True))
        most = largest_in_boxes(clouds.extinction_per_m, [one[:-1] for one in cuts[::-1]])
        cloudy = most.transpose(2, 1, 0) > 0  # or borders on cloud that its interpolation reaches
        if cloudy.sum() <= _MOST_BRICKS:
            break
        side_cells *= 2
    number = np.where(cloudy, np.cumsum(cloudy).reshape(cloudy.shape) - 1, -1)
    return Bricks(cuts, number)


def _cuts(count: int, cell: int, side_cells: int) -> NDArray[np.int64]:
    """First cells of the bricks along an axis, and the end, such that `cell` is the middle of one."""
    first = (cell - side_cells // 2) % side_cells if 0 <= cell < count else 0
    inner = np.arange(first, count, side_cells)
    return np.unique(np.concatenate([[0], inner, [count]])).astype(np.int64)


def brick_shapes(
    clouds: CloudGrid, bricks: Bricks, origin_m: Floats, *, albedo: float | None = None
) -> tuple[dict[str, Any], list[Any]]:
    """Faces of the bricks, Mitsuba's dictionaries by name, and media; `albedo` 0: they only take light away."""
    media = _media(clouds, bricks, origin_m, clouds.albedo if albedo is None else albedo)
    null = mi.load_dict({"type": "null"})
    shapes: dict[str, Any] = {}
    edges = [
        low + np.asarray(cuts) * size - shift
        for low, cuts, size, shift in zip(clouds.low_m, bricks.cuts, clouds.cell_m, origin_m, strict=True)
    ]
    for axis in range(3):
        for (i, j, k), below, above in _faces(bricks.number, axis):
            numbers = {"interior": below, "exterior": above}
            sides = {side: media[number] for side, number in numbers.items() if number >= 0}
            place = _rectangle(edges, axis, (i, j, k))
            shapes[f"face-{_AXES[axis]}-{i}-{j}-{k}"] = {"type": "rectangle", "to_world": place, "bsdf": null, **sides}
    return shapes, media


def _faces(number: NDArray[np.int64], axis: int) -> list[tuple[tuple[int, int, int], int, int]]:
    """Faces across an axis: the brick above each, or the one past the end, and the media below and above."""
    padding = [(0, 0)] * 3
    padding[axis] = (1, 1)
    padded = np.moveaxis(np.pad(number, padding, constant_values=-1), axis, 0)
    below, above = np.moveaxis(padded[:-1], 0, axis), np.moveaxis(padded[1:], 0, axis)
    places = np.argwhere(below != above).tolist()
    return [((i, j, k), int(below[i, j, k]), int(above[i, j, k])) for i, j, k in places]


def _rectangle(edges: list[Floats], axis: int, place: tuple[int, int, int]) -> Any:
    """Transform of Mitsuba's rectangle, (-1, 1) in x and y, its normal z: here along the axis."""
    matrix = np.eye(4)
    matrix[:3, :3] = 0.0
    matrix[axis, 2], matrix[axis, 3] = 1.0, edges[axis][place[axis]]
    for column, other in enumerate(((axis + 1) % 3, (axis + 2) % 3)):
        low, high = edges[other][place[other]], edges[other][place[other] + 1]
        matrix[other, column], matrix[other, 3] = (high - low) / 2, (high + low) / 2
    return mi.ScalarTransform4f(matrix)


def _media(clouds: CloudGrid, bricks: Bricks, origin_m: Floats, albedo: float) -> list[Any]:
    phase = mi.load_dict(phase_function(clouds.phase))
    padded = np.pad(clouds.extinction_per_m, 1, mode="edge")
    low, size = np.asarray(clouds.low_m) - origin_m, np.asarray(clouds.cell_m)
    media: list[Any] = [None] * bricks.count
    for index in np.argwhere(bricks.number >= 0):
        first = np.array([cuts[i] for cuts, i in zip(bricks.cuts, index, strict=True)])
        end = np.array([cuts[i + 1] for cuts, i in zip(bricks.cuts, index, strict=True)]) + 2
        (x, y, z), (x_end, y_end, z_end) = first, end
        values = np.ascontiguousarray(padded[z:z_end, y:y_end, x:x_end, None])
        corner = mi.ScalarTransform4f().translate((low + (first - 1) * size).tolist())
        grid = {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(values),
            "filter_type": "trilinear",
            "to_world": corner.scale(((end - first) * size).tolist()),
        }
        medium = {"type": "heterogeneous", "albedo": albedo, "sigma_t": grid, "phase": phase}
        media[bricks.number[tuple(index)]] = mi.load_dict(medium)
    return media


def camera_shell(clouds: CloudGrid, bricks: Bricks, media: list[Any], camera: Camera) -> dict[str, Any]:
    """Lets a camera stand in a cloud, if there is one. `RenderError`: parallel rays, which start all over a plane."""
    low_m, high_m = np.asarray(clouds.low_m), np.asarray(clouds.high_m)
    if projection_of(camera).is_parallel:
        corners = ray_corners_m(camera)
        if np.all(corners.max(axis=0) >= low_m) and np.all(corners.min(axis=0) <= high_m):
            raise RenderError(
                f"the {camera.projection} camera {camera.name!r} stands in the clouds",
                hint="move it above or below them, or use a perspective camera",
            )
    place = np.asarray(camera.position_m, dtype=np.float64)
    cell = (place - low_m) / np.asarray(clouds.cell_m)
    if np.any(cell <= 0) or np.any(cell >= np.array(clouds.extinction_per_m.shape[::-1])):
        return {}
    index = (int(np.searchsorted(cuts, one, "right")) - 1 for cuts, one in zip(bricks.cuts, cell, strict=True))
    number = bricks.number[tuple(index)]
    if number < 0:
        return {}
    radius = _SHELL_M + (0.0 if camera.lens is None else camera.lens.aperture_radius_m)
    radius = min(radius, max(float(np.min([place - low_m, high_m - place])) / 2, 1e-4))
    null = mi.load_dict({"type": "null"})
    shell = {"type": "sphere", "center": [0.0, 0.0, 0.0], "radius": radius, "bsdf": null}
    return {"camera-shell": shell | {"exterior": media[number]}}
