"""Spectra of the sun and of the clear sky's light at the ground; an overcast sky: forestgen.render.skies.overcast.

Clear sky
---------
SPCTRL2 (Bird and Riordan 1984; spctrl2.py), 300 to 4000 nm. Haze comes in by turbidity: Angstrom's law for the
aerosol's optical depth, beta wavelength^-1.3 (micrometres), with beta = 0.04608 T - 0.04586 (Preetham, Shirley and
Smits 1999, appendix 1), so that one number drives the spectra and the sky's shape by direction. Water vapour and ozone
are by default those of the U.S. Standard Atmosphere, as in ASTM G173.

SPCTRL2's air is flat: the sky's light falls with the sine of the sun's elevation, and at 1 degree there is less than
half of what is observed. Air around a globe takes in light as 1 over the air mass, so the sky's spectrum is multiplied
by 1 / (air mass x sine): 0.5% at 30 degrees, 11% at 5, a factor of 2.2 at 1. Seidelmann's illuminances (1992, section
9.34), 1270 lux at 1 degree and 4500 at 5, are then met within 8% (4 and 14% too little or less than half without).

References
----------
Preetham, A. J., Shirley, P., Smits, B. (1999): A practical analytic model for daylight. SIGGRAPH 99, 91-100.
Seidelmann, P. K. (ed.) (1992): Explanatory Supplement to the Astronomical Almanac. University Science Books.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.spctrl2 import Air, air_mass, clear_spectra, pressure_pa
from forestgen.core.spectrum import LUMENS_PER_WATT, SECOND_RADIATION_NM_K, Spectrum
from forestgen.recipe.spectra import load_table

Floats = NDArray[np.float64]
STANDARD_WATER_MM, STANDARD_OZONE_DU = 14.16, 344.0  # U.S. Standard Atmosphere 1976
_AEROSOL_EXPONENT = 1.3  # that belongs to beta


@dataclass(frozen=True, eq=False)
class Daylight:
    """Light that reaches the ground from above, W/m²/nm."""

    sun: Spectrum  # on a plane that faces the sun; zero under a sky without one
    sky: Spectrum  # on a level plane, without the sun
    sun_elevation_deg: float

    @property
    def sun_on_level(self) -> Spectrum:
        """The sun's light on a level plane."""
        sine = float(np.sin(np.radians(self.sun_elevation_deg)))
        return Spectrum(self.sun.wavelength_nm, self.sun.value * sine)

    @property
    def on_level(self) -> Spectrum:
        """Light of sun and sky together on a level plane."""
        return Spectrum(self.sky.wavelength_nm, self.sky.value + self.sun_on_level.at(self.sky.wavelength_nm))


def aerosol_optical_depth(turbidity: float, wavelength_nm: float = 500.0) -> float:
    """Of the whole air column at a wavelength; Angstrom's law with the beta of Preetham, Shirley and Smits (1999)."""
    beta = max(0.04608365822050 * turbidity - 0.04586025928522, 0.0)
    return float(beta * (wavelength_nm / 1000.0) ** -_AEROSOL_EXPONENT)


@lru_cache(maxsize=64)
def daylight(
    sun_elevation_deg: float,
    turbidity: float,
    ground_albedo: float = 0.2,
    altitude_m: float = 0.0,
    *,
    sun_distance_au: float = 1.0,
    precipitable_water_mm: float = STANDARD_WATER_MM,
    ozone_du: float = STANDARD_OZONE_DU,
) -> Daylight:
    """Spectra of sun and clear sky, by the sun's elevation and the air.

    Parameters
    ----------
    sun_elevation_deg : of the sun as it is seen, refraction included, in (0, 90].
    turbidity : 1 is pure air, 10 hazy.
    ground_albedo : of the region, [0, 1]: a clear sky throws some of its light back.
    altitude_m : above sea level, which sets the air's pressure.
    sun_distance_au : from the earth; over a year from 0.983 (January) to 1.017 (July).
    precipitable_water_mm : precipitable water, kg/m².
    ozone_du : Dobson units.

    Raises
    ------
    ValueError : the sun is not above the horizon.
    """
    if not 0.0 < sun_elevation_deg <= 90.0:
        raise ValueError(f"the sun must stand above the horizon, up to 90 degrees, not at {sun_elevation_deg:g}")
    air = Air(
        aerosol_500nm=aerosol_optical_depth(turbidity),
        aerosol_exponent=_AEROSOL_EXPONENT,
        water_cm=precipitable_water_mm / 10.0,
        ozone_cm=ozone_du / 1000.0,
        pressure_pa=pressure_pa(altitude_m),
    )
    wavelength, sun, sky = clear_spectra(sun_elevation_deg, air, ground_albedo, sun_distance_au)
    sky = sky / (air_mass(sun_elevation_deg) * np.sin(np.radians(sun_elevation_deg)))  # of air around a globe
    return Daylight(Spectrum(wavelength, sun), Spectrum(wavelength, sky), sun_elevation_deg)


def illuminance(irradiance: Spectrum) -> float:
    """Lux of an irradiance in W/m²/nm; or cd/m² of a radiance."""
    return float(LUMENS_PER_WATT * _tristimulus(irradiance)[1])


def colour_temperature(light: Spectrum) -> tuple[float, float]:
    """Correlated colour temperature in kelvins, and the distance from Planck's locus (Duv, above it positive).

    The nearest point of the locus in the uv plane of 1960 (CIE 015:2018), from 1000 to 100,000 K. Farther than 0.05
    from it the temperature means nothing.
    """
    kelvins, locus = _planck_locus()
    u, v = _uv(_tristimulus(light))
    distance = np.hypot(locus[:, 0] - u, locus[:, 1] - v)
    k = int(np.clip(np.argmin(distance), 1, len(kelvins) - 2))
    # The vertex of the parabola through three squared distances, over the logarithm of the temperature.
    before, here, after = distance[k - 1 : k + 2] ** 2
    shift = float(np.clip(0.5 * (before - after) / (before - 2.0 * here + after), -1.0, 1.0))
    least = float(np.sqrt(max(here - 0.25 * (before - after) * shift, 0.0)))
    temperature = float(kelvins[k] * (kelvins[k + 1] / kelvins[k]) ** shift)
    above = v > float(np.interp(shift, [-1.0, 0.0, 1.0], locus[k - 1 : k + 2, 1]))
    return temperature, least if above else -least


def _tristimulus(light: Spectrum) -> Floats:
    """(3,) CIE XYZ of 1931, Y in the light's unit."""
    wavelength, matching = _observer()
    return np.asarray(matching @ light.at(wavelength))


def _uv(xyz: Floats) -> Floats:
    """(2, ...) of (3, ...)."""
    x, y, z = xyz
    return np.asarray(np.stack([4.0 * x, 6.0 * y]) / (x + 15.0 * y + 3.0 * z))


@cache
def _planck_locus() -> tuple[Floats, Floats]:
    """(T,) kelvins in equal ratios, (T, 2) uv of black bodies."""
    wavelength, matching = _observer()
    kelvins = np.geomspace(1e3, 1e5, 2001)
    with np.errstate(over="ignore"):
        power = wavelength**-5.0 / np.expm1(SECOND_RADIATION_NM_K / (wavelength * kelvins[:, None]))
    return kelvins, _uv(matching @ power.T).T


@cache
def _observer() -> tuple[Floats, Floats]:
    """(W,) nm, steps of 1; (3, W) CIE 1931 colour matching functions."""
    matching = load_table("responses/cie_1931")
    return matching["x"].wavelength_nm, np.stack([matching[name].value for name in "xyz"])
