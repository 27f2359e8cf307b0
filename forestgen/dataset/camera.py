"""A camera as files describe it: camera.json in OpenCV's terms, and OpenEXR's standard attributes.

| field of camera.json  | what it is                                                                                |
|-----------------------|-------------------------------------------------------------------------------------------|
| name, model, axes     | the recipe's name; one of the models below; the camera's axes: x right, y down, z forward |
| size_px               | width, height                                                                             |
| camera_from_world     | 4 x 4, for column vectors: world metres (x east, y north, z up) -> the camera's axes      |
| world_from_camera     | its inverse; its last column is position_m                                                |
| position_m            | world                                                                                     |
| sequence, time_s      | the camera path that the frame is of, or null; seconds since its beginning                |
| hfov_deg              | pinhole: horizontal field of view, between the outer borders of the image; fisheye: the   |
|                       | whole angle of the circle, which is as wide as the image                                  |
| K                     | pinhole, fisheye: 3 x 3; pixel centres at +0.5, so the image's centre is width / 2        |
| distortion            | pinhole: OpenCV's k1 k2 p1 p2 k3; fisheye: the k1 k2 k3 k4 of OpenCV's fisheye; all 0     |
| lens                  | of a pinhole with a thin lens: aperture_radius_m, focus_m (of the plane of focus, along z)|
| width_m               | orthographic: of the image, in the world                                                  |

| model                 | pixel (u, v) of a point (x, y, z) in the camera's axes; depth                             |
|-----------------------|-------------------------------------------------------------------------------------------|
| pinhole               | K (x, y, z) / z; along z. With a lens: of the rays through its middle                     |
| orthographic          | (x, y) width / width_m + size / 2, for z > 0; along z                                     |
| fisheye               | equidistant: f theta (x, y) / hypot(x, y) + size / 2 with theta = atan2(hypot(x, y), z)   |
|                       | and f = K[0][0], width / hfov in radians; nothing beyond the circle; along the ray        |
| equirectangular       | (atan2(x, z) / 2 pi + 1/2) width, (atan2(y, hypot(x, z)) / pi + 1/2) height; along the ray|
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.files import write_json
from forestgen.scene.projection import fisheye_focal_px
from forestgen.scene.spec import Camera

_NDC_NEAR_M = 0.1  # of worldToNDC's depth, which readers discard


MODELS = {
    "perspective": "pinhole",
    "orthographic": "orthographic",
    "fisheye": "fisheye",
    "panorama": "equirectangular",
}


def intrinsics(camera: Camera) -> NDArray[np.float64]:
    """(3, 3) K: pixel = K (x, y, z) / z in OpenCV axes, with pixel centres at +0.5; a fisheye's as OpenCV has it.

    Raises
    ------
    ValueError
        For cameras that have none.
    """
    if camera.projection not in ("perspective", "fisheye"):
        raise ValueError(f"a camera of kind {camera.projection} has no matrix K")
    width, height = camera.size_px
    f = camera.focal_px if camera.projection == "perspective" else fisheye_focal_px(camera)
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
        "model": MODELS[camera.projection],
        "axes": "OpenCV: x right, y down, z forward; pixel centres at +0.5",
        "size_px": [int(size) for size in camera.size_px],
        **_projection(camera),
        "camera_from_world": camera_from_world(camera).tolist(),
        "world_from_camera": world_from_camera(camera).tolist(),
        "position_m": [float(x) for x in camera.position_m],
        "sequence": camera.sequence,
        "time_s": float(camera.time_s),
    }


def _projection(camera: Camera) -> dict[str, Any]:
    """What only a model has."""
    if camera.projection == "orthographic":
        return {"width_m": float(camera.width_m)}
    if camera.projection == "panorama":
        return {}
    lens = {} if camera.lens is None else {"lens": asdict(camera.lens)}
    return {
        "hfov_deg": float(camera.hfov_deg),
        "K": intrinsics(camera).tolist(),
        "distortion": [0.0] * (5 if camera.projection == "perspective" else 4),
        **lens,
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
    to bottom, over the display window. Of perspective and orthographic cameras.
    """
    width, height = camera.size_px
    if camera.projection == "orthographic":
        scale = 1.0 / camera.width_m
        projection = np.diag([scale, scale * width / height, 1.0, 1.0])
        projection[:, 3] = 0.5, 0.5, -_NDC_NEAR_M, 1.0
        return _row_vector_matrix(projection @ camera_from_world(camera))
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
    """OpenEXR's ``screenWindowWidth``: width of the view at distance 1, or of parallel rays; 1 where there is none."""
    if camera.projection == "orthographic":
        return float(camera.width_m)
    if camera.projection != "perspective":
        return 1.0
    return 2.0 * float(np.tan(np.radians(camera.hfov_deg) / 2.0))


def exr_attributes(camera: Camera) -> dict[str, Any]:
    """OpenEXR's standard attributes of a camera; no matrix worldToNDC has the curved images of fisheyes, panoramas."""
    flat = camera.projection in ("perspective", "orthographic")
    return {
        "worldToCamera": world_to_camera(camera),
        **({"worldToNDC": world_to_ndc(camera)} if flat else {}),
        **({} if camera.lens is None else {"focus": float(camera.lens.focus_m)}),
        "pixelAspectRatio": 1.0,
        "screenWindowCenter": np.zeros(2, dtype=np.float32),
        "screenWindowWidth": screen_window_width(camera),
    }


def _row_vector_matrix(matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """Transpose, in memory too: OpenEXR's Python module reads a matrix' buffer and ignores its strides."""
    return np.ascontiguousarray(matrix.T, dtype=np.float32)
