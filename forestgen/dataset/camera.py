"""A camera as files describe it: camera.json in OpenCV's terms, and OpenEXR's standard attributes.

| field of camera.json  | what it is                                                                                |
|-----------------------|-------------------------------------------------------------------------------------------|
| name, model, axes     | the recipe's name; `pinhole`; the camera's axes: x right, y down, z forward               |
| size_px               | width, height                                                                             |
| hfov_deg              | horizontal field of view, between the outer borders of the image                          |
| K                     | 3 x 3: pixel = K (x, y, z) / z; pixel centres at +0.5, so the image's centre is width / 2 |
| distortion            | OpenCV's k1 k2 p1 p2 k3: all 0                                                            |
| camera_from_world     | 4 x 4, for column vectors: world metres (x east, y north, z up) -> the camera's axes      |
| world_from_camera     | its inverse; its last column is position_m                                                |
| position_m            | world                                                                                     |
| sequence, time_s      | the camera path that the frame is of, or null; seconds since its beginning                |
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.files import write_json
from forestgen.scene.spec import Camera

_NDC_NEAR_M = 0.1  # of worldToNDC's depth, which readers discard


def intrinsics(camera: Camera) -> NDArray[np.float64]:
    """(3, 3) K: pixel = K (x, y, z) / z in OpenCV axes, with pixel centres at +0.5."""
    width, height = camera.size_px
    f = camera.focal_px
    return np.array([[f, 0.0, width / 2.0], [0.0, f, height / 2.0], [0.0, 0.0, 1.0]])


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
    """The camera as plain values for JSON."""
    return {
        "name": camera.name,
        "model": "pinhole",
        "axes": "OpenCV: x right, y down, z forward; pixel centres at +0.5",
        "size_px": [int(size) for size in camera.size_px],
        "hfov_deg": float(camera.hfov_deg),
        "K": intrinsics(camera).tolist(),
        "distortion": [0.0] * 5,
        "camera_from_world": camera_from_world(camera).tolist(),
        "world_from_camera": world_from_camera(camera).tolist(),
        "position_m": [float(x) for x in camera.position_m],
        "sequence": camera.sequence,
        "time_s": float(camera.time_s),
    }


def write_camera(path: Path, camera: Camera) -> None:
    """Write camera.json; a failure raises `OutputError`."""
    write_json(path, camera_model(camera))


def world_to_camera(camera: Camera) -> NDArray[np.float32]:
    """(4, 4) OpenEXR's ``worldToCamera``: row vectors, left-handed camera space, x right, y up, z forward.

    References
    ----------
    OpenEXR, "Standard Attributes": "The camera coordinate space is left-handed [...] The positive z axis indicates
    the camera's viewing direction [...] the same as in Pixar's Renderman."
    """
    flip_y = np.diag([1.0, -1.0, 1.0, 1.0])
    return _row_vector_matrix(flip_y @ camera_from_world(camera))


def world_to_ndc(camera: Camera) -> NDArray[np.float32]:
    """(4, 4) OpenEXR's ``worldToNDC``: row vectors; after division by w, x and y run from 0 to 1, left to right and top
    to bottom, over the display window.
    """
    width, height = camera.size_px
    f = camera.focal_px
    projection = np.array(
        [
            [f / width, 0.0, 0.5, 0.0],
            [0.0, f / height, 0.5, 0.0],
            [0.0, 0.0, 1.0, -_NDC_NEAR_M],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    return _row_vector_matrix(projection @ camera_from_world(camera))


def screen_window_width(camera: Camera) -> float:
    """OpenEXR's ``screenWindowWidth``: width of the view at distance 1."""
    return 2.0 * float(np.tan(np.radians(camera.hfov_deg) / 2.0))


def _row_vector_matrix(matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """Transpose, in memory too: OpenEXR's Python module reads a matrix' buffer and ignores its strides."""
    return np.ascontiguousarray(matrix.T, dtype=np.float32)
