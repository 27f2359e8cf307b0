"""Motion vectors: where each pixel's surface goes until the next frame of a camera's path.

The point that a pixel's centre sees is taken into the frame of its plant's exemplar, from there to where the plant is
in the next frame, and into that frame's image. A point of the ground stays where it is; the sky turns with the camera
alone. The point is built from its distance along the ray, in double precision: what does not move, moves by nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.render.frame import Surface
from forestgen.scene.spec import Camera, Instances

_NEAREST = 1e-6  # of the distance: a point nearer to the next camera's plane than this has no place in its image


def motion_px(
    camera: Camera, surface: Surface, instances: Instances, next_camera: Camera, next_instances: Instances
) -> NDArray[np.float32]:
    """(H, W, 2) way of each pixel's surface point from this image to the next, pixels to the right and down.

    NaN where the point lies behind the next camera. Nothing is said about what then stands in front of it.

    Parameters
    ----------
    surface : what `camera` sees at the pixels' centres, with the plants as in `instances`.
    instances, next_instances : the same plants in the same order, at this frame's time and at the next one's.

    Raises
    ------
    ValueError
        When the next frame has other plants, or the surface shows a plant that is in neither.
    """
    if not np.array_equal(instances.plant_id, next_instances.plant_id):
        raise ValueError("motion needs the same plants in both frames")
    width, height = camera.size_px
    x_px, y_px = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    along = np.stack([*np.meshgrid(*camera.pixel_slopes), np.ones_like(x_px)])
    along /= np.linalg.norm(along, axis=0)
    direction = np.moveaxis(along, 0, -1) @ camera.world_from_camera.T  # (H, W, 3) unit, world
    distance = surface.distance_m.astype(np.float64)
    seen = np.isfinite(distance)
    # Relative to the next camera, all of them: the sky as directions, which no shift changes.
    shift = np.subtract(camera.position_m, next_camera.position_m)
    point = np.where(seen[..., None], direction * np.where(seen, distance, 0.0)[..., None] + shift, direction)
    if next_instances is not instances:
        moved = seen & (surface.plant_id > 0)
        point[moved] += _carried(
            direction[moved] * distance[moved][:, None] + camera.position_m,
            instances.rows_of(surface.plant_id[moved]),
            instances,
            next_instances,
        )
    right, down, depth = np.moveaxis(point @ next_camera.world_from_camera, -1, 0)
    in_front = depth > _NEAREST * np.maximum(np.hypot(right, down), 1e-300)
    safe = np.where(in_front, depth, 1.0)
    next_width, next_height = next_camera.size_px
    motion = np.stack(
        [
            next_camera.focal_px * right / safe + next_width / 2 - x_px,
            next_camera.focal_px * down / safe + next_height / 2 - y_px,
        ],
        axis=-1,
    )
    motion[~in_front] = np.nan
    return motion.astype(np.float32)


def _carried(
    point_m: NDArray[np.float64], row: NDArray[np.intp], now: Instances, then: Instances
) -> NDArray[np.float64]:
    """(M, 3) by how much points of plants move, metres: through the exemplar's frame, (B A^-1 - 1)(p - a) + b - a."""
    a, b = now.transform[:, :, 3], then.transform[:, :, 3]
    change = np.matmul(then.transform[:, :, :3], np.linalg.inv(now.transform[:, :, :3])) - np.eye(3)
    still = np.all(now.transform == then.transform, axis=(1, 2))
    change[still] = 0.0
    return np.asarray(np.einsum("nij,nj->ni", change[row], point_m - a[row]) + (b - a)[row])
