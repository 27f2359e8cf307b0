"""Label channels of the surface at each pixel's centre.

- `surface`: positions and normals, and which triangle it is
- `albedo`: reflectance and transmittance
- `sun`: whether the sun's centre is visible from it
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.channels.channel import LabelChannel, Layers, layer, layers
from forestgen.labels.labelled import LabelledFrame
from forestgen.scene.projection import centre_rays, projection_of
from forestgen.scene.spec import Camera


class SurfaceChannel(LabelChannel):
    """Positions, normals and triangles at the pixels' centres."""

    name = "surface"
    units: Mapping[str, str] = {
        "position": "m, world",
        "position.camera": "m, camera's axes",
        "normal": "1, world",
        "normal.camera": "1, camera's axes",
        "normal.shading": "1, world",
        "normal.shading.camera": "1, camera's axes",
    }

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        surface, camera = labelled.frame.surface, labelled.frame.camera
        rotation = camera.world_from_camera
        return {
            "normal": layers("XYZ", surface.normal),
            "normal.camera": layers("XYZ", _turned(surface.normal, rotation)),
            "normal.shading": layers("XYZ", surface.shading_normal),
            "normal.shading.camera": layers("XYZ", _turned(surface.shading_normal, rotation)),
            "position": layers("XYZ", surface.position_m),
            "position.camera": layers("XYZ", camera_position_m(surface.depth_m, camera)),
            "identity": {
                **layer("centre.plant_id", surface.plant_id),
                **layer("centre.part", surface.part),
                **layer("centre.exemplar", surface.exemplar),
                **layer("centre.face", surface.face),
            },
        }


class Albedo(LabelChannel):
    """Reflectance and transmittance of surfaces."""

    name = "albedo"
    units: Mapping[str, str] = {"albedo": "1, linear Rec. 709 (D65)"}

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"albedo": layers("RGB", labelled.frame.surface.albedo)}


class Sun(LabelChannel):
    """Shadows: where the sun is visible."""

    name = "sun"

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"sun": layer("visible", labelled.frame.surface.sun_visible)}


SURFACE, ALBEDO, SUN = SurfaceChannel(), Albedo(), Sun()


def camera_position_m(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) in the camera's axes, of pixel centres: exact far from the world's origin too; NaN for the sky."""
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float64)
    if not projection_of(camera).is_pinhole:
        rays = centre_rays(camera)
        return (rays.origin_m + rays.direction * depth[..., None]).astype(np.float32)
    x, y = camera.pixel_slopes
    return np.stack([depth * x, depth * y[:, None], depth], axis=-1).astype(np.float32)


def _turned(vectors: NDArray[np.float32], world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    return (vectors @ world_from_camera).astype(np.float32)
