"""A clear sky with its sun, with clouds if there are any.

Spectra are those of SPCTRL2 (`forestgen.atmosphere.daylight`). The radiance at a wavelength is distributed as that of
Hosek and Wilkie (2012), from Mitsuba's `sunsky`. Their data go from 320 to 720 nm: the shape beyond is that at the end.

With the sun below the horizon it is twilight, and night with its moon: skies/night.py.

Example
-------
    sky: {kind: clear, turbidity: 4}

References
----------
Hosek, L., Wilkie, A. (2012): An analytic model for full spectral sky-dome radiance. ACM Trans. Graph. 31, 95.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import Daylight
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.sky import SkySection
from forestgen.render.skies.hosek import hosek_shape, radiance_by
from forestgen.render.skies.model import SkyModel
from forestgen.render.skies.night import clear_daylight, night_of
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Sky


class ClearKeys(SkySection):
    """A clear sky: no keys of its own."""


class Clear(SkyModel):
    """A clear sky with its sun, or its moon."""

    Parameters = ClearKeys

    def daylight(self, sky: Sky) -> Daylight:
        return night_of(sky).daylight if sky.is_night else clear_daylight(sky, sky.sun_elevation_deg)

    def radiance(self, sky: Sky, light: Spectrum, channels: Channels) -> NDArray[np.floating]:
        if sky.is_night:
            return night_of(sky).radiance(light, channels)
        shape = hosek_shape(sky.sun_elevation_deg, sky.sun_azimuth_deg, sky.turbidity, sky.ground_albedo)
        return radiance_by(shape, light, channels)


SKY = Clear()
