"""A recipe's cameras in the world: one for each image, all along their paths and rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.frames import look_at
from forestgen.core.spectrum import Band
from forestgen.recipe.camera_keys import SensorFile
from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.rigs import Orbit, Stereo, Walk
from forestgen.scene.rigs import poses_of
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

    `trunks`: that walks go around; without them they go straight. `bands`: of the sensors that cameras name.
    """
    poses = poses_of(section, height, trunks)
    stereo = section.rig if isinstance(section.rig, Stereo) else None
    sides = (0.0,) if stereo is None else (-stereo.baseline_m / 2, stereo.baseline_m / 2)
    names = section.frame_names
    lens, focus_m = section.lens_mm, section.lens_focus_m
    cameras = []
    for index, (position, target, time_s) in enumerate(
        zip(poses.position_m, poses.target_m, poses.time_s, strict=True)
    ):
        axes = _axes(section, position, target)
        for side, shift_m in enumerate(sides):
            x, y, z = (float(value) for value in (position + shift_m * axes[:, 0] if stereo else position))
            cameras.append(
                Camera(
                    name=names[index * len(sides) + side],
                    position_m=(x, y, z),
                    world_from_camera=axes,
                    size_px=section.size_px,
                    hfov_deg=section.field_of_view_deg,
                    sequence=_sequence(section, side),
                    time_s=float(time_s),
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


def _sequence(section: CameraSection, side: int) -> str | None:
    """Name of the images that follow each other in time; None for stills."""
    if isinstance(section.rig, Stereo):
        return None if section.path is None else f"{section.name}-{('left', 'right')[side]}"
    timed = isinstance(section.rig, Walk) or (isinstance(section.rig, Orbit) and section.rig.frames_per_s is not None)
    return section.name if timed or section.path is not None else None


def next_frame(cameras: Sequence[Camera], camera: Camera) -> Camera | None:
    """The frame that follows `camera` in its sequence; None for a still camera and for a sequence's last frame."""
    if camera.sequence is None:
        return None
    frames = [one for one in cameras if one.sequence == camera.sequence]
    names = [one.name for one in frames]
    after = names.index(camera.name) + 1
    return frames[after] if after < len(frames) else None
