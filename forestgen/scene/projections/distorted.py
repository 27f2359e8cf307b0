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
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic_core import PydanticCustomError

from forestgen.recipe.cameras import Camera as CameraSection
from forestgen.recipe.fields import Number, violation
from forestgen.scene import projection
from forestgen.scene.projection import Floats
from forestgen.scene.spec import Camera

NAMES = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order
_ROUNDS = 60  # of Newton's method; a few are enough but at the edge of what is seen
_EXACT = 1e-14
_LEAST_GROWTH = 0.1  # of r (1 + k1 r² + ...) by r, at the rim of what is seen
_FARTHEST = 16.0  # slope: 86 degrees from the axis
_LARGEST, _LEAST = 1e3, 1e-12  # coefficient, and one that counts
_PLACES = 33  # along an image's side, where its rays are looked for


class DistortedCamera(CameraSection):
    """A pinhole with a lens' distortion."""

    covers_ground: ClassVar[bool] = True

    hfov_deg: Number = Field(60.0, ge=0.1, le=170, description="Field of view across the width without distortion.")
    distortion: tuple[Annotated[Number, Field(ge=-_LARGEST, le=_LARGEST)], ...] = Field(
        (), max_length=5, description="k1, k2, p1, p2, k3 as OpenCV has them, the first ones or all."
    )

    def wrong_optics(self) -> PydanticCustomError | None:
        """A distortion that folds the image, or shows nothing in some of it."""
        (width, height), numbers, focal = self.size_px, self.own_numbers, self._focal_px
        at = np.stack(np.meshgrid(*(np.linspace(-side / 2, side / 2, _PLACES) for side in (width, height))), axis=-1)
        _, exists = _straight(numbers, at / focal)
        far, turn = np.linspace(0.0, _reach(numbers), 65)[:, None], np.linspace(0.0, 2.0 * np.pi, 65)
        _, ((xx, xy), (yx, yy)) = _bent(numbers, np.stack([far * np.cos(turn), far * np.sin(turn)], axis=-1))
        if exists.all() and (xx * yy > xy * yx).all():
            return None
        problem, expected = "the distortion folds the image", "coefficients under which each pixel has one ray"
        hint = "coefficients are fitted for one field of view: check hfov_deg, and their order k1, k2, p1, p2, k3"
        got = f"{np.mean(~exists):.0%} of the image without" if not exists.all() else "pixels with several"
        return violation(expected, problem=problem, got=got, hint=hint, at="distortion")

    @property
    def _focal_px(self) -> float:
        return self.size_px[0] / 2 / math.tan(math.radians(self.hfov_deg) / 2)

    @property
    def field_of_view_deg(self) -> float:
        return self.hfov_deg

    @property
    def own_numbers(self) -> Mapping[str, float]:
        return dict(zip(NAMES, (*self.distortion, *[0.0] * 5), strict=False))

    def footprint_m(self, altitude_m: float) -> tuple[float, float]:
        edges = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]]) * self.size_px / self._focal_px
        left, right, top, bottom = _straight(self.own_numbers, edges)[0]
        return altitude_m * float(right[0] - left[0]), altitude_m * float(bottom[1] - top[1])


class Distorted(projection.Projection):
    """Brown's and Conrady's model."""

    name = "distorted"
    Parameters = DistortedCamera
    model = "opencv"
    depth_is_distance = False
    exchange = projection.Exchange("OPENCV", NAMES)

    def rays(self, camera: Camera, x: Floats, y: Floats) -> projection.Rays:
        slope, exists = _straight(camera.numbers, np.stack([x, y], axis=-1) / camera.focal_px)
        direction = np.concatenate([slope, np.ones((*x.shape, 1))], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return projection.Rays(np.zeros((*x.shape, 3)), direction, exists)

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
        if not all(abs(one) <= _LARGEST for one in numbers.values()):
            raise ValueError("the distortion is that of no lens")
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


def _straight(numbers: Mapping[str, float], wanted: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(..., 2) slopes that appear at (..., 2) places, in focal lengths, by Newton's method; and which exist."""
    reach, slope = _reach(numbers), wanted.copy()
    last, stalled = np.full(wanted.shape[:-1], np.inf), 0
    for _ in range(_ROUNDS):
        at, ((xx, xy), (yx, yy)) = _bent(numbers, slope)
        off = at - wanted
        worst = np.abs(off).max(axis=-1)
        stalled = 0 if np.any((worst > _EXACT) & (worst < last)) else stalled + 1
        if stalled > 3 or not np.any(worst > _EXACT):  # no nearer: there is no such slope
            break
        last = np.minimum(last, worst)
        area = xx * yy - xy * yx
        area = np.where(np.abs(area) < 1e-6, 1e-6, area)
        step = np.stack([yy * off[..., 0] - xy * off[..., 1], xx * off[..., 1] - yx * off[..., 0]], axis=-1)
        slope = slope - step / area[..., None]
        away = np.linalg.norm(slope, axis=-1, keepdims=True)
        slope *= np.minimum(1.0, reach / np.maximum(away, 1e-300))  # back to where the map is unique
    return slope, np.abs(_bent(numbers, slope)[0] - wanted).max(axis=-1) < 1e-9


def _reach(numbers: Mapping[str, float]) -> float:
    """The slope up to which the image grows with it, at most `_FARTHEST`."""
    growth = np.array([7.0 * numbers["k3"], 5.0 * numbers["k2"], 3.0 * numbers["k1"], 1.0 - _LEAST_GROWTH])
    roots = np.roots(np.where(np.abs(growth) < _LEAST, 0.0, growth))
    real = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)].real
    return min(float(np.sqrt(real.min())), _FARTHEST) if len(real) else _FARTHEST


PROJECTION = Distorted()
