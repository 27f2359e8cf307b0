"""A recipe's cameras in the world: one for each image, all along their paths and rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.frames import look_at
from forestgen.core.spectrum import Band
from forestgen.recipe.camera_keys import SensorFile
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.scene.rigs.rig import Poses, path_poses
from forestgen.scene.spec import Camera, Lens
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks

Floats = NDArray[np.float64]
NO_BANDS: Mapping[SensorFile, tuple[Band, ...]] = {}


def expand(
    section: CameraSection,
    height: HeightField,
    trunks: Trunks | None = None,
    bands: Mapping[SensorFile, tuple[Band, ...]] = NO_BANDS,
) -> list[Camera]:
    """A recipe's camera in the world: one, or one a frame of its path or rig.

    Points of a path are counted as the camera's own: where z is a height above ground, each frame's position and
    look-at point are lifted by the ground under them, so that a camera walks over a hill and not through it.

    Parameters
    ----------
    trunks : that walks go around; without them they go straight.
    bands : of the sensors that cameras name.
    """
    rig = section.rig_part
    poses: Poses = path_poses(section, height) if rig is None else rig.poses(section, height, trunks)
    lens, focus_m = section.lens_mm, section.lens_focus_m
    cameras = []
    for index, name in enumerate(section.frame_names):
        position, target = poses.position_m[index], poses.target_m[index]
        axes = _axes(section, position, target)
        if poses.right_m is not None:
            position = position + poses.right_m[index] * axes[:, 0]
        x, y, z = (float(value) for value in position)
        cameras.append(
            Camera(
                name=name,
                position_m=(x, y, z),
                world_from_camera=axes,
                size_px=section.size_px,
                hfov_deg=section.field_of_view_deg,
                sequence=_sequence(section, index),
                time_s=float(poses.time_s[index]),
                projection=section.kind,
                width_m=section.view_width_m,
                lens=None if lens is None or focus_m is None else Lens(lens[0] / 1000, focus_m),
                bands=() if section.bands is None else bands.get(section.bands, ()),
                exposure=section.exposure,
                numbers=section.own_numbers,
            )
        )
    return cameras


def _axes(section: CameraSection, position_m: Floats, target_m: Floats) -> Floats:
    target = np.array([target_m[0], target_m[1], position_m[2]]) if section.is_level else target_m
    return look_at(position_m.tolist(), target.tolist())


def _sequence(section: CameraSection, index: int) -> str | None:
    """Name of the images that follow each other in time; None for stills."""
    if section.rig is None:
        return None if section.path is None else section.name
    named: str | None = section.rig_part.sequence(section, index)
    return named


def next_frame(cameras: Sequence[Camera], camera: Camera) -> Camera | None:
    """The frame that follows `camera` in its sequence; None for a still camera and for a sequence's last frame."""
    if camera.sequence is None:
        return None
    frames = [one for one in cameras if one.sequence == camera.sequence]
    names = [one.name for one in frames]
    after = names.index(camera.name) + 1
    return frames[after] if after < len(frames) else None
