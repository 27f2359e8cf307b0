"""Rolling ground, a finite sum of waves of random directions; and flat ground, z = 0.

The site's relief has a standard deviation of `amplitude_m` and wavelengths from `wavelength_m` down to 1/8 of it, of
which long ones carry most of the height, as on eroded land. Around it, from some hundred metres on, stand hills with a
standard deviation of `hills_m`; `site.surroundings` covers them with the stand's forest.

Hills are `OCTAVES` of waves, from 3000 m on each half as long and `_LOWER` times as high as the one before. Their
two-dimensional power spectrum goes with the wave number as k^-3.6 from 1500 to 300 m. On real land differences of
height grow with the root of the distance, which is k^-3 (Lovejoy et al. 1995), and power falls more steeply beyond the
length of a slope (Perron et al. 2008). The second octave is folded, so that hills have crests, the third the other way:
spurs with valleys between. It has more weight the higher the land is (after Musgrave's ridged multifractal, 2003).
Shares are ours. The mesh's cells are coarse for the spurs: what stands far away stands on the mesh.

References
----------
Lovejoy, S., Lavallée, D., Schertzer, D., Ladoy, P. (1995). The l^1/2 law and multifractal topography: theory and
analysis. Nonlinear Processes in Geophysics 2, 16-22.
Musgrave, F. K. (2003). Procedural fractal terrains. In: Texturing & Modeling, third edition.
Perron, J. T., Kirchner, J. W., Dietrich, W. E. (2008). Spectral signatures of characteristic spatial scales and
nonfractal structure in landscapes. Journal of Geophysical Research 113, F04003.

Example
-------
    site: {terrain: {kind: rolling, amplitude_m: 3, wavelength_m: 80, hills_m: 60}, surroundings: forest}

Parameters: see below.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Number, Positive
from forestgen.recipe.schema import Terrain
from forestgen.scene.terrain import MARGIN_M, HeightField, TerrainShape, smooth_step

HILLS_FROM_M, HILLS_TO_M = 250.0, 6000.0
HILL_M, OCTAVES, _HILL_WAVES = 3000.0, 3, 6  # longest waves of hills; octaves; waves of each
_CELL_M = 94.0  # of the mesh on hills: at least three along a wave of the last octave, which folding makes half as long
_UNUSED = 10  # numbers drawn for hills of older versions: sites keep their ground
_LOWER = 0.43  # height of an octave by that of the one before
_BEND = 0.7  # radians per standard deviation of the height: spurs bend with the land
_CREST = 0.5  # of the standard deviation of an octave: rounds its crests
_PER_RIDGE = 1 / np.sqrt(1 - 2 / np.pi)  # of the magnitude of a Gaussian variable, for unit variance
_MEAN_RIDGE = _PER_RIDGE * np.sqrt(2 / np.pi)


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

    Near waves fade out over a wavelength away from the site, where the mesh is too coarse to carry them; hills fade in
    from `HILLS_FROM_M` on, so that the site keeps its own relief, and out from `HILLS_TO_M` on.
    """

    wave_per_m: NDArray[np.float64]  # (M, 2) angular wave vectors
    amplitude_m: NDArray[np.float64]  # (M,)
    phase: NDArray[np.float64]  # (M,)
    octave: NDArray[np.intp]  # (M,) of hills, from 1 on; 0: a wave of the site
    hills_m: float = 0.0  # what the sum of the octaves is multiplied by

    @property
    def coarsest_m(self) -> tuple[float, float]:
        return (_CELL_M, HILLS_TO_M) if self.hills_m > 0 else super().coarsest_m

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        z = np.zeros(x_m.shape)
        away = self.distance_m(x_m, y_m)
        for k, amplitude, phase in self._of(0):
            fade = 1 - smooth_step((away - MARGIN_M) * np.hypot(*k) / (2 * np.pi))
            z += amplitude * fade * np.sin(k[0] * x_m + k[1] * y_m + phase)
        far = np.flatnonzero(away > HILLS_FROM_M) if self.hills_m > 0 else np.empty(0, dtype=np.intp)
        if len(far):
            grown = smooth_step((away[far] - HILLS_FROM_M) / (6 * HILLS_FROM_M))
            z[far] += self.hills_m * grown * self.hills(x_m[far], y_m[far], away[far])
        return z

    def hills(
        self, x_m: NDArray[np.float64], y_m: NDArray[np.float64], away_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(N,) height of hills at (N,) points so far from the site, over the field's `hills_m`."""
        z, weight = np.zeros(len(x_m)), np.ones(len(x_m))
        for octave in range(1, OCTAVES + 1):
            wave = np.zeros(len(x_m))
            for k, amplitude, phase in self._of(octave):
                wave += amplitude * np.sin(k[0] * x_m + k[1] * y_m + phase + _BEND * z)
            if octave > 1:  # crests of the second octave, valleys of finer ones
                folded = _PER_RIDGE * np.sqrt(wave**2 + _CREST**2) - _MEAN_RIDGE
                wave = -folded if octave == 2 else folded
            size = _LOWER ** (octave - 1)
            z += size * weight * wave * (1 - smooth_step((away_m - HILLS_TO_M) / (4 * HILL_M * 0.5 ** (octave - 1))))
            weight = np.clip(0.55 + 0.35 * z, 0.2, 1.0)
        return z

    def _of(self, octave: int) -> Iterable[tuple[NDArray[np.float64], float, float]]:
        """Wave vector, amplitude and phase of the waves of an octave."""
        own = self.octave == octave
        return zip(self.wave_per_m[own], self.amplitude_m[own], self.phase[own], strict=True)


def rolling(
    size_m: tuple[float, float],
    amplitude_m: float,
    wavelength_m: float,
    rng: np.random.Generator,
    hills_m: float = 22.0,
) -> Waves:
    """Gently rolling ground: standard deviation `amplitude_m`, wavelengths from `wavelength_m` down to 1/8 of it.

    Around it, from some hundred metres on, hills with a standard deviation of `hills_m`; none around level ground.
    """
    waves, octave = 24, np.repeat(np.arange(1, OCTAVES + 1), _HILL_WAVES)
    drawn = rng.random((3, waves + _UNUSED))[:, :waves]
    wavelength = wavelength_m * 0.5 ** (3.0 * drawn[0])
    weight = wavelength**2  # long waves carry most of the height, as on eroded land
    weight *= amplitude_m * np.sqrt(2.0 / np.sum(weight**2))
    hill = rng.random((3, len(octave)))
    hill[1] = 0.5 * (np.arange(len(octave)) + hill[1]) / _HILL_WAVES  # ways on all sides, half a circle by octave
    wavelength = np.append(wavelength, HILL_M * 0.5 ** (octave - 1.0 + 0.4 * hill[0]))
    _, turn, phase = 2 * np.pi * np.concatenate([drawn, hill], axis=1)
    field = Waves(
        size_m,
        (2 * np.pi / wavelength * np.stack([np.cos(turn), np.sin(turn)])).T,
        np.append(weight, np.full(len(octave), np.sqrt(2.0 / _HILL_WAVES))),
        phase,
        np.append(np.zeros(waves, dtype=np.intp), octave),
    )
    if hills_m == 0 or amplitude_m == 0:
        return field
    x, y = HILLS_TO_M * (2.0 * rng.random((2, 4096)) - 1.0)
    return replace(field, hills_m=hills_m / float(field.hills(x, y, np.zeros(len(x))).std()))


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
