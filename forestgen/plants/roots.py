"""Roots above the ground: ridges at the foot of a stem that run out over the ground, get thinner and dive.

A stem widens above each root by

    1.15 rise s exp(-z / (1.3 r f)) exp(k (cos(a - a_root) - 1))

of its radius r at the height z and azimuth a: s is the root's size over the largest, f = 0.45 + 0.75 s, so ridges of
large roots reach further up. The stem's own flare is of the same ridges, wider, with hollows between them. From the
ridge a tube goes on, taller than wide and mostly below the ground, so that it hangs over no slope that is not steep. It
ends below the ground within `reach_m`, times the root of the stem's diameter over 30 cm. Spruce and beech root near the
surface (Köstler, Brückner and Bibelriether 1968, Die Wurzeln der Waldbäume); lengths and numbers are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats, Mesh
from forestgen.geometry.sweep import Polylines, sweep_tubes
from forestgen.recipe.wood import Roots

HIGH = 1.2  # height of roots at the stem, over its radius: above, a stem is a stem
_LEAST_RADIUS_M = 0.04  # of a stem with roots above the ground
_NARROW, _PEAK = 12.0, 1.15  # k, and the peak over `rise`
_WIDE = 3.5  # k of the flare's ridges
_FADES = 1.3  # of the widening's height, over the stem's radius
_NODES, _SIDES = 12, 8
_TALL = 1.7  # height of a root's section over its width
_WANDER_RAD = 0.14  # standard deviation of a root's turn to the side, and of its waves
_REFERENCE_M = 0.3  # diameter
_SINKS = 1.0  # of a root's radius, over its way: litter and soil cover it bit by bit
_DIVE = 0.3  # of the way, at the end, on which a root goes down


@dataclass(frozen=True)
class StemRoots:
    """The roots of one stem; R of them."""

    stem_m: float  # radius
    rise: float
    azimuth_rad: Floats  # (R,)
    size: Floats  # (R,) of the widening above each, over the largest
    thick_m: Floats  # (R,) radius at the stem
    reach_m: Floats  # (R,) from the stem's middle
    turn_rad: Floats  # (R, N) from the azimuth
    bumps: Floats  # (R, N) of the height, over the radius

    def widening(self, angle_rad: Floats, height_m: Floats) -> Floats:
        """(K, S) of the stem, over its radius."""
        fades_m = _FADES * self.stem_m * (0.45 + 0.75 * self.size)
        return np.asarray(
            _PEAK * self.rise * np.exp(-height_m[:, None] / fades_m) * self.size @ self._lobes(angle_rad, _NARROW).T
        )

    def ridges(self, angle_rad: Floats) -> Floats:
        """(S,) of the stem's flare, of mean 1."""
        lobes = self._lobes(angle_rad, _WIDE) @ self.size
        return np.asarray(lobes / lobes.mean())

    def _lobes(self, angle_rad: Floats, narrow: float) -> Floats:
        """(S, R) of each root by azimuth."""
        return np.asarray(np.exp(narrow * (np.cos(angle_rad[:, None] - self.azimuth_rad) - 1.0)))

    def mesh(self, foot_m: Floats, tile_m: tuple[float, float]) -> Mesh:
        """Tubes from within the stem; `foot_m`: (3,) the stem's middle on the ground."""
        share = np.linspace(0.0, 1.0, _NODES)
        begin_m = 0.55 * self.stem_m
        away = begin_m + (self.reach_m[:, None] - begin_m) * share
        radius = self.thick_m[:, None] * (1.0 - 0.8 * share**0.8)
        ridge = self.rise * self.size[:, None] * self.stem_m
        top = ridge * np.exp(-(away - begin_m) / (0.9 * self.stem_m)) + (0.7 - _SINKS * share) * radius * (
            1.0 + self.bumps
        )
        top -= 2.2 * radius * (np.maximum(share - 1.0 + _DIVE, 0.0) / _DIVE) ** 2
        azimuth = self.azimuth_rad[:, None] + self.turn_rad
        height = top - np.sqrt(_TALL) * radius
        points = np.stack([away * np.cos(azimuth), away * np.sin(azimuth), height], axis=2) + foot_m
        count = len(self.reach_m)
        lines = Polylines(points.reshape(-1, 3), radius.reshape(-1), np.arange(count + 1) * _NODES)
        return sweep_tubes(lines, np.full(count, _SIDES), pointed=False, height_ratio=_TALL, tile_m=tile_m)[0]


def roots_of(law: Roots | None, stem_m: float, most_m: float = np.inf) -> StemRoots | None:
    """The roots of a stem of a radius, by which they differ; None: it has none above the ground.

    `most_m`: how far they may reach from the stem's middle.
    """
    if law is None or stem_m < _LEAST_RADIUS_M:
        return None
    rng = child_rng(round(1e6 * stem_m), "roots")
    count = max(2, int(law.count + rng.uniform(-1.0, 2.0)))
    azimuth = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count + rng.uniform(0.0, 2.0 * np.pi)
    size = rng.uniform(0.25, 1.0, count)
    share = np.linspace(0.0, 1.0, _NODES)
    turn = _WANDER_RAD * (rng.normal(size=(count, 1)) * share + rng.normal(size=(count, 1)) * np.sin(2 * np.pi * share))
    reach = stem_m + law.reach_m * np.sqrt(2.0 * stem_m / _REFERENCE_M) * rng.uniform(0.35, 1.0, count)
    reach = np.minimum(reach, max(most_m, 1.2 * stem_m))
    bumps = 0.5 * np.sin(rng.uniform(3.0, 9.0, (count, 1)) * share + rng.uniform(0.0, 6.0, (count, 1)))
    return StemRoots(stem_m, law.rise, azimuth, size, stem_m * (0.25 + 0.25 * size), reach, turn, bumps)
