"""camera.json: its model's geometry, computed anew by `Projection.read`, and the camera's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.recipe.registries import DEFAULT_PROJECTION
from forestgen.scene.projection import FileGeometry, Projection, load_projection, projection_of_model


@dataclass(frozen=True)
class CameraFile:
    """camera.json, as far as checks use it."""

    geometry: FileGeometry
    camera_from_world: NDArray[np.float64]  # (4, 4)
    position_m: NDArray[np.float64]  # (3,) world
    values: Mapping[str, Any]  # all of it

    @property
    def projection(self) -> Projection:
        return self.geometry.projection

    @property
    def size_px(self) -> tuple[int, int]:
        return self.geometry.size_px

    @property
    def rotation(self) -> NDArray[np.float64]:
        return self.camera_from_world[:3, :3]

    def project(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(..., 2) pixels and (...) depths of (..., 3) world points; what is not in front has no positive depth."""
        return self.geometry.project(points_m @ self.rotation.T + self.camera_from_world[:3, 3])

    def pixel_rays(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) world directions through the pixels' centres, of depth 1."""
        return np.asarray(self.geometry.rays(size_px) @ self.rotation)  # rows times R = R^T times columns: to the world

    def starts(self, size_px: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) world, from the camera's place to where the pixels' rays begin."""
        return np.asarray(self.geometry.starts(size_px) @ self.rotation)

    def pixels_a_metre(self, depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """How large things appear at a depth."""
        away = np.ones_like(depth_m) if self.projection.is_parallel else depth_m
        return np.asarray(self.geometry.focal_px[0] / away)


def camera_of(values: Any, file: str) -> CameraFile:
    """Read camera.json's fields; what is missing or no matrix raises `UnreadableError`."""
    try:
        size = [int(side) for side in values["size_px"]]
        pose = _matrix(values["camera_from_world"], (4, 4))
        position = _matrix(values["position_m"], (3,))
        model = values.get("model", load_projection(DEFAULT_PROJECTION).model)
        projection = projection_of_model(str(model))
        if len(size) != 2 or min(size) < 1 or projection is None:
            raise ValueError("size_px is not a pair, or there is no projection of this model")
        geometry = projection.read(values, (size[0], size[1]))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = (
            "size_px, camera_from_world (4 x 4), position_m, and K (3 x 3) or what the model needs, finite numbers"
        )
        raise UnreadableError(
            Finding(file, "the camera cannot be understood", expected=expected, got=_reason(error))
        ) from error
    return CameraFile(geometry, pose, position, values)


def _matrix(values: Sequence[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"expected {shape} finite numbers")
    return matrix


def _reason(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else str(error)
