"""Level layers of drops that light goes through, on the device (scene/weather/ground_fog.py).

A layer of extinction s up to the height h thins out above it by e in f. Above the height z lies the column

    C(z) = s (h - z + f) below h,    s f exp(-(z - h) / f) above it,

so the optical depth along a ray that climbs by w a metre is (C(z) - C(z + w t)) / w, and can be inverted: a ray
scatters where the depth is -log(1 - u), u even in [0, 1). Each layer has a distance of its own, and the nearest counts:
that of all layers together has the distribution of the sum of their extinctions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.paths.scattering import Local
from forestgen.render.paths.water import Shore
from forestgen.render.variant import dr, mi
from forestgen.scene.spec import FogLayer

_LEVEL = 1e-3  # climb of a ray below which it counts as level
FAR_M = 1e9


@dataclass(frozen=True)
class Flights:
    """Where rays scatter next."""

    distance_m: Any  # Float; `FAR_M` and more: nowhere
    asymmetry: Any  # Float, of the layer that they meet there


class Fog:
    """Layers in the paths' coordinates, whose origin (3,) is in the world."""

    def __init__(self, layers: tuple[FogLayer, ...], origin_m: NDArray[np.float64]) -> None:
        self._layers = [
            tuple(
                dr.opaque(mi.Float, float(value))
                for value in (one.extinction_per_m, one.top_m - origin_m[2], one.fade_m, one.asymmetry)
            )
            for one in layers
        ]

    @property
    def pairs(self) -> int:
        """Pairs of random numbers that `flights` takes."""
        return -(-len(self._layers) // 2)

    def flights(self, start: Any, direction: Any, numbers: list[Any]) -> Flights:
        """Way of rays to their next scattering by `numbers`, Floats in [0, 1), one a layer."""
        best, asymmetry = mi.Float(FAR_M), mi.Float(0.0)
        for (extinction, top, fade, g), number in zip(self._layers, numbers, strict=False):
            depth = -dr.log(1.0 - number)
            way = _way(start.z, direction.z, depth, extinction, top, fade)
            asymmetry = dr.select(way < best, g, asymmetry)
            best = dr.minimum(best, way)
        return Flights(best, asymmetry)

    def through(self, start: Any, direction: Any) -> Any:
        """Float: share of the light from infinitely far away that comes along directions."""
        depth = mi.Float(0.0)
        for extinction, top, fade, _ in self._layers:
            depth += _column(start.z, extinction, top, fade) / dr.maximum(direction.z, 1e-6)
        return dr.exp(-depth)

    def kept(self, start: Any, direction: Any, distance_m: Any) -> Any:
        """Float: share of the light that comes from a distance."""
        depth = mi.Float(0.0)
        for extinction, top, fade, _ in self._layers:
            here, there = (_column(z, extinction, top, fade) for z in (start.z, start.z + direction.z * distance_m))
            level = _extinction(start.z, extinction, top, fade) * distance_m
            is_level = dr.abs(direction.z) < _LEVEL
            depth += dr.select(is_level, level, (here - there) / dr.select(is_level, 1.0, direction.z))
        return dr.exp(-dr.maximum(depth, 0.0))


class Place:
    """Where paths scatter: in fog, or else at a surface, which it is used as."""

    def __init__(self, surface: Local | Shore, in_fog: Any, direction: Any, asymmetry: Any) -> None:
        """By paths' directions before (Vector3f) and the fog's asymmetry (Float)."""
        self._surface, self.in_fog, self._direction, self._asymmetry = surface, in_fog, direction, asymmetry
        self.geometric = dr.select(in_fog, mi.Vector3f(0.0), surface.geometric)

    def value(self, direction: Any) -> Any:
        """Color3f: light scattered towards directions, over the irradiance on a plane that faces it."""
        own = mi.Color3f(phase(dr.dot(self._direction, direction), self._asymmetry))
        return dr.select(self.in_fog, own, self._surface.value(direction))

    def density(self, direction: Any) -> Any:
        """Float: density, over the sphere, of the directions in which `sample` has paths go on."""
        own = phase(dr.dot(self._direction, direction), self._asymmetry)
        return dr.select(self.in_fog, own, self._surface.density(direction))

    def sample(self, lobe: Any, first: Any, second: Any) -> tuple[Any, Any]:
        """Unit directions in which paths go on, and Color3f by which their light is multiplied."""
        direction, weight = self._surface.sample(lobe, first, second)
        own = scattered(self._direction, self._asymmetry, first, second)
        return dr.select(self.in_fog, own, direction), dr.select(self.in_fog, mi.Color3f(1.0), weight)


def phase(cosine: Any, asymmetry: Any) -> Any:
    """Float: Henyey and Greenstein's density over the sphere, by the cosine between a path's way before and after."""
    square = asymmetry * asymmetry
    base = dr.maximum(1.0 + square - 2.0 * asymmetry * cosine, 1e-9)
    return (1.0 - square) / (4.0 * np.pi * base * dr.sqrt(base))


def scattered(direction: Any, asymmetry: Any, first: Any, second: Any) -> Any:
    """Vector3f: directions after a scattering, spread as `phase`."""
    g = dr.maximum(asymmetry, 1e-3)
    root = (1.0 - g * g) / (1.0 - g + 2.0 * g * first)
    cosine = dr.clip((1.0 + g * g - root * root) / (2.0 * g), -1.0, 1.0)
    sine, (turn_sine, turn_cosine) = dr.safe_sqrt(1.0 - cosine * cosine), dr.sincos(2.0 * np.pi * second)
    return mi.Frame3f(direction).to_world(mi.Vector3f(sine * turn_cosine, sine * turn_sine, cosine))


def _column(z: Any, extinction: Any, top: Any, fade: Any) -> Any:
    above = z - top
    return extinction * (fade * dr.exp(-dr.maximum(above, 0.0) / fade) - dr.minimum(above, 0.0))


def _extinction(z: Any, extinction: Any, top: Any, fade: Any) -> Any:
    return extinction * dr.exp(-dr.maximum(z - top, 0.0) / fade)


def _way(z: Any, climb: Any, depth: Any, extinction: Any, top: Any, fade: Any) -> Any:
    """Float: metres to an optical depth."""
    is_level = dr.abs(climb) < _LEVEL
    level = depth / dr.maximum(_extinction(z, extinction, top, fade), 1e-20)
    left = _column(z, extinction, top, fade) - climb * depth  # above where the ray scatters
    reached = extinction * fade  # of what lies above the layer's top
    above = top - fade * dr.log(dr.maximum(left, 1e-20) / reached)
    below = top + fade - left / extinction
    end = dr.select(left < reached, above, below)
    way = (end - z) / dr.select(is_level, 1.0, climb)
    way = dr.select(left <= 0.0, FAR_M, dr.maximum(way, 0.0))
    return dr.minimum(dr.select(is_level, level, way), FAR_M)
