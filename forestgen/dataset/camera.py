"""A camera as files describe it: camera.json in OpenCV's terms, and OpenEXR's standard attributes.

| field of camera.json  | what it is                                                                                |
|-----------------------|-------------------------------------------------------------------------------------------|
| name, model, axes     | the recipe's name; one of the models below; the camera's axes: x right, y down, z forward |
| size_px               | width, height                                                                             |
| camera_from_world     | 4 x 4, for column vectors: world metres (x east, y north, z up) -> the camera's axes      |
| world_from_camera     | its inverse; its last column is position_m                                                |
| position_m            | world                                                                                     |
| sequence, time_s      | the camera path that the frame is of, or null; seconds since its beginning                |
| optics                | of a camera with an exposure: f_number, and what its lens does to the raw image           |
| motion                | of a camera that moves, see below; null: it stands still                                  |
| hfov_deg, K, ...      | what the model needs: the page of its projection (`forestgen models NAME`) has the keys,  |
|                       | and where a point of the camera's axes appears in the image                               |

| model                 | recipe's kind | depth                                                                     |
|-----------------------|---------------|---------------------------------------------------------------------------|
| pinhole               | perspective   | along z                                                                   |
| orthographic          | orthographic  | along z                                                                   |
| fisheye               | fisheye       | along the ray                                                             |
| equirectangular       | panorama      | along the ray                                                             |

A camera that moves has the pose above in the middle of the image's exposure. `motion` has its `velocity_m_per_s`,
world; its `rotation_deg_per_s` about its own x, y and z; `shutter_s`, for how long each row is exposed; and the middle
of the exposure of row i, counted from 0, at t = `first_row_s` + i `row_step_s`. There, with w in radians,

    position(t) = position_m + t velocity_m_per_s
    world_from_camera(t) = world_from_camera expm(t [w]x)          its columns are the camera's axes

Labels of row i are those of that pose. Light comes from all times within shutter_s / 2 of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.motion import row_times_s, shutter_s
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, CameraMotion

_OPTICS = ("f_number", "vignetting", "falloff", "chromatic_aberration", "blur_px", "veiling_glare")
_NDC_NEAR_M = 0.1  # of worldToNDC's depth, which readers discard


def camera_from_world(camera: Camera) -> NDArray[np.float64]:
    """(4, 4) OpenCV pose for column vectors: world metres -> x right, y down, z forward."""
    pose = np.eye(4)
    rotation = np.asarray(camera.world_from_camera, dtype=np.float64).T
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ np.asarray(camera.position_m)
    return pose


def world_from_camera(camera: Camera) -> NDArray[np.float64]:
    """(4, 4) pose for column vectors: x right, y down, z forward -> world metres."""
    pose = np.eye(4)
    pose[:3, :3] = camera.world_from_camera
    pose[:3, 3] = camera.position_m
    return pose


def camera_model(camera: Camera) -> dict[str, Any]:
    """The content of camera.json, plain values."""
    projection = projection_of(camera)
    optics = None
    if camera.exposure is not None:
        optics = {key: getattr(camera.exposure, key) for key in _OPTICS}
        optics |= {key: list(optics[key]) for key in ("falloff", "chromatic_aberration")}
    return {
        "name": camera.name,
        "model": projection.model,
        "axes": "OpenCV: x right, y down, z forward; pixel centres at +0.5",
        "size_px": [int(size) for size in camera.size_px],
        **projection.file_keys(camera),
        "camera_from_world": camera_from_world(camera).tolist(),
        "world_from_camera": world_from_camera(camera).tolist(),
        "position_m": [float(x) for x in camera.position_m],
        "sequence": camera.sequence,
        "time_s": float(camera.time_s),
        "optics": optics,
        "motion": None if camera.motion is None else _motion(camera, camera.motion),
    }


def _motion(camera: Camera, motion: CameraMotion) -> dict[str, Any]:
    first_s = float(row_times_s(camera)[0]) + 0.0
    return {
        "velocity_m_per_s": list(motion.velocity_m_per_s),
        "rotation_deg_per_s": np.degrees(motion.rotation_rad_per_s).tolist(),
        "readout_s": motion.readout_s,
        "shutter_s": shutter_s(camera),
        "first_row_s": first_s,
        "row_step_s": motion.readout_s / camera.size_px[1],
    }


def world_to_camera(camera: Camera) -> NDArray[np.float32]:
    """(4, 4) OpenEXR's ``worldToCamera``: row vectors, left-handed camera space, x right, y up, z forward.

    OpenEXR, "Standard Attributes": "The camera coordinate space is left-handed [...] The positive z axis indicates
    the camera's viewing direction [...] the same as in Pixar's Renderman."
    """
    flip_y = np.diag([1.0, -1.0, 1.0, 1.0])
    return _row_vector_matrix(flip_y @ camera_from_world(camera))


def world_to_ndc(camera: Camera) -> NDArray[np.float32] | None:
    """(4, 4) OpenEXR's ``worldToNDC``: row vectors; after division by w, x and y run from 0 to 1, left to right and top
    to bottom, over the display window. None: no matrix has the curved images of fisheyes and panoramas.
    """
    ndc = projection_of(camera).world_to_ndc(camera, _NDC_NEAR_M)
    return None if ndc is None else _row_vector_matrix(ndc @ camera_from_world(camera))


def exr_attributes(camera: Camera) -> dict[str, Any]:
    """OpenEXR's standard attributes of a camera."""
    ndc = world_to_ndc(camera)
    return {
        "worldToCamera": world_to_camera(camera),
        **({} if ndc is None else {"worldToNDC": ndc}),
        **({} if camera.lens is None else {"focus": float(camera.lens.focus_m)}),
        "pixelAspectRatio": 1.0,
        "screenWindowCenter": np.zeros(2, dtype=np.float32),
        "screenWindowWidth": projection_of(camera).screen_window_width(camera),
    }


def _row_vector_matrix(matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """Transpose, in memory too: OpenEXR's Python module reads a matrix' buffer and ignores its strides."""
    return np.ascontiguousarray(matrix.T, dtype=np.float32)
