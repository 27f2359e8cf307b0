"""What a model of the sky is: spectra of sun and sky, and the sky's radiance by direction.

The radiance is on a map whose rows lie 1.4 degrees apart, one of them on the horizon; below it is black. A map eight
times as fine changes the light within 5 degrees of the sun by 0.1% and that on level ground by less; one twice as fine
already takes a simple scene 15% more time.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import Daylight
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.registries import SKIES
from forestgen.recipe.sky import SkySection
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Sky

MAP_ROWS, MAP_COLUMNS = 129, 256  # an odd number of rows: one is the horizon
Floats = NDArray[np.float64]


class SkyModel:
    """A model of the sky, which `sky.kind` names. Keys of its own are in `Sky.own`."""

    Parameters: type[SkySection]  # keys of `sky`
    has_sun: bool = True

    def daylight(self, sky: Sky) -> Daylight:
        """Spectra of the light at the ground."""
        raise NotImplementedError

    def radiance(self, sky: Sky, light: Spectrum, channels: Channels) -> NDArray[np.floating]:
        """(MAP_ROWS // 2 + 1, MAP_COLUMNS or 1, 3) radiance without the sun's disc, from the zenith to the horizon.

        `light` is what it gives a level plane, of `daylight`; for the directions see `map_directions`.
        """
        raise NotImplementedError


def casts_shadows(sky: Sky) -> bool:
    """Whether a sky has a sun that is up, or by night a moon."""
    return sky_model_of(sky).has_sun and float(sky.to_light[2]) > 0


def sky_model_of(sky: Sky) -> SkyModel:
    """The model of a scene's sky."""
    model: SkyModel = SKIES.load(sky.kind)
    return model


@lru_cache(maxsize=64)
def daylight_of(sky: Sky) -> Daylight:
    """Spectra of a sky's light."""
    return sky_model_of(sky).daylight(sky)


def map_directions(rows: int = MAP_ROWS, columns: int = MAP_COLUMNS) -> Floats:
    """(rows, columns, 3) of an equirectangular map: first and last row are zenith and nadir, columns turn x to y."""
    theta = np.arange(rows) / (rows - 1) * np.pi
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)


def row_weights() -> Floats:
    """(MAP_ROWS // 2 + 1,) solid angle of a pixel of a row times the sine of its elevation, down to the horizon."""
    step = np.pi / (MAP_ROWS - 1)
    theta = np.arange(MAP_ROWS // 2 + 1) * step
    return np.asarray(np.sin(theta) * np.cos(theta) * step * (2 * np.pi / MAP_COLUMNS))
