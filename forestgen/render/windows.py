"""Where plants may be in an image: boxes around their projected hulls. Pure NumPy.

A convex hull's projection bounds its mesh's, as long as it lies in front of the camera. What reaches behind is cut by a
plane NEAR_M in front of it. Nothing of a plant that stays clear of the camera's own surroundings is lost from the image
by that; a plant that does not may be anywhere. Parallel rays begin in the camera's plane, which cuts exactly.

Through a point l of a thin lens a point (x, z) appears at f (x / z - l (1 / z - 1 / focus)): for each l that is a
pinhole's image, so the extremes over the hull and the lens are at the hull's vertices and the lens' rim.

Curved images, of fisheyes and panoramas, bend the hull's edges; `render.curved_windows` has their boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.hull import Hull
from forestgen.render.curved_windows import curved_boxes
from forestgen.scene.spec import Camera

NEAR_M = 1e-3
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
        if camera.projection in ("fisheye", "panorama"):
            box[rows], anywhere[rows] = curved_boxes(seen, hull.edges, camera)
        else:
            box[rows], anywhere[rows] = _boxes(seen, hull.edges, camera), _around_camera(seen, camera)
    return Outlines(_windows(box, anywhere, camera.size_px), _cut(box, camera.size_px))


def _in_camera(points_m: NDArray[np.float64], transform: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(N, V, 3) points of each instance along the camera's axes, metres."""
    axes = camera.world_from_camera
    linear = np.einsum("ji,njk->nik", axes, transform[:, :, :3])
    place = (transform[:, :, 3] - np.asarray(camera.position_m)) @ axes
    return np.asarray(points_m @ linear.transpose(0, 2, 1) + place[:, None, :])


def _boxes(seen: NDArray[np.float64], edges: NDArray[np.int64], camera: Camera) -> NDArray[np.float64]:
    """(N, 4) left, top, right, bottom in pixels."""
    nearest = 0.0 if camera.projection == "orthographic" else NEAR_M
    front = seen[..., 2] >= nearest
    whole, some = front.all(axis=1), front.any(axis=1)
    box = np.full((len(seen), 4), np.nan)
    box[whole] = _box_of(seen[whole], camera)
    for row in np.flatnonzero(some & ~whole):
        points = seen[row]
        crossing = edges[front[row, edges[:, 0]] != front[row, edges[:, 1]]]
        a, b = points[crossing[:, 0]], points[crossing[:, 1]]
        share = (nearest - a[:, 2]) / (b[:, 2] - a[:, 2])
        cut = a + share[:, None] * (b - a)
        cut[:, 2] = nearest
        box[row] = _box_of(np.concatenate([points[front[row]], cut])[None], camera)[0]
    return box


def _box_of(seen: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(N, 4) of (N, V, 3) points in front of the camera."""
    width, height = camera.size_px
    if camera.projection == "orthographic":
        scale = width / camera.width_m
        x, y = seen[..., 0] * scale + width / 2, seen[..., 1] * scale + height / 2
        return np.stack([x.min(axis=1), y.min(axis=1), x.max(axis=1), y.max(axis=1)], axis=1)
    x = seen[..., 0] / seen[..., 2] * camera.focal_px + width / 2
    y = seen[..., 1] / seen[..., 2] * camera.focal_px + height / 2
    if camera.lens is None:
        return np.stack([x.min(axis=1), y.min(axis=1), x.max(axis=1), y.max(axis=1)], axis=1)
    blur = np.abs(1 / seen[..., 2] - 1 / camera.lens.focus_m) * camera.lens.aperture_radius_m * camera.focal_px
    low, high = ([(axis + sign * blur) for axis in (x, y)] for sign in (-1, 1))
    return np.stack([*(axis.min(axis=1) for axis in low), *(axis.max(axis=1) for axis in high)], axis=1)


def _around_camera(seen: NDArray[np.float64], camera: Camera) -> NDArray[np.bool_]:
    """(N,) the instance's box holds a point of the view nearer than NEAR_M: it may be seen in any pixel."""
    if camera.projection == "orthographic":
        return np.zeros(len(seen), dtype=np.bool_)
    width, height = camera.size_px
    reach = NEAR_M * max(1.0, max(width, height) / 2 / camera.focal_px) * 2
    if camera.lens is not None:
        reach += camera.lens.aperture_radius_m
    return np.asarray(((seen.min(axis=1) < reach) & (seen.max(axis=1) > -reach)).all(axis=1))


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
