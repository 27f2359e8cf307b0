"""The CIE standard overcast sky, without a sun; its light depends on the sun's elevation.

No sun. Illuminance of level ground 300 + 21000 sin(elevation) lux (IES RP-21 1984, after Krochmann). The spectrum is
CIE D65 up to 700 nm. Beyond, where no standard says anything, it is the clear sky's global spectrum times the
transmittance of a cloud of water, joined to the other by their light from 600 to 700 nm: Bohren's two streams (1987)
for an optical depth of 40 and drops of 10 micrometres, whose absorption is that of water (Hale and Querry 1973).

With the sun below the horizon its light keeps that share of the clear twilight's that it has with a sun on the horizon;
the moon's light counts as that of a sun in its place. The spectrum stays D65.

The radiance is (1 + 2 sin elevation) / 3 of the zenith's (ISO 15469).

Example
-------
    sky: {kind: overcast}

References
----------
IES (1984): Recommended practice for the calculation of daylight availability. J. Illum. Eng. Soc. 13, 381-392.
Bohren, C. F. (1987): Multiple scattering of light and some of its observable consequences. Am. J. Phys. 55, 524.
Twomey, S., Bohren, C. F. (1980): Simple approximations for calculations of absorption in clouds. J. Atmos. Sci. 37.
Hale, G. M., Querry, M. R. (1973): Optical constants of water. Appl. Opt. 12, 555-563.
ISO 15469:2004 (CIE S 011): Spatial distribution of daylight, CIE standard general sky.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from forestgen.atmosphere.daylight import Daylight, illuminance
from forestgen.atmosphere.moon import moonlight_share
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.fields import violation
from forestgen.recipe.sky import SkySection
from forestgen.recipe.spectra import load_table
from forestgen.render.skies.clear import SKY as CLEAR
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, Floats, SkyModel, row_weights
from forestgen.render.skies.night import clear_daylight, night_of
from forestgen.scene.colour import Channels
from forestgen.scene.spec import Sky

_CLOUD_DEPTH, _CLOUD_ASYMMETRY, _DROP_RADIUS_UM = 40.0, 0.85, 10.0
# Wavelength in micrometres, imaginary part of water's refractive index.
_WATER = np.array(
    [
        *[(0.7, 3.35e-8), (0.75, 1.56e-7), (0.8, 1.25e-7), (0.85, 2.93e-7), (0.9, 4.86e-7), (0.95, 2.93e-6)],
        *[(1.0, 2.89e-6), (1.2, 9.89e-6), (1.4, 1.38e-4), (1.6, 8.55e-5), (1.8, 1.15e-4), (2.0, 1.1e-3)],
        *[(2.2, 2.89e-4), (2.4, 9.56e-4), (2.6, 3.17e-3), (2.8, 0.115), (3.0, 0.272), (3.4, 0.0195), (4.0, 0.0046)],
    ]
)


class OvercastKeys(SkySection):
    """An overcast sky: no keys of its own, and no clouds."""

    @model_validator(mode="after")
    def _one_kind_of_cloud(self) -> Self:
        if self.clouds.has_clouds:
            problem, hint = "an overcast sky has no single clouds", "leave out clouds, or make the sky's kind clear"
            raise violation("clouds: none", problem=problem, got=self.clouds.type, hint=hint, at=("clouds", "type"))
        return self


class Overcast(SkyModel):
    """The CIE standard overcast sky."""

    Parameters = OvercastKeys
    has_sun = False

    def daylight(self, sky: Sky) -> Daylight:
        if not sky.is_night:
            return overcast_daylight(CLEAR.daylight(sky))
        return overcast_daylight(night_of(sky).daylight, _night_illuminance(sky))

    def radiance(self, sky: Sky, light: Spectrum, channels: Channels) -> NDArray[np.floating]:
        return np.asarray(_shape()[:, None, None] * channels.of_light(light))


def overcast_illuminance(sun_elevation_deg: float) -> float:
    """Of level ground under an overcast sky, lux (IES 1984)."""
    return float(300.0 + 21000.0 * np.sin(np.radians(sun_elevation_deg)))


def _night_illuminance(sky: Sky) -> float:
    """Of level ground at night, lux: of twilight and the night's own light the share of a sun on the horizon."""
    moon, share = sky.moon_by_night, overcast_illuminance(0.0) / illuminance(clear_daylight(sky, 1e-3).on_level)
    result = share * illuminance(night_of(replace(sky, moon=None)).daylight.on_level)
    if moon is not None:
        sun = load_table("standards/spctrl2")["sun"]
        share_of_sun = moonlight_share(moon.phase_angle_deg, sun.wavelength_nm, moon.distance_km)
        light = Spectrum(sun.wavelength_nm, sun.value * share_of_sun)
        result += overcast_illuminance(moon.elevation_deg) * illuminance(light) / illuminance(sun)
    return result


def overcast_daylight(clear: Daylight, level_lux: float | None = None) -> Daylight:
    """Spectra under an overcast sky, by those of the clear one; `level_lux` None: by the sun's elevation."""
    wavelength = np.union1d(clear.sky.wavelength_nm, np.arange(300.0, 721.0, 5.0))
    visible = load_table("standards/d65")["power"].at(wavelength)
    beyond = clear.on_level.at(wavelength) * _cloud_transmittance(wavelength)
    red = (wavelength >= 600.0) & (wavelength <= 700.0)
    beyond *= np.trapezoid(visible[red], wavelength[red]) / np.trapezoid(beyond[red], wavelength[red])
    share = np.interp(wavelength, [680.0, 720.0], [1.0, 0.0])
    shape = Spectrum(wavelength, share * visible + (1.0 - share) * beyond)
    level_lux = overcast_illuminance(clear.sun_elevation_deg) if level_lux is None else level_lux
    scale = level_lux / illuminance(shape)
    none = Spectrum(clear.sun.wavelength_nm, np.zeros_like(clear.sun.value))
    return Daylight(none, Spectrum(wavelength, shape.value * scale), clear.sun_elevation_deg)


def _cloud_transmittance(wavelength_nm: Floats) -> Floats:
    """(W,) of a cloud of water drops; Bohren's two streams, the drops' absorption after Twomey and Bohren (1980)."""
    micrometres = wavelength_nm / 1000.0
    index = np.exp(np.interp(micrometres, _WATER[:, 0], np.log(_WATER[:, 1])))
    path = 4.0 * np.pi * index / micrometres * _DROP_RADIUS_UM
    absorbed = 0.5 * -np.expm1(-1.7 * path)  # of what a drop takes out of the beam; 0.85 of a weak path
    lost, turned = np.sqrt(absorbed), np.sqrt(1.0 - (1.0 - absorbed) * _CLOUD_ASYMMETRY)
    deep = (turned - lost) / (turned + lost)  # reflectance of a cloud without end
    through = np.exp(-lost * turned * _CLOUD_DEPTH)
    return np.asarray((1.0 - deep**2) * through / (1.0 - (deep * through) ** 2))


def _shape() -> Floats:
    """(MAP_ROWS // 2 + 1,) radiance over irradiance on a level plane, 1/sr."""
    theta = np.arange(MAP_ROWS // 2 + 1) * np.pi / (MAP_ROWS - 1)
    radiance = (1.0 + 2.0 * np.cos(theta)) / 3.0
    return np.asarray(radiance / (radiance @ row_weights() * MAP_COLUMNS))


SKY = Overcast()
