"""camera.json and the geometry of its models, computed anew: where pixels look, and where points appear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, UnreadableError

PINHOLE, ORTHOGRAPHIC, FISHEYE, PANORAMA = "pinhole", "orthographic", "fisheye", "equirectangular"

# What a model needs beside its size and pose, and how it is written.
_NEEDS = {PINHOLE: ("K",), ORTHOGRAPHIC: ("width_m",), FISHEYE: ("K", "hfov_deg"), PANORAMA: ()}


@dataclass(frozen=True)
class CameraFile:
    """camera.json, as far as checks use it."""

    size_px: tuple[int, int]
    model: str
    focal_px: tuple[float, float]  # along x and y; pixels a radian of a panorama, pixels a metre of parallel rays
    centre_px: tuple[float, float]
    widest_rad: float  # of a fisheye: from its axis to its circle
    camera_from_world: NDArray[np.float64]  # (4, 4)
    position_m: NDArray[np.float64]  # (3,) world
    values: Mapping[str, Any]  # all of it

    @property
    def rotation(self) -> NDArray[np.float64]:
        return self.camera_from_world[:3, :3]

    @property
    def along_axis(self) -> bool:
        """Whether depth runs along the camera's axis, not along the ray."""
        return self.model in (PINHOLE, ORTHOGRAPHIC)

    def project(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(..., 2) pixels and (...) depths of (..., 3) world points; what is not in front has no positive depth."""
        return self.project_own(points_m @ self.rotation.T + self.camera_from_world[:3, 3])

    def project_own(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same of points in the camera's axes."""
        z = points_m[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.model == PINHOLE:
                flat, depth = points_m[..., :2] / z[..., None], z
            elif self.model == ORTHOGRAPHIC:
                flat, depth = points_m[..., :2], z
            else:
                depth = np.sqrt((points_m**2).sum(axis=-1))
                flat, angle = self._angles(points_m, depth)
                # Rounding at the circle itself is judged by whoever asks.
                depth = np.where(angle > self.widest_rad, -depth, depth)
        return flat * self.focal_px + self.centre_px, depth

    def _angles(
        self, points_m: NDArray[np.float64], distance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(..., 2) coordinates in radians, and (...) angles from the axis."""
        x, y, z = np.moveaxis(points_m, -1, 0)
        if self.model == PANORAMA:
            level = np.sqrt(x * x + z * z)
            return np.stack([np.angle(z + 1j * x), np.angle(level + 1j * y)], axis=-1), np.zeros(x.shape)
        aside = x + 1j * y
        # Half angles: 2 atan2(|a - b|, |a + b|) of the axis and the direction, exact at both ends.
        angle = 2 * np.arctan2(
            np.sqrt(np.abs(aside) ** 2 + (distance - z) ** 2), np.sqrt(np.abs(aside) ** 2 + (distance + z) ** 2)
        )
        turn = np.where(aside == 0, 1.0, aside / np.where(aside == 0, 1.0, np.abs(aside)))
        return np.stack([turn.real * angle, turn.imag * angle], axis=-1), angle

    def own_rays(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) in the camera's axes, through the pixels' centres, of depth 1."""
        flat = self._flat(size_px)
        x, y = flat[..., 0], flat[..., 1]
        if self.model == PINHOLE:
            return np.stack([x, y, np.ones_like(x)], axis=-1)
        if self.model == ORTHOGRAPHIC:
            return np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)], axis=-1)
        if self.model == PANORAMA:
            return np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], axis=-1)
        angle = np.sqrt(x * x + y * y)
        sine = np.sinc(angle / np.pi)  # sin(angle) / angle
        return np.stack([x * sine, y * sine, np.cos(angle)], axis=-1)

    def pixel_rays(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """The same in world directions."""
        return np.asarray(self.own_rays(size_px) @ self.rotation)  # rows times R = R^T times columns: camera -> world

    def starts(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) world, from the camera's place to where the pixels' rays begin."""
        if self.model != ORTHOGRAPHIC:
            return np.zeros((size_px[1], size_px[0], 3))
        flat = self._flat(size_px)
        return np.asarray(np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1) @ self.rotation)

    def sees(self, size_px: tuple[int, int]) -> NDArray[np.bool_]:
        """(H, W) whether a pixel's centre has a ray: all but those outside of a fisheye's circle."""
        if self.model != FISHEYE:
            return np.ones(size_px[::-1], dtype=np.bool_)
        return np.asarray(self.radius(size_px) <= self.size_px[0] / 2)

    def radius(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W) pixels from the centre of the image to those of its pixels."""
        away = _pixels(size_px) - self.centre_px
        return np.asarray(np.sqrt((away**2).sum(axis=-1)))

    def pixels_a_metre(self, depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """How large things appear at a depth."""
        return np.asarray(self.focal_px[0] / (np.ones_like(depth_m) if self.model == ORTHOGRAPHIC else depth_m))

    def _flat(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 2) of the pixels' centres: slopes, metres or radians."""
        return np.asarray((_pixels(size_px) - self.centre_px) / self.focal_px)


def _pixels(size_px: tuple[int, int]) -> NDArray[np.float64]:
    """(H, W, 2) centres."""
    width, height = size_px
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def camera_of(values: Any, file: str) -> CameraFile:
    """Read camera.json's fields; what is missing or no matrix raises `UnreadableError`."""
    try:
        size = [int(side) for side in values["size_px"]]
        pose = _matrix(values["camera_from_world"], (4, 4))
        position = _matrix(values["position_m"], (3,))
        model = str(values.get("model", PINHOLE))
        if len(size) != 2 or min(size) < 1 or model not in _NEEDS:
            raise ValueError("size_px is not a pair, or the model is none of " + ", ".join(_NEEDS))
        focal, centre = _inner(values, model, (size[0], size[1]))
        widest = np.radians(float(values["hfov_deg"])) / 2 if model == FISHEYE else np.inf
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = (
            "size_px, camera_from_world (4 x 4), position_m, and K (3 x 3) or what the model needs, finite numbers"
        )
        raise UnreadableError(
            Finding(file, "the camera cannot be understood", expected=expected, got=_reason(error))
        ) from error
    return CameraFile((size[0], size[1]), model, focal, centre, float(widest), pose, position, values)


def _inner(values: Any, model: str, size_px: tuple[int, int]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Scales and the image's centre."""
    width, height = size_px
    if model == PANORAMA:
        return (width / (2 * np.pi), height / np.pi), (width / 2, height / 2)
    if model == ORTHOGRAPHIC:
        scale = width / float(values["width_m"])
        if not 0 < scale < np.inf:
            raise ValueError("width_m is no width")
        return (scale, scale), (width / 2, height / 2)
    k = _matrix(values["K"], (3, 3))
    if not (k[0, 0] > 0 and k[1, 1] > 0) or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any() or k[2, 2] != 1:
        raise ValueError("K is not of a camera without skew")
    return (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2]))


def _matrix(values: Sequence[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"expected {shape} finite numbers")
    return matrix


def _reason(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else str(error)
