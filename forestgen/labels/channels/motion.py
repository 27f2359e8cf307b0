"""Label channel `motion`, motion vectors: where each pixel's surface goes until the next frame of a camera's path.

The point that a pixel's centre sees is taken into the frame of its plant's exemplar, from there to where the plant is
in the next frame, and into that frame's image. A point of the ground stays where it is; the sky turns with the camera
alone, and has no motion along the parallel rays of an orthographic camera. The point is built from its distance along
the ray, in double precision: what does not move, moves by nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layers
from forestgen.labels.labelled import LabelledFrame
from forestgen.render.frame import Frame, Surface
from forestgen.scene.projection import in_own_axes, pixel_centres, project, projection_of, world_rays
from forestgen.scene.spec import Camera, Instances

_NEAREST = 1e-6  # of the distance: a point nearer to the next camera's plane than this has no place in its image


class Motion(LabelChannel):
    """Pixels to the next frame."""

    name = "motion"
    units: Mapping[str, str] = {"motion": "px"}

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        """NaN in a sequence's last frame; nothing for a still camera."""
        camera, surface = frame.camera, frame.surface
        if camera.sequence is None:
            return frame
        if view.following is None:
            return replace(frame, motion_px=np.full((*surface.distance_m.shape, 2), np.nan, dtype=np.float32))
        next_camera, next_spec = view.following
        with view.timings(self.name):
            moved = motion_px(camera, surface, view.tracer.spec.instances, next_camera, next_spec.instances)
        return replace(frame, motion_px=moved)

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"motion": layers(("forward.u", "forward.v"), labelled.frame.motion_px)}


CHANNEL = Motion()


def motion_px(
    camera: Camera, surface: Surface, instances: Instances, next_camera: Camera, next_instances: Instances
) -> NDArray[np.float32]:
    """(H, W, 2) way of each pixel's surface point from this image to the next, pixels to the right and down.

    NaN where the next camera cannot see the point: it lies behind it, or outside of a fisheye's circle. Nothing is said
    about what then stands in front of it. In a panorama the way is the shorter one around.

    Parameters
    ----------
    surface : what `camera` sees at the pixels' centres, with the plants as in `instances`.
    instances, next_instances : the same plants in the same order, at this frame's time and at the next one's.

    Other plants in the next frame, or on the surface, raise `ValueError`.
    """
    if not np.array_equal(instances.plant_id, next_instances.plant_id):
        raise ValueError("motion needs the same plants in both frames")
    centre = pixel_centres(camera.size_px)
    rays = world_rays(camera)
    distance = surface.distance_m.astype(np.float64)
    seen = np.isfinite(distance)
    # Relative to the next camera, all of them: the sky as directions, which no shift changes.
    shift = rays.origin_m - np.asarray(next_camera.position_m)
    way = rays.direction * np.where(seen, distance, 0.0)[..., None]
    point = np.where(seen[..., None], way + shift, rays.direction)
    if next_instances is not instances:
        moved = seen & (surface.plant_id > 0)
        start = np.broadcast_to(rays.origin_m, point.shape)[moved]
        row = instances.rows_of(surface.plant_id[moved])
        point[moved] += _carried(way[moved] + start, row, instances, next_instances)
    landing, known = _landing(next_camera, in_own_axes(next_camera, point, seen), seen)
    motion = landing - centre
    if projection_of(next_camera).wraps_x:
        motion[..., 0] -= next_camera.size_px[0] * np.round(motion[..., 0] / next_camera.size_px[0])
    motion[~(known & rays.valid)] = np.nan
    return np.asarray(motion, dtype=np.float32)


def _landing(
    camera: Camera, points_m: NDArray[np.float64], near: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(H, W, 2) image points of (H, W, 3) points in the camera's axes, and whether they have one.

    `near` is False for the sky, of which there is a direction alone: parallel rays have no place for it.
    """
    projection = projection_of(camera)
    if not projection.is_pinhole:
        found = project(camera, points_m)
        known = found.in_front & (near | (not projection.is_parallel))
        return np.stack([found.x_px, found.y_px], axis=-1), known
    right, down, depth = np.moveaxis(points_m, -1, 0)
    in_front = depth > _NEAREST * np.maximum(np.hypot(right, down), 1e-300)
    safe = np.where(in_front, depth, 1.0)
    width, height = camera.size_px
    at = (camera.focal_px * right / safe + width / 2, camera.focal_px * down / safe + height / 2)
    return np.stack(at, axis=-1), in_front


def _carried(
    point_m: NDArray[np.float64], row: NDArray[np.intp], now: Instances, then: Instances
) -> NDArray[np.float64]:
    """(M, 3) by how much points of plants move, metres: through the exemplar's frame, (B A^-1 - 1)(p - a) + b - a."""
    a, b = now.transform[:, :, 3], then.transform[:, :, 3]
    change = np.matmul(then.transform[:, :, :3], np.linalg.inv(now.transform[:, :, :3])) - np.eye(3)
    still = np.all(now.transform == then.transform, axis=(1, 2))
    change[still] = 0.0
    return np.asarray(np.einsum("nij,nj->ni", change[row], point_m - a[row]) + (b - a)[row])
