"""A recipe's cameras in the world: one for each image, all along their paths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forestgen.core.frames import look_at
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.scene.spec import Camera
from forestgen.scene.terrain import HeightField


def place_cameras(sections: Sequence[CameraSection], height: HeightField) -> tuple[Camera, ...]:
    """The cameras of all images, in the recipe's order, a path's frames in the order of time."""
    return tuple(camera for section in sections for camera in expand(section, height))


def expand(section: CameraSection, height: HeightField) -> list[Camera]:
    """A recipe's camera in the world: one, or one a frame of its path.

    Points of a path are counted as the camera's own: where z is a height above ground, each frame's position and
    look-at point are lifted by the ground under them, so that a camera walks over a hill and not through it.
    """
    points = np.array([section.positions_m, section.looks_at_m], dtype=np.float64)  # (2, frames, 3)
    if section.height_above_ground:
        points[..., 2] += height(points[..., 0], points[..., 1])
    path = section.path
    cameras = []
    for index, name in enumerate(section.frame_names):
        x, y, z = (float(value) for value in points[0, index])
        cameras.append(
            Camera(
                name=name,
                position_m=(x, y, z),
                world_from_camera=look_at(points[0, index], points[1, index]),
                size_px=section.size_px,
                hfov_deg=section.hfov_deg,
                sequence=None if path is None else section.name,
                time_s=0.0 if path is None else index / path.frames_per_s,
            )
        )
    return cameras


def next_frame(cameras: Sequence[Camera], camera: Camera) -> Camera | None:
    """The frame that follows `camera` in its sequence; None for a still camera and for a sequence's last frame."""
    if camera.sequence is None:
        return None
    frames = [one for one in cameras if one.sequence == camera.sequence]
    names = [one.name for one in frames]
    after = names.index(camera.name) + 1
    return frames[after] if after < len(frames) else None
