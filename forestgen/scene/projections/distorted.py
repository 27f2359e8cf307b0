"""Cameras of real lenses, which bend straight lines: a pinhole with the distortion of Brown (1966) and Conrady (1919).

With a = X / Z and b = Y / Z, r² = a² + b², a point appears f pixels times

    a (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 a b + p2 (r² + 2 a²)
    b (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 b²) + 2 p2 a b

from the image's middle, as in OpenCV, with f = W / 2 / tan(hfov / 2): hfov is that of the lens without distortion.
Rays follow by Newton's method. What lies beyond the r at which a tenth is left of the image's growth is not seen: there
the polynomial, which is fitted to what a lens shows, soon folds the image. Depth is the distance along z.

| key | |
|---|---|
| hfov_deg | field of view across the image's width without distortion, at most 170; default 60 |
| distortion | k1, k2, p1, p2 and k3, in OpenCV's order; those that are left out are 0 |
| position_m | default: eye level, southern edge's middle |
| look_at_m | default: amid the site |
| size_px | default: [640, 360] |

camera.json: `model: opencv` with `hfov_deg`, `K` and `distortion`, as `cv2.projectPoints` takes them.

Reference
---------
Brown, D. C. (1966). Decentering distortion of lenses. Photogrammetric Engineering 32(3), 444-462.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.fields import Number, violation
from forestgen.scene import projection
from forestgen.scene.projection import Floats
from forestgen.scene.spec import Camera

NAMES = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order
_ROUNDS = 60  # of Newton's method; a few are enough but at the edge of what is seen
_EXACT = 1e-15
_LEAST_GROWTH = 0.1  # of r (1 + k1 r² + ...) by r, at the rim of what is seen


class DistortedCamera(CameraSection):
    """A pinhole with a lens' distortion."""

    covers_ground: ClassVar[bool] = True

    hfov_deg: Number = Field(60.0, ge=0.1, le=170, description="Field of view across the width without distortion.")
    distortion: tuple[Number, ...] = Field(
        (), max_length=5, description="k1, k2, p1, p2, k3 as OpenCV has them, the first ones or all."
    )

    def wrong_optics(self) -> PydanticCustomError | None:
        """A distortion that folds the image before its corners, which then show nothing."""
        (width, height), numbers = self.size_px, self.own_numbers
        reach, focal = _reach(numbers), width / 2 / math.tan(math.radians(self.hfov_deg) / 2)
        seen = float(_bent({**numbers, "p1": 0.0, "p2": 0.0}, np.array([reach, 0.0]))[0][0]) * focal
        corner = math.hypot(width, height) / 2
        if corner <= seen:
            return None
        problem, at = "the distortion folds the image before its corners", "distortion"
        expected = f"coefficients under which the image grows up to {corner:.0f} px from its middle"
        hint = "coefficients are fitted for one field of view: check hfov_deg, and their order k1, k2, p1, p2, k3"
        return violation(expected, problem=problem, got=f"up to {seen:.0f} px", hint=hint, at=at)

    @property
    def field_of_view_deg(self) -> float:
        return self.hfov_deg

    @property
    def own_numbers(self) -> Mapping[str, float]:
        return dict(zip(NAMES, (*self.distortion, *[0.0] * 5), strict=False))

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        width, height = self.size_px
        across = 2 * altitude_m * math.tan(math.radians(self.hfov_deg) / 2)
        return across, across * height / width


