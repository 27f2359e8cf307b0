"""The disc that casts shadows, on the device: its light, and what clouds let through of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from forestgen.geometry.mesh import Floats
from forestgen.render.cloud_shadow import ShadowPlane
from forestgen.render.light import SUN_RADIUS_DEG, MoonPhase
from forestgen.render.variant import dr, mi


class Sun:
    """The sun's disc, or by night the moon's."""

    def __init__(
        self,
        to_sun: Floats,
        irradiance: Floats,
        radiance: Floats,
        shadow: ShadowPlane | None,
        origin_m: Floats,
        phase: MoonPhase | None = None,
    ) -> None:
        """By (3,) irradiance on a surface that faces the sun, and mean radiance of its disc.

        `shadow` is what clouds let through; None: all. `origin_m` (3,), world, is that of the paths' coordinates.
        `phase` None: the whole disc shines.
        """
        self.centre = mi.Vector3f(*[dr.opaque(mi.Float, float(value)) for value in to_sun])
        self.irradiance, self.radiance = (
            mi.Color3f(*[dr.opaque(mi.Float, float(value)) for value in three]) for three in (irradiance, radiance)
        )
        self._axes = mi.Frame3f(self.centre)
        self._radius = dr.opaque(mi.Float, float(np.tan(np.radians(SUN_RADIUS_DEG))))
        self._phase = phase
        if phase is not None:
            aside = phase.to_sun - (phase.to_sun @ to_sun) * to_sun
            aside = aside / max(float(np.linalg.norm(aside)), 1e-12)
            self._lit_side = mi.Vector3f(*[dr.opaque(mi.Float, float(value)) for value in aside])
        self._shadow = shadow
        if shadow is not None:
            self._texel = mi.Float(np.ascontiguousarray(shadow.transmittance, dtype=np.float32).ravel())
            size = (shadow.high_m - shadow.low_m) / shadow.transmittance.shape[::-1]
            self._low = [dr.opaque(mi.Float, float(value)) for value in shadow.low_m - origin_m[:2]]
            self._per_m = [dr.opaque(mi.Float, float(1.0 / value)) for value in size]
            self._cells = [dr.opaque(mi.Float, float(count)) for count in shadow.transmittance.shape[::-1]]
            self._height = dr.opaque(mi.Float, float(shadow.height_m - origin_m[2]))

    def sample(self, first: Any, second: Any) -> Any:
        """Vector3f, a direction to a point of the disc, all alike."""
        radius = self._radius * dr.sqrt(first)
        sine, cosine = dr.sincos(2 * np.pi * second)
        return dr.normalize(self._axes.to_world(mi.Vector3f(radius * cosine, radius * sine, 1.0)))

    def seen(self, direction: Any) -> Any:
        """Color3f, the radiance of the disc towards directions; 0 beside it."""
        aside = dr.norm(dr.cross(direction, self.centre))
        inside = (aside < self._radius) & (dr.dot(direction, self.centre) > 0)
        if self._phase is None:
            return dr.select(inside, self.radiance, 0.0)
        sine, cosine = dr.sincos(dr.opaque(mi.Float, self._phase.angle_rad))
        up = dr.safe_sqrt(1.0 - dr.square(aside / self._radius))
        facing = dr.maximum(sine * dr.dot(direction, self._lit_side) / self._radius + cosine * up, 0.0)
        law = facing / dr.maximum(facing + up, 1e-6) / self._phase.mean  # Lommel and Seeliger's
        return dr.select(inside, self.radiance * law, 0.0)

    def share(self, point: Any, direction: Any, active: Any) -> Any:
        """Float, what clouds let through of the light that comes to points from directions."""
        if self._shadow is None:
            return mi.Float(1.0)
        reach = (self._height - point.z) / dr.maximum(direction.z, 1e-6)
        place = [point[k] + reach * direction[k] - self._low[k] for k in range(2)]
        x, y = (place[k] * self._per_m[k] for k in range(2))
        under = active & (reach > 0) & (x >= 0) & (x <= self._cells[0]) & (y >= 0) & (y <= self._cells[1])
        corners = []
        for value, cells in ((x - 0.5, self._cells[0]), (y - 0.5, self._cells[1])):
            low = dr.floor(value)
            nearest = [dr.clip(low + step, 0.0, cells - 1.0) for step in (0.0, 1.0)]
            corners.append((nearest, value - low))
        (columns, right), (rows, up) = corners
        found = mi.Float(0.0)
        for row, across in zip(rows, (1.0 - up, up), strict=True):
            for column, along in zip(columns, (1.0 - right, right), strict=True):
                texel = mi.UInt32(row) * mi.UInt32(self._cells[0]) + mi.UInt32(column)
                found += across * along * dr.gather(mi.Float, self._texel, texel, under)
        return dr.select(under, found, 1.0)
