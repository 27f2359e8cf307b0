"""Grounds without a pattern of their own: soil, grass, rock, sand and snow, whose brightness is uneven.

Water darkens dry soil, rock and sand. Wet soil stays as it is, and so do grass and snow, for which the relation in
`forestgen.scene.surfaces` does not hold. Around a site under snow, 40% of the woods and meadows lie under it.

Example
-------
    site: {ground: soil_dry}
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.scene.terrain import GroundCover, tile_noise

SNOW_AFAR = 0.4  # share of woods and meadows that lies under snow


class Uneven(GroundCover):
    """A ground of one colour and uneven brightness.

    Parameters
    ----------
    patches, grains : standard deviations of brightness in patches of metres and in grains of centimetres.
    """

    def __init__(self, table: str, patches: float, grains: float, *, darkens_when_wet: bool = False) -> None:
        super().__init__(table, darkens_when_wet=darkens_when_wet)
        self._patches, self._grains = patches, grains

    def pattern(self, rng: np.random.Generator) -> NDArray[np.float32]:
        patches, grains = self._patches, self._grains
        tone = 1 + patches * tile_noise(6.0, 0.25, 2.4, rng) + grains * tile_noise(0.25, 0.032, 0.5, rng)
        return np.repeat(np.clip(tone, 0.2, 2.0).astype(np.float32)[..., None], 3, axis=2)


class Moist(Uneven):
    """Soil halfway between dry and wet."""

    def reflectance(self) -> Spectrum:
        dry, wet = super().reflectance(), SOIL_WET.reflectance()
        return Spectrum(dry.wavelength_nm, 0.5 * (dry.value + wet.at(dry.wavelength_nm)))


class Snow(Uneven):
    """Snow, on the site and on a share of the land around."""

    def far_reflectance(self) -> Spectrum:
        near, far = self.reflectance(), super().far_reflectance()
        grid = np.union1d(far.wavelength_nm, near.wavelength_nm)
        return Spectrum(grid, (1 - SNOW_AFAR) * far.at(grid) + SNOW_AFAR * near.at(grid))


SOIL_DRY = Uneven("soil_dry", 0.10, 0.16, darkens_when_wet=True)
SOIL_WET = Uneven("soil_wet", 0.16, 0.20)
SOIL_MOIST = Moist("soil_dry", 0.16, 0.20)
GRAVEL = Uneven("gravel", 0.08, 0.30, darkens_when_wet=True)
GRASS = Uneven("grass", 0.14, 0.30)
ROCK = Uneven("rock", 0.20, 0.12, darkens_when_wet=True)
NEEDLES = Uneven("litter_needles", 0.12, 0.22, darkens_when_wet=True)
DEAD_GRASS = Uneven("litter_grass", 0.14, 0.25, darkens_when_wet=True)
SAND = Uneven("sand", 0.04, 0.08, darkens_when_wet=True)
SNOW = Snow("snow", 0.004, 0.002)
