"""Level layers of drops that light goes through, on the device (scene/weather/ground_fog.py).

A layer of extinction s up to the height h thins out above it by e in f. Above the height z lies the column

    C(z) = s (h - z + f) below h,    s f exp(-(z - h) / f) above it,

so the optical depth along a ray that climbs by w a metre is (C(z) - C(z + w t)) / w, and can be inverted: a ray
scatters where the depth is -log(1 - u), u even in [0, 1). Each layer has a distance of its own, and the nearest counts:
that of all layers together has the distribution of the sum of their extinctions.

A patchy layer's extinction is multiplied by 1 + sum of a sin(k . x + phase) over its waves, whose a are less than 1
together. Integrals of s sin(..) and of s exp(-c t) sin(..) along a ray are known, so its depth is exact, too. It lies
between 1 - sum of a and 1 + sum of a times that of an even layer, and is inverted within these bounds by Newton's
method.
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
_THIN_FADES = 20.0  # above the top, where nothing is left of a layer
_STEPS = 9  # of Newton's method, halving where it would leave the bounds
FAR_M = 1e9


@dataclass(frozen=True)
class Flights:
    """Where rays scatter next."""

    distance_m: Any  # Float; `FAR_M` and more: nowhere
    asymmetry: Any  # Float, of the layer that they meet there


class Fog:
    """Layers in the paths' coordinates, whose origin (3,) is in the world."""

    def __init__(self, layers: tuple[FogLayer, ...], origin_m: NDArray[np.float64]) -> None:
        self._layers = [_Layer.of(one, origin_m) for one in layers]

    @property
    def pairs(self) -> int:
        """Pairs of random numbers that `flights` takes."""
        return -(-len(self._layers) // 2)

    def flights(self, start: Any, direction: Any, numbers: list[Any]) -> Flights:
        """Way of rays to their next scattering by `numbers`, Floats in [0, 1), one a layer."""
        best, asymmetry = mi.Float(FAR_M), mi.Float(0.0)
        for layer, number in zip(self._layers, numbers, strict=False):
            way = layer.way_m(start, direction, -dr.log(1.0 - number))
            asymmetry = dr.select(way < best, layer.asymmetry, asymmetry)
            best = dr.minimum(best, way)
        return Flights(best, asymmetry)

    def through(self, start: Any, direction: Any) -> Any:
        """Float: share of the light from infinitely far away that comes along directions."""
        depth = mi.Float(0.0)
        for layer in self._layers:
            own = layer.column(start.z) / dr.maximum(direction.z, 1e-6)
            if layer.waves:
                own += layer.excess_depth(start, direction, layer.out_m(start.z, direction.z))
            depth += dr.maximum(own, 0.0)
        return dr.exp(-depth)

    def kept(self, start: Any, direction: Any, distance_m: Any) -> Any:
        """Float: share of the light that comes from a distance."""
        depth = mi.Float(0.0)
        for layer in self._layers:
            depth += layer.depth(start, direction, distance_m)
        return dr.exp(-dr.maximum(depth, 0.0))


@dataclass(frozen=True)
class _Layer:
    """On the device."""

    extinction: Any
    top: Any
    fade: Any
    asymmetry: Any
    waves: tuple[tuple[Any, Any, Any], ...]  # wave vectors, phases and amplitudes
    amplitude: float  # of all waves

    @classmethod
    def of(cls, layer: FogLayer, origin_m: NDArray[np.float64]) -> _Layer:
        def known(value: float) -> Any:
            return dr.opaque(mi.Float, float(value))

        waves = tuple(
            (mi.Vector3f(*map(known, wave)), known(phase + float(np.dot(wave, origin_m))), known(amplitude))
            for wave, phase, amplitude in layer.patches
        )
        extinction, top, fade = map(known, (layer.extinction_per_m, layer.top_m - origin_m[2], layer.fade_m))
        amplitude = sum(amplitude for _, _, amplitude in layer.patches)
        return cls(extinction, top, fade, known(layer.asymmetry), waves, amplitude)

    def column(self, z: Any) -> Any:
        """Float: optical depth of an even layer above a height."""
        above = z - self.top
        return self.extinction * (self.fade * dr.exp(-dr.maximum(above, 0.0) / self.fade) - dr.minimum(above, 0.0))

    def even(self, z: Any) -> Any:
        """Float: extinction of an even layer."""
        return self.extinction * dr.exp(-dr.maximum(z - self.top, 0.0) / self.fade)

    def out_m(self, z: Any, climb: Any) -> Any:
        """Float: way to where nothing is left above, `FAR_M` of rays that do not climb."""
        way = (self.top + _THIN_FADES * self.fade - z) / dr.maximum(climb, _LEVEL)
        return dr.select(climb > _LEVEL, dr.maximum(way, 0.0), FAR_M)

    def depth(self, start: Any, direction: Any, distance_m: Any) -> Any:
        """Float: optical depth of a way."""
        here, there = (self.column(z) for z in (start.z, start.z + direction.z * distance_m))
        level = self.even(start.z) * distance_m
        is_level = dr.abs(direction.z) < _LEVEL
        depth = dr.select(is_level, level, (here - there) / dr.select(is_level, 1.0, direction.z))
        return depth + self.excess_depth(start, direction, distance_m) if self.waves else depth

    def excess_depth(self, start: Any, direction: Any, distance_m: Any) -> Any:
        """Float: by how much the optical depth of a way is more than that of an even layer."""
        climb, is_level = direction.z, dr.abs(direction.z) < _LEVEL
        cut = dr.clip((self.top - start.z) / dr.select(is_level, 1.0, climb), 0.0, distance_m)
        rises = climb > 0.0
        low = dr.select(rises, 0.0, cut), dr.select(rises, cut, distance_m)  # below the top
        high = dr.select(rises, cut, 0.0), dr.select(rises, distance_m, cut)
        rate = climb / self.fade
        left = [dr.exp(-dr.maximum(start.z + climb * end - self.top, 0.0) / self.fade) for end in high]
        total = mi.Float(0.0)
        for wave, phase, amplitude in self.waves:
            first, turn = dr.dot(wave, start) + phase, dr.dot(wave, direction)
            below = _sine(first, turn, *low)
            ends = []
            for end, share in zip(high, left, strict=True):
                sine, cosine = dr.sincos(first + turn * end)
                ends.append(share * (rate * sine + turn * cosine))
            above = (ends[0] - ends[1]) / dr.maximum(turn * turn + rate * rate, 1e-12)
            level = _sine(first, turn, mi.Float(0.0), distance_m) * self.even(start.z) / self.extinction
            total += amplitude * dr.select(is_level, level, below + above)
        return self.extinction * total

    def way_m(self, start: Any, direction: Any, depth: Any) -> Any:
        """Float: metres to an optical depth."""
        if not self.waves:
            return self._even_way_m(start.z, direction.z, depth)
        low, way, high = (
            self._even_way_m(start.z, direction.z, depth / share)
            for share in (1.0 + self.amplitude, 1.0, 1.0 - self.amplitude)
        )
        out = self.out_m(start.z, direction.z)
        leaves = (out < high) & (self.depth(start, direction, out) < depth)
        high = dr.maximum(dr.minimum(high, out), low)
        way = dr.minimum(way, high)
        for _ in range(_STEPS):
            miss = self.depth(start, direction, way) - depth
            low, high = dr.select(miss < 0.0, way, low), dr.select(miss < 0.0, high, way)
            there = start + way * direction
            slope = mi.Float(1.0)
            for wave, phase, amplitude in self.waves:
                slope += amplitude * dr.sin(dr.dot(wave, there) + phase)
            newton = way - miss / dr.maximum(slope * self.even(there.z), 1e-12)
            way = dr.select((newton > low) & (newton < high), newton, 0.5 * (low + high))
        return dr.select(leaves, FAR_M, way)

    def _even_way_m(self, z: Any, climb: Any, depth: Any) -> Any:
        is_level = dr.abs(climb) < _LEVEL
        level = depth / dr.maximum(self.even(z), 1e-20)
        left = self.column(z) - climb * depth  # above where the ray scatters
        reached = self.extinction * self.fade  # of what lies above the layer's top
        above = self.top - self.fade * dr.log(dr.maximum(left, 1e-20) / reached)
        below = self.top + self.fade - left / self.extinction
        end = dr.select(left < reached, above, below)
        way = (end - z) / dr.select(is_level, 1.0, climb)
        way = dr.select(left <= 0.0, FAR_M, dr.maximum(way, 0.0))
        return dr.minimum(dr.select(is_level, level, way), FAR_M)


def _sine(first: Any, turn: Any, begin: Any, end: Any) -> Any:
    """Float: integral of sin(first + turn t) from a beginning to an end."""
    half = 0.5 * turn * (end - begin)
    bent = dr.select(dr.abs(half) > 1e-3, dr.sin(half) / dr.select(half == 0.0, 1.0, half), 1.0)
    return dr.sin(first + 0.5 * turn * (begin + end)) * (end - begin) * bent


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
