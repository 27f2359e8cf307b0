"""Fisheye cameras: equidistant, up to all around.

theta = r / f from the axis at r pixels from the middle, with f = W / hfov in pixels a radian; no ray beyond the circle
of radius W / 2, which is that of hfov / 2. Depth is the distance along the ray. What is straight behind a fisheye of
360 degrees is to the right.

| key | |
|---|---|
| hfov_deg | the whole angle of the circle, at most 360; default 180: the circle that a square image holds |
| position_m | default: eye level amid the site |
| look | default: up |
| size_px | default: [512, 512] |

camera.json: `model: fisheye` with `hfov_deg`, `K` and `distortion` (the k1 k2 k3 k4 of OpenCV's fisheye, all 0);
pixel = f theta (x, y) / hypot(x, y) + size / 2 with theta = atan2(hypot(x, y), z) and f = K[0][0].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.cameras import Look
from forestgen.recipe.fields import Number, Point
from forestgen.scene import projection
from forestgen.scene.projections.hulls import CurvedProjection, lies_over
from forestgen.scene.spec import Camera


class FisheyeCamera(CameraSection):
    """An equidistant fisheye."""

    default_size_px: ClassVar[tuple[int, int]] = (512, 512)
    default_look: ClassVar[Look | None] = "up"
    default_place: ClassVar[Point] = (0.5, 0.5, 1.7)

    hfov_deg: Number = Field(
        180.0, ge=0.1, le=360, description="Whole angle of the circle, which is as wide as the image, degrees."
    )

    @property
    def field_of_view_deg(self) -> float:
        return self.hfov_deg


class Fisheye(CurvedProjection):
    """Equidistant from the axis."""

    name = "fisheye"
    Parameters = FisheyeCamera
    model = "fisheye"
    is_equidistant = True
    exchange = projection.Exchange("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4"))

    def rays(self, camera: Camera, x: projection.Floats, y: projection.Floats) -> projection.Rays:
        radius = np.hypot(x, y)
        theta = radius / self.focal_px(camera)
        sine = np.divide(np.sin(theta), radius, out=np.zeros_like(radius), where=radius > 0)
        direction = np.stack([x * sine, y * sine, np.cos(theta)], axis=-1)
        # Exact for pixel centres.
        return projection.Rays(
            np.zeros((*x.shape, 3)), direction, np.asarray(x * x + y * y <= (camera.size_px[0] / 2) ** 2)
        )

    def project(
        self, camera: Camera, x: projection.Floats, y: projection.Floats, z: projection.Floats
    ) -> projection.Pixels:
        across = np.hypot(x, y)
        radius = np.arctan2(across, z) * self.focal_px(camera)
        sideways = across > 0
        u = radius * np.divide(x, across, out=np.ones_like(across), where=sideways)
        v = radius * np.divide(y, across, out=np.zeros_like(across), where=sideways)
        depth = np.hypot(across, z)
        # Rounding may carry a point of the circle itself across.
        return projection.Pixels(u, v, depth, (radius <= camera.size_px[0] / 2 * (1 + 1e-12)) & (depth > 0))

    def device_rays(self, camera: Camera, x: Any, y: Any, lens: Any | None, mi: Any, dr: Any) -> projection.DeviceRays:
        radius = dr.sqrt(x * x + y * y)
        sine, cosine = dr.sincos(radius * dr.opaque(mi.Float, 1 / self.focal_px(camera)))
        sine = dr.select(radius > 0, sine / radius, 0.0)
        double = dr.float64_array_t(mi.Float)  # squares of pixels are exact in double precision
        inside = double(x) * double(x) + double(y) * double(y) <= dr.opaque(double, (camera.size_px[0] / 2) ** 2)
        return projection.DeviceRays(mi.Vector3f(x * sine, y * sine, cosine), mi.Float(1.0), None, inside)

    def focal_px(self, camera: Camera) -> float:
        """Pixels a radian."""
        return camera.size_px[0] / float(np.radians(camera.hfov_deg))

    def pixels_a_radian(self, camera: Camera) -> tuple[float, float]:
        return self.focal_px(camera), self.focal_px(camera)

    def everywhere(self, camera: Camera) -> projection.Floats:
        (width, height), reach = camera.size_px, np.pi * self.focal_px(camera)
        return np.array([width / 2 - reach, height / 2 - reach, width / 2 + reach, height / 2 + reach])

    def stretch_sine(self, seen: projection.Floats, distance_m: projection.Floats) -> projection.Floats:
        return np.where(seen[..., 2] < 0, np.hypot(seen[..., 0], seen[..., 1]) / distance_m, 1.0)

    def torn_boxes(self, camera: Camera, box: projection.Floats, unit: projection.Floats) -> projection.Floats:
        """A hull straight behind is in all directions around the circle, out to pi radians."""
        box[lies_over(unit, np.array([0.0, 0.0, -1.0]))] = self.everywhere(camera)
        return box

    def pixels_per_sr(self, camera: Camera, toward: projection.Floats) -> projection.Floats:
        theta = np.arccos(np.clip(toward[..., 2], -1.0, 1.0))
        return np.asarray(self.focal_px(camera) ** 2 / np.maximum(np.sinc(theta / np.pi), 1e-9))

    def step_rad(
        self, camera: Camera, x: projection.Floats, y: projection.Floats, step_px: tuple[float, float]
    ) -> float:
        return float(np.hypot(*step_px)) / self.focal_px(camera)

    def finest_pixel_m(self, camera: Camera, distance_m: projection.Floats) -> projection.Floats:
        # Around the axis a pixel covers sin(theta) / theta of what it covers away from it; 0 straight behind.
        edge = min(np.radians(camera.hfov_deg) / 2, 0.75 * np.pi)
        return np.asarray(distance_m * np.sin(edge) / edge / self.focal_px(camera))

    def intrinsics(self, camera: Camera) -> projection.Floats:
        return projection.matrix_k(camera, self.focal_px(camera))

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        k = self.intrinsics(camera).tolist()
        return {"hfov_deg": float(camera.hfov_deg), "K": k, "distortion": [0.0] * 4}

    def rim_px(self, camera: Camera) -> float:
        return camera.size_px[0] / 2

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> projection.FileGeometry:
        focal_px, centre_px = projection.read_k(values)
        camera = self.plain_camera(size_px, math.degrees(size_px[0] / focal_px[0]))
        return projection.FileGeometry(camera, focal_px, centre_px, size_px[0] / projection.read_angle_rad(values))


PROJECTION = Fisheye()