class Distorted(projection.Projection):
    """Brown's and Conrady's model."""

    name = "distorted"
    Parameters = DistortedCamera
    model = "opencv"
    depth_is_distance = False
    exchange = projection.Exchange("OPENCV", NAMES)

    def rays(self, camera: Camera, x: Floats, y: Floats) -> projection.Rays:
        wanted = np.stack([x, y], axis=-1) / camera.focal_px
        reach = _reach(camera.numbers)
        slope = wanted.copy()
        for _ in range(_ROUNDS):
            at, ((xx, xy), (yx, yy)) = _bent(camera.numbers, slope)
            off = at - wanted
            if np.abs(off).max(initial=0.0) < _EXACT:
                break
            area = xx * yy - xy * yx
            area = np.where(np.abs(area) < 1e-6, 1e-6, area)
            step = np.stack([yy * off[..., 0] - xy * off[..., 1], xx * off[..., 1] - yx * off[..., 0]], axis=-1)
            slope = slope - step / area[..., None]
            away = np.linalg.norm(slope, axis=-1, keepdims=True)
            slope *= np.minimum(1.0, reach / np.maximum(away, 1e-300))  # back to where the map is unique
        off = np.abs(_bent(camera.numbers, slope)[0] - wanted).max(axis=-1)  # not small where nothing is seen
        direction = np.concatenate([slope, np.ones((*x.shape, 1))], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return projection.Rays(np.zeros((*x.shape, 3)), direction, off < 1e-9)

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> projection.Pixels:
        front = z > 0
        slope = np.stack([x, y], axis=-1) / np.where(front, z, 1.0)[..., None]
        near = np.hypot(slope[..., 0], slope[..., 1]) <= _reach(camera.numbers)
        at = camera.focal_px * _bent(camera.numbers, np.where(near[..., None], slope, 0.0))[0]
        return projection.Pixels(at[..., 0], at[..., 1], z, front & near)

    def intrinsics(self, camera: Camera) -> Floats:
        return projection.matrix_k(camera, camera.focal_px)

    def file_keys(self, camera: Camera) -> dict[str, Any]:
        distortion = [float(camera.numbers[name]) for name in NAMES]
        return {"hfov_deg": float(camera.hfov_deg), "K": self.intrinsics(camera).tolist(), "distortion": distortion}

    def read(self, values: Mapping[str, Any], size_px: tuple[int, int]) -> projection.FileGeometry:
        focal_px, centre_px = projection.read_k(values)
        numbers = dict(zip(NAMES, (float(one) for one in values["distortion"]), strict=True))
        hfov_deg = math.degrees(2 * math.atan(size_px[0] / 2 / focal_px[0]))
        camera = self.plain_camera(size_px, hfov_deg, numbers=numbers)
        of_angle = size_px[0] / 2 / math.tan(projection.read_angle_rad(values) / 2)
        return projection.FileGeometry(camera, focal_px, centre_px, of_angle)


_Derivatives = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


def _bent(numbers: Mapping[str, float], slope: Floats) -> tuple[Floats, _Derivatives]:
    """(..., 2) where (..., 2) slopes appear, in focal lengths, and its derivatives by them."""
    k1, k2, p1, p2, k3 = (numbers[name] for name in NAMES)
    a, b = slope[..., 0], slope[..., 1]
    square = a * a + b * b
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    growth = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))  # of `radial`, over the slope
    x = a * radial + 2.0 * p1 * a * b + p2 * (square + 2.0 * a * a)
    y = b * radial + p1 * (square + 2.0 * b * b) + 2.0 * p2 * a * b
    xx = radial + a * a * growth + 2.0 * p1 * b + 6.0 * p2 * a
    yy = radial + b * b * growth + 6.0 * p1 * b + 2.0 * p2 * a
    xy = a * b * growth + 2.0 * p1 * a + 2.0 * p2 * b
    return np.stack([x, y], axis=-1), ((xx, xy), (xy, yy))


def _reach(numbers: Mapping[str, float]) -> float:
    """The slope up to which the image grows with it; a large number where it always does."""
    roots = np.roots([7.0 * numbers["k3"], 5.0 * numbers["k2"], 3.0 * numbers["k1"], 1.0 - _LEAST_GROWTH])
    real = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)].real
    return float(np.sqrt(real.min())) if len(real) else 1e6


PROJECTION = Distorted()
