"""Where plants may be in an image: boxes around their projected hulls. Pure NumPy.

The camera's projection has the boxes: `Projection.hull_boxes`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Hull
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

BEYOND = 16  # image sizes: as far as a box may reach
_POINTS_AT_ONCE = 1 << 19  # scratch memory stays near 30 MB


@dataclass(frozen=True)
class Outlines:
    """One row an instance."""

    window_px: NDArray[np.int32]  # (N, 4) x, y, width, height: pixels of the image that it can touch; 0 where none
    full_box_px: NDArray[np.float64]  # (N, 4) left, top, right, bottom of its projection; NaN: nothing is in front


def outlines(hull: Hull, transform: NDArray[np.float64], camera: Camera) -> Outlines:
    """Project the hull of one exemplar for each of its instances.

    Parameters
    ----------
    transform : (N, 3, 4) exemplar frame -> world, metres.
    """
    box = np.full((len(transform), 4), np.nan)
    anywhere = np.zeros(len(transform), dtype=np.bool_)
    step = max(1, _POINTS_AT_ONCE // max(1, len(hull.vertices_m)))
    for first in range(0, len(transform) if len(hull.vertices_m) else 0, step):
        rows = slice(first, first + step)
        seen = _in_camera(hull.vertices_m, transform[rows], camera)
        box[rows], anywhere[rows] = projection_of(camera).hull_boxes(camera, seen, hull.edges)
    return Outlines(_windows(box, anywhere, camera.size_px), _cut(box, camera.size_px))


def _in_camera(points_m: NDArray[np.float64], transform: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(N, V, 3) points of each instance along the camera's axes, metres."""
    axes = camera.world_from_camera
    linear = np.einsum("ji,njk->nik", axes, transform[:, :, :3])
    place = (transform[:, :, 3] - np.asarray(camera.position_m)) @ axes
    return np.asarray(points_m @ linear.transpose(0, 2, 1) + place[:, None, :])


def _windows(box: NDArray[np.float64], anywhere: NDArray[np.bool_], size_px: tuple[int, int]) -> NDArray[np.int32]:
    """Pixels that boxes touch, one more on each side since directions are rounded to single precision."""
    size = np.asarray(size_px, dtype=np.float64)
    inside = np.where(np.isnan(box), 0.0, box)
    low = np.clip(np.floor(inside[:, :2]) - 1, 0, size)
    high = np.clip(np.ceil(inside[:, 2:]) + 1, 0, size)
    low, high = np.where(anywhere[:, None], 0.0, low), np.where(anywhere[:, None], size, high)
    shown = (high > low).all(axis=1) & (anywhere | ~np.isnan(box[:, 0]))
    window = np.concatenate([low, high - low], axis=1)
    return np.where(shown[:, None], window, 0).astype(np.int32)


def _cut(box: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.float64]:
    """Boxes within BEYOND: a leaf before the lens would reach to infinity, and leave nothing else of `truncation`."""
    limit = BEYOND * np.tile(np.asarray(size_px, dtype=np.float64), 2)
    return np.clip(box, -limit, limit)
