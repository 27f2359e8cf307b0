"""Where a camera is while its shutter is open: motion blur, and rolling shutters.

The camera's pose is that of the middle of the exposure of the image's middle. At the time t before or after, seconds,

    place    p + v t              v: metres a second, world
    axes     A exp(t [w]x)        columns of A: right, down, forward; w: radians a second about them; Rodrigues' formula

Row i of H is exposed from t_i - T/2 to t_i + T/2, T the shutter's time, with

    t_i = ((i + 1/2) / H - 1/2) readout

0 of a shutter that exposes all rows together. Light takes times spread over the exposure of its row. Labels are those
of t_i, the middle of it. Plants stand still meanwhile. Beyond the image, rows are those of its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]
_DIM_CD_M2 = 100.0  # a forest under dense clouds: for how long a metered shutter may be open, before it is metered


def is_rolling(camera: Camera) -> bool:
    """Whether rows of the image have poses of their own."""
    return camera.motion is not None and camera.motion.readout_s > 0


def shutter_s(camera: Camera, luminance_cd_m2: float = _DIM_CD_M2) -> float:
    """How long the shutter is open; of one that is not yet metered, at a mean luminance."""
    return 0.0 if camera.exposure is None else camera.exposure.shutter_for_s(luminance_cd_m2)


def row_times_s(camera: Camera, row_px: Floats | None = None) -> Floats:
    """(...) middle of the exposure at image points (...) by their height, 0.5 in the first row's middle; None: (H,)."""
    height = camera.size_px[1]
    rows = np.arange(height) + 0.5 if row_px is None else np.clip(row_px, 0.5, height - 0.5)
    return (rows / height - 0.5) * (0.0 if camera.motion is None else camera.motion.readout_s)


def poses_at(camera: Camera, time_s: Floats) -> tuple[Floats, Floats]:
    """(..., 3) places less the camera's own, and (..., 3, 3) axes, world, at (...) times."""
    motion, axes = camera.motion, np.asarray(camera.world_from_camera, dtype=np.float64)
    assert motion is not None
    time = np.asarray(time_s, dtype=np.float64)[..., None]
    turn = np.asarray(motion.rotation_rad_per_s, dtype=np.float64)
    speed = float(np.linalg.norm(turn))
    x, y, z = turn / (speed or 1.0)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = speed * time[..., None]
    turned = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return time * np.asarray(motion.velocity_m_per_s), axes @ turned


def row_poses(camera: Camera, rows: slice | None = None) -> tuple[Floats, Floats]:
    """(3,) and (3, 3), or of a rolling shutter (R, 1, 3) and (R, 3, 3): places less the camera's own, and axes."""
    if not is_rolling(camera):
        return np.zeros(3), np.asarray(camera.world_from_camera, dtype=np.float64)
    place, axes = poses_at(camera, row_times_s(camera)[rows or slice(None)])
    return place[:, None], axes


def still_at(camera: Camera, time_s: float) -> Camera:
    """The camera as it stands at a time."""
    place, axes = poses_at(camera, np.asarray(time_s))
    x, y, z = (float(own + way) for own, way in zip(camera.position_m, place, strict=True))
    return replace(camera, position_m=(x, y, z), world_from_camera=axes, motion=None)


def with_their_ways(cameras: Sequence[Camera]) -> list[Camera]:
    """The cameras, and for each that moves where it is in the first and the last moment of its image."""
    found = []
    for camera in cameras:
        found.append(camera)
        if camera.motion is not None:
            half = 0.5 * (camera.motion.readout_s + shutter_s(camera))
            found += [still_at(camera, -half), still_at(camera, half)]
    return found
