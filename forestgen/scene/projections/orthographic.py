"""Orthographic cameras: parallel rays, as a map or a satellite's image has them.

x = (u - W / 2) width_m / W. Rays are parallel to z and begin in the plane of the camera, so what has z > 0 is seen and
nothing else. Depth is the distance along z.

| key | |
|---|---|
| width_m | what the image's width shows, metres; needed |
| position_m | default: 100 m above the ground amid the site |
| look | default: down |
| size_px | default: [512, 512] |

camera.json: `model: orthographic` with `width_m`; pixel = (x, y) width / width_m + size / 2 for z > 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.cameras import Look
from forestgen.recipe.fields import Point, Positive, violation
from forestgen.scene.projection import Bools, DeviceRays, FileGeometry, Floats, Pixels, Rays, Sensor
from forestgen.scene.projections.hulls import FlatProjection, extent
from forestgen.scene.spec import Camera


class OrthographicCamera(CameraSection):
    """Parallel rays, as of a map."""

    default_size_px: ClassVar[tuple[int, int]] = (512, 512)
    default_look: ClassVar[Look | None] = "down"
    default_place: ClassVar[Point] = (0.5, 0.5, 100.0)
    covers_ground: ClassVar[bool] = True

    width_m: Positive | None = Field(None, le=1e5, description="Of orthographic: what the image's width shows, metres.")

    def wrong_optics(self) -> PydanticCustomError | None:
        if self.width_m is not None:
            return None
        expected, problem = "the width of what the image shows, metres", "an orthographic camera needs width_m"
        return violation(expected, problem=problem, got="no width_m", at="width_m")

    @property
    def view_width_m(self) -> float:
        return self.width_m or 0.0

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        width, height = self.size_px
        assert self.width_m is not None
        return self.width_m, self.width_m * height / width


class Orthographic(FlatProjection):
    """Parallel rays."""

    name = "orthographic"
    Parameters = OrthographicCamera
    model = "orthographic"
    is_parallel = True
    nearest_m = 0.0  # rays begin in the camera's plane, which cuts exactly

    def rays(self, camera: Camera, x: Floats, y: Floats) -> Rays:
        width, origin = camera.size_px[0], np.zeros((*x.shape, 3))
        origin[..., 0], origin[..., 1] = x * camera.width_m / width, y * camera.width_m / width
        direction = np.zeros_like(origin)
        direction[..., 2] = 1.0
        return Rays(origin, direction, np.ones(x.shape, dtype=bool))

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> Pixels:
        scale = camera.size_px[0] / camera.width_m
        return Pixels(x * scale, y * scale, z, z > 0)

    def device_rays(self, camera: Camera, x: Any, y: Any, lens: Any | None, mi: Any, dr: Any) -> DeviceRays:
        scale = dr.opaque(mi.Float, camera.width_m / camera.size_px[0])
        return DeviceRays(mi.Vector3f(0.0, 0.0, 1.0), mi.Float(1.0), mi.Vector3f(x * scale, y * scale, 0.0))

    def sensor(self, camera: Camera) -> Sensor:
        return Sensor({"type": "orthographic"}, camera.width_m / 2)

    def box_of(self, camera: Camera, seen: Floats) -> Floats:
        width, height = camera.size_px
        scale = width / camera.width_m
        return extent(seen[..., 0] * scale + width / 2, seen[..., 1] * scale + height / 2)

    def around_camera(self, camera: Camera, seen: Floats) -> Bools:
        return np.zeros(len(seen), dtype=np.bool_)

    def finest_pixel_m(self, camera: Camera, distance_m: Floats) -> Floats:
        return np.full(distance_m.shape, camera.width_m / camera.size_px[0])

    def world_to_ndc(self, camera: Camera, near_m: float) -> Floats:
        width, height = camera.size_px
        scale = 1.0 / camera.width_m
        ndc = np.diag([scale, scale * width / height, 1.0, 1.0])
        ndc[:, 3] = 0.5, 0.5, -near_m, 1.0
        return ndc

    def screen_window_width(self, camera: Camera) -> float:
        return float(camera.width_m)

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        return {"width_m": float(camera.width_m)}

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> FileGeometry:
        (width, height), width_m = size_px, float(values["width_m"])
        if not 1e-6 < width_m < 1e9:
            raise ValueError("width_m is no width")
        scale = width / width_m
        return FileGeometry(self.plain_camera(size_px, width_m=width_m), (scale, scale), (width / 2, height / 2))


PROJECTION = Orthographic()
