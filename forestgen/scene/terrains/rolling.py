"""Rolling ground, a finite sum of waves of random directions; and flat ground, z = 0.

The site's relief has a standard deviation of `amplitude_m` and wavelengths from `wavelength_m` down to 1/8 of it, of
which long ones carry most of the height, as on eroded land. Around it, from some hundred metres on, stand hills of 900
to 3000 m and a standard deviation of `hills_m`; `site.surroundings` covers them with the stand's forest.

Example
-------
    site: {terrain: {kind: rolling, amplitude_m: 3, wavelength_m: 80, hills_m: 60}, surroundings: forest}

Parameters: see below.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Number, Positive
from forestgen.recipe.schema import Terrain
from forestgen.scene.terrain import MARGIN_M, HeightField, TerrainShape, smooth_step

HILLS_FROM_M = 250.0


class RollingKeys(Terrain):
    """Keys of `terrain: {kind: rolling}`. The other shipped kinds ignore them, so that a recipe can draw the kind."""

    amplitude_m: Number = Field(0.8, ge=0, le=500, description="Standard deviation of rolling ground's height, metres.")
    wavelength_m: Positive = Field(
        70.0, ge=1, le=10000, description="Longest distance between rolling ground's crests, metres."
    )
    hills_m: Number = Field(
        22.0,
        ge=0,
        le=500,
        description="Standard deviation of the height of hills around rolling ground, metres; level ground has none.",
    )


class Rolling(TerrainShape[RollingKeys]):
    """Gently rolling ground with hills in the distance."""

    Parameters = RollingKeys

    def is_level(self, keys: RollingKeys) -> bool:
        return keys.amplitude_m == 0

    def height(self, keys: RollingKeys, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        rng = child_rng(image_seed, "terrain", "height")
        return rolling(size_m, keys.amplitude_m, keys.wavelength_m, rng, keys.hills_m)


@dataclass(frozen=True, eq=False)
class Waves(HeightField):
    """Waves on and near the site, hills in the distance.

    z = sum of amplitude * fade * sin(k . x + phase). Near waves fade out over a wavelength away from the site, where
    the mesh is too coarse to carry them; hills fade in from `HILLS_FROM_M` on, so that the site keeps its own
    relief, and out again four wavelengths away.
    """

    wave_per_m: NDArray[np.float64]  # (M, 2) angular wave vectors
    amplitude_m: NDArray[np.float64]  # (M,)
    phase: NDArray[np.float64]  # (M,)
    hill: NDArray[np.bool_]  # (M,) a hill of the distance, not a wave of the site

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        z = np.zeros(x_m.shape)
        away = self.distance_m(x_m, y_m)
        far = smooth_step((away - HILLS_FROM_M) / (6 * HILLS_FROM_M))
        has_hills = bool(far.any())
        for k, amplitude, phase, hill in zip(self.wave_per_m, self.amplitude_m, self.phase, self.hill, strict=True):
            if hill and not has_hills:
                continue
            wavelength = 2 * np.pi / np.hypot(*k)
            fade = (
                far * (1 - smooth_step(away / (2 * wavelength) - 1))
                if hill
                else 1 - smooth_step((away - MARGIN_M) / wavelength)
            )
            z += amplitude * fade * np.sin(k[0] * x_m + k[1] * y_m + phase)
        return z


def rolling(
    size_m: tuple[float, float],
    amplitude_m: float,
    wavelength_m: float,
    rng: np.random.Generator,
    hills_m: float = 22.0,
) -> Waves:
    """Gently rolling ground: standard deviation `amplitude_m`, wavelengths from `wavelength_m` down to 1/8 of it.

    Around it, from some hundred metres on, hills of 900 to 3000 m and a standard deviation of `hills_m`.
    """
    waves, hills = 24, 10
    wavelength = np.concatenate([wavelength_m * 0.5 ** (3.0 * rng.random(waves)), 900.0 + 2100.0 * rng.random(hills)])
    angle = rng.random(waves + hills) * 2 * np.pi
    k = 2 * np.pi / wavelength
    hill = np.arange(waves + hills) >= waves
    weight = np.where(hill, wavelength, wavelength**2)  # long waves carry most of the height, as on eroded land
    for group, deviation in ((~hill, amplitude_m), (hill, hills_m if amplitude_m > 0 else 0.0)):
        weight[group] *= deviation * np.sqrt(2.0 / np.sum(weight[group] ** 2))
    direction = np.stack([k * np.cos(angle), k * np.sin(angle)], axis=1)
    return Waves(size_m, direction, weight, rng.random(waves + hills) * 2 * np.pi, hill)


class FlatKeys(RollingKeys):
    """Keys of `terrain: {kind: flat}`: none of its own."""


class Flat(TerrainShape[FlatKeys]):
    """Flat ground."""

    Parameters = FlatKeys

    def is_level(self, keys: FlatKeys) -> bool:
        return True

    def height(self, keys: FlatKeys, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        return HeightField(size_m)


ROLLING, FLAT = Rolling(), Flat()
