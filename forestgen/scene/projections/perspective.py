"""Perspective cameras: a pinhole, or a thin lens that blurs what is off its plane of focus.

x / z = (u - W / 2) / f, with f = W / 2 / tan(hfov / 2). Depth is the distance along z.

Through a point l of a thin lens a point (x, z) appears at f (x / z - l (1 / z - 1 / focus)): for each l that is a
pinhole's image, so the extremes over a hull and the lens are at the hull's vertices and the lens' rim.

| key | |
|---|---|
| hfov_deg | field of view across the image's width, at most 170; default 60 |
| focal_length_mm, sensor_width_mm | instead of hfov_deg; the sensor's default is 36 |
| f_number, focus_m | a thin lens, and the distance of the plane that it shows sharply |
| position_m | default: eye level, southern edge's middle |
| look_at_m | default: amid the site |
| size_px | default: [640, 360] |

camera.json: `model: pinhole` with `hfov_deg`, `K`, `distortion` (OpenCV's k1 k2 p1 p2 k3, all 0) and, of a thin lens,
`lens`; pixel = K (x, y, z) / z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.fields import Number, Positive, violation
from forestgen.scene import projection
from forestgen.scene.projections.hulls import FlatProjection, extent
from forestgen.scene.spec import Camera

_FULL_FRAME_MM = 36.0
_WIDEST_DEG = 170.0
_DEFAULT_DEG = 60.0


class PerspectiveCamera(CameraSection):
    """A pinhole, or a thin lens."""

    covers_ground: ClassVar[bool] = True
    has_lens: ClassVar[bool] = True

    hfov_deg: Number | None = Field(
        None,
        ge=0.1,
        le=360,
        description="Field of view across the image's width, degrees: of perspective (default 60, at most 170) and "
        "fisheye (default 180: the circle that a square image holds).",
    )
    focal_length_mm: Positive | None = Field(
        None, le=10_000, description="Of perspective, instead of hfov_deg; with sensor_width_mm."
    )
    sensor_width_mm: Positive | None = Field(
        None, le=1000, description="Of perspective: what the image's width is on. Default: 36."
    )
    f_number: Positive | None = Field(
        None, ge=0.5, le=1000, description="Of perspective, with focus_m: a thin lens, its focal length by this wide."
    )
    focus_m: Positive | None = Field(
        None, le=1e5, description="Distance of the plane that a thin lens shows sharply, metres."
    )

    @model_validator(mode="before")
    @classmethod
    def _has_an_angle(cls, data: Any) -> Any:
        """The field of view, and the f-number that lens and exposure share."""
        if not isinstance(data, Mapping):
            return data
        filled = dict(data)
        if filled.get("hfov_deg") is None and filled.get("focal_length_mm") is None:
            filled["hfov_deg"] = _DEFAULT_DEG
        exposure, f_number = data.get("exposure"), data.get("f_number")
        if isinstance(exposure, Mapping) and f_number is not None:
            filled["exposure"] = {"f_number": f_number, **exposure}
        return filled

    def wrong_optics(self) -> PydanticCustomError | None:
        if self.hfov_deg is not None and self.focal_length_mm is not None:
            other = _field_of_view_deg(self.focal_length_mm, self.sensor_mm)
            problem, hint, at = "the field of view is given twice", "leave hfov_deg out", "focal_length_mm"
            got = f"hfov_deg {self.hfov_deg:g}; {self.focal_length_mm:g} mm are {other:.4g} degrees"
            return violation("hfov_deg or focal_length_mm, not both", problem=problem, got=got, hint=hint, at=at)
        if self.field_of_view_deg > _WIDEST_DEG:
            expected, got = f"at most {_WIDEST_DEG:g} degrees", f"{self.field_of_view_deg:.4g} degrees"
            problem, hint = "too wide for a flat image", "kind: fisheye sees further around"
            at = "hfov_deg" if self.hfov_deg is not None else "focal_length_mm"
            return violation(expected, problem=problem, got=got, hint=hint, at=at)
        return self._wrong_lens()

    def _wrong_lens(self) -> PydanticCustomError | None:
        lens, exposure = self.lens_mm, self.exposure
        if (self.f_number is None) != (self.focus_m is None):
            has, lacks = ("f_number", "focus_m") if self.focus_m is None else ("focus_m", "f_number")
            expected = "both, or neither for a pinhole, which is sharp everywhere"
            hint = "exposure.f_number makes a picture brighter and blurs nothing" if lacks == "focus_m" else None
            problem = f"a lens with {has} needs {lacks} too"
            return violation(expected, problem=problem, got=f"no {lacks}", hint=hint, at=has)
        if lens is not None and self.focus_m is not None and self.focus_m * 1000 <= lens[1]:
            expected, got = f"more than its focal length, {lens[1]:.4g} mm", f"{self.focus_m:g} m"
            return violation(expected, problem="no lens focuses so near", got=got, at="focus_m")
        if self.f_number is not None and exposure is not None and exposure.f_number != self.f_number:
            expected = f"the lens' own f_number, {self.f_number:g}, or none in the exposure"
            got, at = f"{exposure.f_number:g}", ("exposure", "f_number")
            return violation(expected, problem="one lens has two f-numbers", got=got, at=at)
        return None

    @property
    def field_of_view_deg(self) -> float:
        if self.hfov_deg is not None:
            return self.hfov_deg
        return 0.0 if self.focal_length_mm is None else _field_of_view_deg(self.focal_length_mm, self.sensor_mm)

    @property
    def lens_mm(self) -> tuple[float, float] | None:
        if self.f_number is None:
            return None
        focal = self.focal_length_mm
        if focal is None:
            focal = self.sensor_mm / 2 / math.tan(math.radians(self.field_of_view_deg) / 2)
        return focal / self.f_number / 2, focal

    @property
    def lens_focus_m(self) -> float | None:
        return self.focus_m

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        width, height = self.size_px
        across = 2 * altitude_m * math.tan(math.radians(self.field_of_view_deg) / 2)
        return across, across * height / width

    @property
    def sensor_mm(self) -> float:
        """Width of the sensor."""
        return _FULL_FRAME_MM if self.sensor_width_mm is None else self.sensor_width_mm


def _field_of_view_deg(focal_length_mm: float, sensor_width_mm: float) -> float:
    return math.degrees(2 * math.atan(sensor_width_mm / 2 / focal_length_mm))


class Perspective(FlatProjection):
    """A pinhole, or a thin lens."""

    name = "perspective"
    Parameters = PerspectiveCamera
    model = "pinhole"
    is_pinhole = True
    nearest_m = 1e-3
    exchange = projection.Exchange("OPENCV", ("k1", "k2", "p1", "p2"))

    def rays(self, camera: Camera, x: projection.Floats, y: projection.Floats) -> projection.Rays:
        direction = np.stack([x / camera.focal_px, y / camera.focal_px, np.ones_like(x)], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return projection.Rays(np.zeros((*x.shape, 3)), direction, np.ones(x.shape, dtype=bool))

    def project(
        self, camera: Camera, x: projection.Floats, y: projection.Floats, z: projection.Floats
    ) -> projection.Pixels:
        seen = z > 0
        safe = np.where(seen, z, 1.0)
        return projection.Pixels(x / safe * camera.focal_px, y / safe * camera.focal_px, z, seen)

    def device_rays(self, camera: Camera, x: Any, y: Any, lens: Any | None, mi: Any, dr: Any) -> projection.DeviceRays:
        # In single precision throughout.
        scale = dr.opaque(mi.Float, float(np.float32(1) / np.float32(camera.focal_px)))
        slope = mi.Vector3f(x * scale, y * scale, 1.0)
        if camera.lens is None or lens is None:
            along = dr.normalize(slope)
            return projection.DeviceRays(along, along.z)
        across = lens * dr.opaque(mi.Float, camera.lens.aperture_radius_m)
        start = mi.Vector3f(across.x, across.y, 0.0)
        along = dr.normalize(slope * dr.opaque(mi.Float, camera.lens.focus_m) - start)
        return projection.DeviceRays(along, along.z, start)

    def sensor(self, camera: Camera) -> projection.Sensor:
        angle = {"fov": camera.hfov_deg, "fov_axis": "x"}
        if camera.lens is None:
            return projection.Sensor({"type": "perspective", **angle})
        lens = {"aperture_radius": camera.lens.aperture_radius_m, "focus_distance": camera.lens.focus_m}
        return projection.Sensor({"type": "thinlens", **angle, **lens})

    def box_of(self, camera: Camera, seen: projection.Floats) -> projection.Floats:
        width, height = camera.size_px
        x = seen[..., 0] / seen[..., 2] * camera.focal_px + width / 2
        y = seen[..., 1] / seen[..., 2] * camera.focal_px + height / 2
        if camera.lens is None:
            return extent(x, y)
        blur = np.abs(1 / seen[..., 2] - 1 / camera.lens.focus_m) * camera.lens.aperture_radius_m * camera.focal_px
        low, high = ([(axis + sign * blur) for axis in (x, y)] for sign in (-1, 1))
        return np.stack([*(axis.min(axis=1) for axis in low), *(axis.max(axis=1) for axis in high)], axis=1)

    def around_camera(self, camera: Camera, seen: projection.Floats) -> projection.Bools:
        width, height = camera.size_px
        reach = self.nearest_m * max(1.0, max(width, height) / 2 / camera.focal_px) * 2
        if camera.lens is not None:
            reach += camera.lens.aperture_radius_m
        return np.asarray(((seen.min(axis=1) < reach) & (seen.max(axis=1) > -reach)).all(axis=1))

    def finest_pixel_m(self, camera: Camera, distance_m: projection.Floats) -> projection.Floats:
        # Pixels of a flat image cover least at its corners, where the depth is least for the same distance.
        width, height = camera.size_px
        corner = np.hypot(width, height) / 2.0 / camera.focal_px
        return np.asarray(distance_m / np.hypot(1.0, corner) / camera.focal_px)

    def intrinsics(self, camera: Camera) -> projection.Floats:
        return projection.matrix_k(camera, camera.focal_px)

    def world_to_ndc(self, camera: Camera, near_m: float) -> projection.Floats:
        (width, height), f = camera.size_px, camera.focal_px
        return np.array(
            [[f / width, 0.0, 0.5, 0.0], [0.0, f / height, 0.5, 0.0], [0.0, 0.0, 1.0, -near_m], [0.0, 0.0, 1.0, 0.0]]
        )

    def screen_window_width(self, camera: Camera) -> float:
        return 2.0 * float(np.tan(np.radians(camera.hfov_deg) / 2.0))

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        lens = {} if camera.lens is None else {"lens": asdict(camera.lens)}
        k = self.intrinsics(camera).tolist()
        return {"hfov_deg": float(camera.hfov_deg), "K": k, "distortion": [0.0] * 5, **lens}

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> projection.FileGeometry:
        focal_px, centre_px = projection.read_k(values)
        of_angle = (
            None if values.get("hfov_deg") is None else size_px[0] / 2 / math.tan(projection.read_angle_rad(values) / 2)
        )
        camera = self.plain_camera(size_px, _field_of_view_deg(focal_px[0], size_px[0]))
        return projection.FileGeometry(camera, focal_px, centre_px, of_angle)


PROJECTION = Perspective()
