"""Panoramas: equirectangular over the whole sphere, level.

u is longitude to the right, v latitude downwards; the image is 2:1, and its last column neighbours its first. Depth is
the distance along the ray. The poles are above and below the image's middle.

| key | |
|---|---|
| position_m | default: eye level amid the site |
| look | what is in the image's middle: north (default), east, south or west; look_at_m is taken as level |
| size_px | default: [1024, 512] |

camera.json: `model: equirectangular`; pixel = (atan2(x, z) / 2 pi + 1/2) width, (atan2(y, hypot(x, z)) / pi + 1/2)
height.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.cameras import Look
from forestgen.recipe.fields import Point, violation
from forestgen.scene.projection import DeviceRays, Exchange, FileGeometry, Floats, Pixels, Rays
from forestgen.scene.projections.hulls import CurvedProjection, lies_over
from forestgen.scene.spec import Camera


class PanoramaCamera(CameraSection):
    """The whole sphere of directions."""

    default_size_px: ClassVar[tuple[int, int]] = (1024, 512)
    default_look: ClassVar[Look | None] = "north"
    default_place: ClassVar[Point] = (0.5, 0.5, 1.7)
    is_level: ClassVar[bool] = True

    def wrong_optics(self) -> PydanticCustomError | None:
        width, height = self.size_px
        if width == 2 * height:
            return None
        expected, problem = "twice as many pixels across as down: 360 by 180 degrees", "a panorama's image is 2:1"
        got, hint = f"[{width}, {height}]", f"size_px: [{2 * height}, {height}]"
        return violation(expected, problem=problem, got=got, hint=hint, at="size_px")


class Panorama(CurvedProjection):
    """Longitude and latitude."""

    name = "panorama"
    Parameters = PanoramaCamera
    model = "equirectangular"
    wraps_x = True
    exchange = Exchange("EQUIRECTANGULAR", (), has_k=False)

    def rays(self, camera: Camera, x: Floats, y: Floats) -> Rays:
        width, height = camera.size_px
        longitude, latitude = x / width * 2 * np.pi, y / height * np.pi
        direction = np.stack(
            [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], axis=-1
        )
        return Rays(np.zeros((*x.shape, 3)), direction, np.ones(x.shape, dtype=bool))

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> Pixels:
        width, height = camera.size_px
        level = np.hypot(x, z)
        depth = np.hypot(level, y)
        u = np.arctan2(x, z) / (2 * np.pi) * width
        v = np.arctan2(y, level) / np.pi * height  # not by the sine's inverse, which is blind near the poles
        return Pixels(u, v, depth, depth > 0)

    def device_rays(self, camera: Camera, x: Any, y: Any, lens: Any | None, mi: Any, dr: Any) -> DeviceRays:
        width, height = camera.size_px
        sine, cosine = dr.sincos(x * dr.opaque(mi.Float, 2 * np.pi / width))
        up, level = dr.sincos(y * dr.opaque(mi.Float, np.pi / height))
        return DeviceRays(mi.Vector3f(sine * level, up, cosine * level), mi.Float(1.0))

    def pixels_a_radian(self, camera: Camera) -> tuple[float, float]:
        width, height = camera.size_px
        return width / (2 * np.pi), height / np.pi

    def everywhere(self, camera: Camera) -> Floats:
        return np.array([0.0, 0.0, *camera.size_px])

    def stretch_sine(self, seen: Floats, distance_m: Floats) -> Floats:
        return np.asarray(np.hypot(seen[..., 0], seen[..., 2]) / distance_m)

    def torn_boxes(self, camera: Camera, box: Floats, unit: Floats) -> Floats:
        """A hull over a pole is in all columns, up to the border; one across the seam is at both ends."""
        width, height = camera.size_px
        crosses = (box[:, 0] < 0) | (box[:, 2] > width)
        for up, side in ((-1.0, 1), (1.0, 3)):
            over = lies_over(unit, np.array([0.0, up, 0.0]))
            box[over, side] = 0.0 if up < 0 else height
            crosses |= over
        box[crosses, 0], box[crosses, 2] = 0.0, width
        box[:, 1], box[:, 3] = np.maximum(box[:, 1], 0.0), np.minimum(box[:, 3], height)
        return box

    def pixels_per_sr(self, camera: Camera, toward: Floats) -> Floats:
        width, height = camera.size_px
        across_axis = np.hypot(toward[..., 0], toward[..., 2])  # cosine of latitude
        return np.asarray(width * height / (2 * np.pi**2) / np.maximum(across_axis, 1e-9))

    def step_rad(self, camera: Camera, x: Floats, y: Floats, step_px: tuple[float, float]) -> float:
        width, height = camera.size_px
        return float(np.hypot(step_px[0] * 2 * np.pi / width, step_px[1] * np.pi / height))

    def finest_pixel_m(self, camera: Camera, distance_m: Floats) -> Floats:
        # Rows near the poles are stretched: their pixels cover less, and tell no more.
        width, height = camera.size_px
        return distance_m * min(2 * np.pi / width, np.pi / height)

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        return {}

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> FileGeometry:
        width, height = size_px
        focal_px = width / (2 * np.pi)  # the projection itself fits its rows to the height
        return FileGeometry(self.plain_camera(size_px), (focal_px, focal_px), (width / 2, height / 2))


PROJECTION = Panorama()
