"""Of another package: a valley, a ground of stripes, and a sky of one brightness."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.atmosphere.daylight import Daylight
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.schema import Terrain
from forestgen.recipe.sky import SkySection
from forestgen.render.skies.model import MAP_ROWS, SkyModel
from forestgen.render.skies.overcast import SKY as OVERCAST
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Sky
from forestgen.scene.terrain import TEXTURE_PX, GroundCover, HeightField, TerrainShape


class ValleyKeys(Terrain):
    slope: float = Field(0.1, gt=0, lt=1)


@dataclass(frozen=True, eq=False)
class ValleyHeight(HeightField):
    slope: float

    def _height(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.slope * np.abs(np.clip(x_m, 0.0, self.size_m[0]) - self.size_m[0] / 2)


class Valley(TerrainShape[ValleyKeys]):
    Parameters = ValleyKeys

    def height(self, keys: ValleyKeys, size_m: tuple[float, float], image_seed: int, folder: Path) -> HeightField:
        return ValleyHeight(size_m, keys.slope)


class Stripes(GroundCover):
    def pattern(self, rng: np.random.Generator) -> NDArray[np.float32]:
        pattern = np.ones((TEXTURE_PX, TEXTURE_PX, 3), dtype=np.float32)
        pattern[::2] = 0.5
        return pattern


class EvenKeys(SkySection):
    share: float = Field(1.0, gt=0)


class Even(SkyModel):
    Parameters = EvenKeys
    has_sun = False

    def daylight(self, sky: Sky) -> Daylight:
        whole = OVERCAST.daylight(sky)
        light = Spectrum(whole.sky.wavelength_nm, whole.sky.value * dict(sky.own)["share"])
        return Daylight(whole.sun, light, whole.sun_elevation_deg)

    def radiance(self, sky: Sky, light: Spectrum, channels: Channels) -> NDArray[np.floating]:
        return np.ones((MAP_ROWS // 2 + 1, 1, 1)) * channels.of_light(light) / np.pi


VALLEY, STRIPES, EVEN = Valley(), Stripes("sand"), Even()
