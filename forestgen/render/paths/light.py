"""Lights of the path tracer: a sky around, and the sun's disc, dimmed where clouds shade it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.cloud_shadow import Sheet
from forestgen.render.sky_radiance import SUN_RADIUS_DEG
from forestgen.render.variant import drjit, mitsuba

Floats = NDArray[np.float64]


class Sky:
    """The sky's radiance by direction, on the device; see `sky_radiance.map_directions`.

    Parameters
    ----------
    sampled : whether paths look for its light at every scattering, where it is bright; else they find it by chance,
        which costs less and is as good where a sky is nearly even.
    """

    def __init__(self, radiance: NDArray[np.float32], *, sampled: bool = False) -> None:
        mi, dr = mitsuba(), drjit()
        self.sampled = sampled
        self._rows, self._columns = (dr.opaque(mi.UInt32, size) for size in radiance.shape[:2])
        self._texel = mi.Float(np.ascontiguousarray(radiance).ravel())
        if sampled:
            share, density = sky_shares(radiance)
            self._shares = mi.DiscreteDistribution2D(share.astype(np.float32))
            self._density = mi.Float(density.astype(np.float32).ravel())

    def sample(self, first: Any, second: Any) -> tuple[Any, Any]:
        """Unit directions, and Float, their density over the sphere."""
        mi, dr = mitsuba(), drjit()
        cell, _, within = self._shares.sample(mi.Point2f(first, second))
        low, high = (dr.clip(mi.Float(cell.y) + side, 0.0, mi.Float(self._rows) - 1.0) for side in (-0.5, 0.5))
        zenith = (low + within.y * (high - low)) * (np.pi / (mi.Float(self._rows) - 1.0))
        turn = (mi.Float(cell.x) + within.x) * (2 * np.pi / mi.Float(self._columns))
        (up, level), (north, east) = dr.sincos(zenith)[::-1], dr.sincos(turn)
        density = dr.gather(mi.Float, self._density, cell.y * self._columns + cell.x)
        return mi.Vector3f(level * east, level * north, up), density / dr.maximum(level, 1e-6)

    def density(self, direction: Any) -> Any:
        """Float: density over the sphere with which `sample` chooses directions."""
        mi, dr = mitsuba(), drjit()
        level = dr.sqrt(direction.x**2 + direction.y**2)
        turn = dr.atan2(direction.y, direction.x) * (0.5 / np.pi)
        column = dr.minimum(mi.UInt32((turn - dr.floor(turn)) * mi.Float(self._columns)), self._columns - 1)
        row = mi.UInt32(dr.atan2(level, direction.z) * ((mi.Float(self._rows) - 1.0) / np.pi) + 0.5)
        row = dr.minimum(row, self._rows - 1)
        return dr.gather(mi.Float, self._density, row * self._columns + column) / dr.maximum(level, 1e-6)

    def towards(self, direction: Any, active: Any) -> Any:
        """Color3f, bilinear between the map's places; the first and the last row are the zenith and the nadir."""
        mi, dr = mitsuba(), drjit()
        rows, columns = mi.Float(self._rows), mi.Float(self._columns)
        x = dr.atan2(direction.y, direction.x) * (0.5 / np.pi) * columns - 0.5
        y = dr.atan2(dr.sqrt(direction.x**2 + direction.y**2), direction.z) * (1.0 / np.pi) * (rows - 1.0)
        top = dr.clip(dr.floor(y), 0.0, rows - 2.0)
        left = dr.floor(x)
        first = dr.select(left < 0.0, left + columns, left)
        second = dr.select(first + 1.0 >= columns, 0.0, first + 1.0)
        row = mi.UInt32(top) * self._columns
        upper, lower = (
            self._at(base + mi.UInt32(first), active) * (1.0 - (x - left))
            + self._at(base + mi.UInt32(second), active) * (x - left)
            for base in (row, row + self._columns)
        )
        return upper * (1.0 - (y - top)) + lower * (y - top)

    def _at(self, texel: Any, active: Any) -> Any:
        return drjit().gather(mitsuba().Color3f, self._texel, texel, active)


def sky_shares(radiance: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """(rows, columns) shares of light samples, and their density over angles of zenith and turn.

    A cell counts as much as the brightest of the places around it, since radiance goes in straight lines between them.
    """
    rows, columns = radiance.shape[:2]
    bright = radiance.mean(axis=2, dtype=np.float64)
    around = np.pad(np.pad(bright, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    most = np.max([around[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)
    edges = np.clip(np.arange(rows + 1) - 0.5, 0, rows - 1) * (np.pi / (rows - 1))
    share = most * (np.cos(edges[:-1]) - np.cos(edges[1:]))[:, None]
    share /= max(float(share.sum()), 1e-30)
    return share, share / (np.diff(edges)[:, None] * (2 * np.pi / columns))


class Sun:
    """The sun's disc."""

    def __init__(
        self, to_sun: Floats, irradiance: Floats, radiance: Floats, sheet: Sheet | None, origin_m: Floats
    ) -> None:
        """
        Parameters
        ----------
        irradiance, radiance : (3,) on a surface that faces the sun, and of its disc.
        sheet : what clouds let through; None: all.
        origin_m : (3,) world, of the paths' coordinates.
        """
        mi, dr = mitsuba(), drjit()
        self.centre = mi.Vector3f(*[dr.opaque(mi.Float, float(value)) for value in to_sun])
        self.irradiance, self.radiance = (
            mi.Color3f(*[dr.opaque(mi.Float, float(value)) for value in three]) for three in (irradiance, radiance)
        )
        self._axes = mi.Frame3f(self.centre)
        self._radius = dr.opaque(mi.Float, float(np.tan(np.radians(SUN_RADIUS_DEG))))
        self._sheet = sheet
        if sheet is not None:
            self._texel = mi.Float(np.ascontiguousarray(sheet.transmittance, dtype=np.float32).ravel())
            size = (sheet.high_m - sheet.low_m) / sheet.transmittance.shape[::-1]
            self._low = [dr.opaque(mi.Float, float(value)) for value in sheet.low_m - origin_m[:2]]
            self._per_m = [dr.opaque(mi.Float, float(1.0 / value)) for value in size]
            self._cells = [dr.opaque(mi.Float, float(count)) for count in sheet.transmittance.shape[::-1]]
            self._height = dr.opaque(mi.Float, float(sheet.height_m - origin_m[2]))

    def sample(self, first: Any, second: Any) -> Any:
        """Vector3f, a direction to a point of the disc, all alike."""
        mi, dr = mitsuba(), drjit()
        radius = self._radius * dr.sqrt(first)
        sine, cosine = dr.sincos(2 * np.pi * second)
        return dr.normalize(self._axes.to_world(mi.Vector3f(radius * cosine, radius * sine, 1.0)))

    def seen(self, direction: Any) -> Any:
        """Color3f, the radiance of the disc towards directions; 0 beside it."""
        dr = drjit()
        aside = dr.norm(dr.cross(direction, self.centre))
        return dr.select((aside < self._radius) & (dr.dot(direction, self.centre) > 0), self.radiance, 0.0)

    def share(self, point: Any, direction: Any, active: Any) -> Any:
        """Float, what clouds let through of the light that comes to points from directions."""
        mi, dr = mitsuba(), drjit()
        if self._sheet is None:
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
