"""Cylindrical cameras: the panorama of a turning slit camera, upright lines stay straight.

u is longitude to the right and v the slope, both by f = W / hfov pixels a radian: v = f y / hypot(x, z). Depth is the
distance along the ray.

| key | |
|---|---|
| hfov_deg | across the image's width, at most 350; default 180 |
| horizon | where the horizon lies, as a share of the image's height from its top; default 0.5 |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from forestgen.recipe.cameras import Camera as CameraKeys
from forestgen.scene.projection import Floats, Pixels, Projection, Rays
from forestgen.scene.spec import Camera


class CylindricalCamera(CameraKeys):
    """Keys of `cameras: [{kind: cylindrical}]`, beside those of all cameras."""

    default_size_px: ClassVar[tuple[int, int]] = (900, 300)
    default_look: ClassVar = "north"
    default_place: ClassVar = (0.5, 0.5, 1.7)
    is_level: ClassVar[bool] = True

    hfov_deg: float = Field(180.0, ge=1, le=350, description="angle across the image's width")
    horizon: float = Field(0.5, ge=0, le=1, description="where the horizon lies, share of the height from the top")

    @property
    def field_of_view_deg(self) -> float:
        return self.hfov_deg

    @property
    def own_numbers(self) -> Mapping[str, float]:
        return {"horizon": self.horizon}


class Cylindrical(Projection):
    """Longitude and slope."""

    name = "cylindrical"
    Parameters = CylindricalCamera
    model = "cylindrical"

    def rays(self, camera: Camera, x: Floats, y: Floats) -> Rays:
        focal_px, below_px = _scale(camera)
        slope = (y - below_px) / focal_px
        direction = np.stack([np.sin(x / focal_px), slope, np.cos(x / focal_px)], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return Rays(np.zeros((*x.shape, 3)), direction, np.ones(x.shape, dtype=bool))

    def project(self, camera: Camera, x: Floats, y: Floats, z: Floats) -> Pixels:
        focal_px, below_px = _scale(camera)
        u, level = focal_px * np.arctan2(x, z), np.hypot(x, z)
        v = focal_px * y / np.maximum(level, 1e-12) + below_px
        return Pixels(u, v, np.hypot(level, y), (np.abs(u) <= camera.size_px[0] / 2 * (1 + 1e-12)) & (level > 0))


def _scale(camera: Camera) -> tuple[float, float]:
    """Pixels a radian, and how far the horizon lies below the image's middle."""
    width, height = camera.size_px
    return width / float(np.radians(camera.hfov_deg)), (camera.numbers["horizon"] - 0.5) * height


PROJECTION = Cylindrical()
