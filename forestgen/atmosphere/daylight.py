"""Sunlight: where the sun stands, and spectra of the sun and of the clear sky at the ground.

`forestgen.render.skies.overcast` has the overcast sky.

Clear sky
---------
SPCTRL2, the simple spectral model of Bird and Riordan (1984, 1986), 300 to 4000 nm. Light of the sun is weakened by
Rayleigh scattering, aerosol, water vapour, ozone and mixed gases, each by a law of its own; what is scattered out of
the beam, and what ground and sky throw back and forth, makes the sky's light. The equations are those of the report
SERI/TR-215-2436 with the changes of NREL's program spectrl2_2.c, as pvlib has them: without pandas, which takes seconds
to load. Numbers of equations below are the report's.

Haze comes in by turbidity: Angstrom's law for the aerosol's optical depth, beta wavelength^-1.3 (micrometres), with
beta = 0.04608 T - 0.04586 (Preetham, Shirley and Smits 1999, appendix 1), so that one number drives the spectra and the
sky's shape by direction. Water vapour and ozone are by default those of the U.S. Standard Atmosphere, as in ASTM G173.

SPCTRL2's air is flat: the sky's light falls with the sine of the sun's elevation, and at 1 degree there is less than
half of what is observed. Air around a globe takes in light as 1 over the air mass, so the sky's spectrum is multiplied
by 1 / (air mass x sine): 0.5% at 30 degrees, 11% at 5, a factor of 2.2 at 1. Seidelmann's illuminances (1992, section
9.34), 1270 lux at 1 degree and 4500 at 5, are then met within 8% (4 and 14% too little or less than half without).

Position of the sun
-------------------
NREL's solar position algorithm (Reda and Andreas 2004), in pvlib's implementation: within 0.0003 degrees of the
almanac from the year -2000 to 6000. Refraction lifts a low sun: the elevation is that at which it is seen, for the air
pressure of the place's altitude and 12 degrees Celsius.

References
----------
Elsasser, W. M. (1942): Heat transfer by infrared radiation in the atmosphere. Harvard Meteorological Studies 6.
Bird, R. E., Riordan, C. (1984): Simple solar spectral model for direct and diffuse irradiance on horizontal and tilted
planes at the earth's surface for cloudless atmospheres. SERI/TR-215-2436. Also J. Climate Appl. Meteor. 25 (1986) 87.
Kasten, F., Young, A. T. (1989): Revised optical air mass tables and approximation formula. Appl. Opt. 28, 4735.
Preetham, A. J., Shirley, P., Smits, B. (1999): A practical analytic model for daylight. SIGGRAPH 99, 91-100.
Reda, I., Andreas, A. (2004): Solar position algorithm for solar radiation applications. Solar Energy 76, 577-589.
Anderson, K. S., et al. (2023): pvlib python: 2023 project update. J. Open Source Softw. 8, 5994.
Seidelmann, P. K. (ed.) (1992): Explanatory Supplement to the Astronomical Almanac. University Science Books.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMENS_PER_WATT, SECOND_RADIATION_NM_K, Spectrum
from forestgen.recipe.spectra import load_table

Floats = NDArray[np.float64]

# The rural aerosol of the report, but for its exponent, which belongs to the aerosol's amount.
_SCATTERING_ALBEDO_400NM, _SCATTERING_ALBEDO_SLOPE = 0.945, 0.095
_ASYMMETRY = 0.65
_PRESSURE_PA = 101300.0  # that the model's air masses refer to
STANDARD_WATER_MM, STANDARD_OZONE_DU = 14.16, 344.0  # U.S. Standard Atmosphere 1976
_AEROSOL_EXPONENT = 1.3  # that belongs to beta
_MEAN_TEMPERATURE_C = 12.0
_HORIZON_LIFT_DEG, _UNLIFTED_DEG = 0.57, 6.0  # by refraction at the horizon; depth of a sun that is not lifted
AEROSOL_SCALE_M, _VAPOUR_SCALE_M = 1500.0, 2000.0  # heights in which they thin by e
_DIFFUSE_MASS = 1.66


@dataclass(frozen=True)
class Air:
    """What light meets on its way down."""

    aerosol_500nm: float  # optical depth
    aerosol_exponent: float  # Angstrom's: depth ~ wavelength^-exponent
    water_cm: float  # precipitable
    ozone_cm: float  # at standard pressure and temperature
    pressure_pa: float


def pressure_pa(altitude_m: float) -> float:
    """Of the standard atmosphere at a height above sea level."""
    return float(100.0 * ((44331.514 - altitude_m) / 11880.516) ** (1.0 / 0.1902632))


def air_mass(elevation_deg: float) -> float:
    """Relative optical air mass by the sun's apparent elevation (Kasten and Young 1989, equation 3)."""
    sine = np.sin(np.radians(elevation_deg))
    return float(1.0 / (sine + 0.50572 * (elevation_deg + 6.07995) ** -1.6364))


def clear_spectra(
    elevation_deg: float, air: Air, ground_albedo: float, distance_au: float
) -> tuple[Floats, Floats, Floats]:
    """(122,) nm; W/m²/nm of the sun, as it is seen in (0, 90] degrees, facing it; of the sky on a level plane."""
    wavelength, space, *_ = _coefficients()
    space = space / distance_au**2
    sine = float(np.sin(np.radians(elevation_deg)))
    rayleigh, aerosol, gases, scattering, absorption = _transmittances(air, elevation_deg, air_mass(elevation_deg))
    sun = space * rayleigh * aerosol * gases
    # Forward scattering by aerosol, equations 3-11 to 3-15.
    log = np.log(1.0 - _ASYMMETRY)
    a = log * (1.459 + log * (0.1595 + log * 0.4129))
    b = log * (0.0783 + log * (-0.3824 - log * 0.5874))
    forward = 1.0 - 0.5 * np.exp((a + b * sine) * sine)
    forward_back = 1.0 - 0.5 * np.exp((a + b / 1.8) / 1.8)
    # What the sky throws back of the light from the ground: at an air mass of 1.8, equation 3-8 as the program has it.
    rayleigh_back, _, gases_back, scattering_back, absorption_back = _transmittances(
        air, elevation_deg, 1.8, with_ozone=False
    )
    sky_albedo = (
        gases_back
        * absorption_back
        * (0.5 * (1 - rayleigh_back) + (1 - forward_back) * rayleigh_back * (1 - scattering_back))
    )
    down = space * sine * gases * absorption
    by_air = down * (1.0 - rayleigh**0.95) * 0.5
    by_aerosol = down * rayleigh**1.5 * (1.0 - scattering) * forward
    again = (sun * sine + by_air + by_aerosol) * sky_albedo * ground_albedo / (1.0 - sky_albedo * ground_albedo)
    violet = np.where(wavelength <= 450.0, ((wavelength + 550.0) / 1000.0) ** 1.8, 1.0)  # equation 3-17
    return wavelength, sun, (by_air + by_aerosol + again) * violet


def _transmittances(
    air: Air, elevation_deg: float, mass: float, *, with_ozone: bool = True
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """(122,) each: of air, of aerosol, of gases that absorb, of aerosol's scattering and of its absorption alone."""
    wavelength, _, water, ozone, mixed = _coefficients()
    micrometres = wavelength / 1000.0
    full_mass = mass * air.pressure_pa / _PRESSURE_PA
    rayleigh = np.exp(-full_mass / (micrometres**4 * (115.6406 - 1.3366 / micrometres**2)))  # 2-4
    depth = air.aerosol_500nm * (wavelength / 500.0) ** -air.aerosol_exponent * mass  # 2-7
    albedo = _SCATTERING_ALBEDO_400NM * np.exp(-_SCATTERING_ALBEDO_SLOPE * np.log(wavelength / 400.0) ** 2)  # 3-16
    wet = water * air.water_cm * mass
    gases = np.exp(-0.2385 * wet / (1.0 + 20.07 * wet) ** 0.45)  # 2-8
    dry = mixed * full_mass
    gases = gases * np.exp(-1.41 * dry / (1.0 + 118.3 * dry) ** 0.45)  # 2-11
    if with_ozone:
        height = 22.0 / 6370.0  # of the ozone, in radii of the earth
        ozone_mass = (1.0 + height) / np.sqrt(np.sin(np.radians(elevation_deg)) ** 2 + 2.0 * height)  # 2-10
        gases = gases * np.exp(-ozone * air.ozone_cm * ozone_mass)  # 2-9
    return rayleigh, np.exp(-depth), gases, np.exp(-albedo * depth), np.exp(-(1.0 - albedo) * depth)


@cache
def _coefficients() -> tuple[Floats, ...]:
    """(122,) each: wavelength, sunlight in space, absorption by water vapour, ozone and mixed gases (table 2-1)."""
    table = load_table("standards/spctrl2")
    return table["sun"].wavelength_nm, *(table[name].value for name in ("sun", "water", "ozone", "mixed_gases"))


@dataclass(frozen=True, eq=False)
class Daylight:
    """Light that reaches the ground from above, W/m²/nm. By night the moon is in the place of the sun."""

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


def air_of(turbidity: float, altitude_m: float, precipitable_water_mm: float, ozone_du: float) -> Air:
    """Air over a place above sea level; see `daylight`."""
    return Air(
        aerosol_500nm=aerosol_optical_depth(turbidity),
        aerosol_exponent=_AEROSOL_EXPONENT,
        water_cm=precipitable_water_mm / 10.0,
        ozone_cm=ozone_du / 1000.0,
        pressure_pa=pressure_pa(altitude_m),
    )


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
    """Spectra of sun and clear sky, by the sun's elevation and the air. ValueError: the sun is below the horizon.

    Parameters
    ----------
    sun_elevation_deg : of the sun as it is seen, refraction included, in (0, 90].
    turbidity : 1 is pure air, 10 hazy.
    ground_albedo : of the region, [0, 1]: a clear sky throws some of its light back.
    altitude_m : above sea level, which sets the air's pressure.
    sun_distance_au : from the earth; over a year from 0.983 (January) to 1.017 (July).
    precipitable_water_mm, ozone_du : kg/m², Dobson units.
    """
    if not 0.0 < sun_elevation_deg <= 90.0:
        raise ValueError(f"the sun must stand above the horizon, up to 90 degrees, not at {sun_elevation_deg:g}")
    air = air_of(turbidity, altitude_m, precipitable_water_mm, ozone_du)
    wavelength, sun, sky = clear_spectra(sun_elevation_deg, air, ground_albedo, sun_distance_au)
    sky = sky / (air_mass(sun_elevation_deg) * np.sin(np.radians(sun_elevation_deg)))  # of air around a globe
    return Daylight(Spectrum(wavelength, sun), Spectrum(wavelength, sky), sun_elevation_deg)


def sunlight_aloft(light: Spectrum, sun_elevation_deg: float, air: Air, altitude_m: float, height_m: float) -> Spectrum:
    """Sunlight as clouds at a height above the ground scatter it down to the ground, of that `light` at the ground.

    It has not come through the air below the clouds on the sun's way, but once through it on its way down, by the
    diffusivity factor 1.66 (Elsasser 1942) of light from all directions. The aerosol thins by e in 1500 m, vapour in
    2000 m. With the sun higher than 37 degrees, where its own way is the shorter one, the light stays as it is.
    """
    mass = air_mass(sun_elevation_deg)
    if mass <= _DIFFUSE_MASS:
        return light
    thinned = Air(
        air.aerosol_500nm * float(np.exp(-height_m / AEROSOL_SCALE_M)),
        air.aerosol_exponent,
        air.water_cm * float(np.exp(-height_m / _VAPOUR_SCALE_M)),
        air.ozone_cm,
        air.pressure_pa * pressure_pa(altitude_m + height_m) / pressure_pa(altitude_m),
    )

    def through(one: Air, mass: float) -> Floats:
        rayleigh, aerosol, gases, *_ = _transmittances(one, sun_elevation_deg, mass, with_ozone=False)
        return np.maximum(rayleigh * aerosol * gases, 1e-9)

    gain = through(thinned, mass) / through(air, mass) * through(air, _DIFFUSE_MASS) / through(thinned, _DIFFUSE_MASS)
    return Spectrum(light.wavelength_nm, light.value * np.interp(light.wavelength_nm, _coefficients()[0], gain))


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


@dataclass(frozen=True)
class SunPosition:
    """The sun as it is seen from a place."""

    elevation_deg: float  # over the horizon, refraction included
    azimuth_deg: float  # clockwise from north, [0, 360)
    distance_au: float  # from the earth


@lru_cache(maxsize=256)
def sun_position(
    moment: datetime,
    latitude_deg: float,
    longitude_deg: float,
    altitude_m: float = 0.0,
    *,
    air_pressure_pa: float | None = None,
    temperature_c: float = _MEAN_TEMPERATURE_C,
) -> SunPosition:
    """The sun's place in the sky at a moment with its offset from UTC (ValueError without); north and east positive.

    `air_pressure_pa` None is that of the standard atmosphere at the altitude above sea level.
    """
    if moment.tzinfo is None:
        raise ValueError("a moment needs its offset from UTC")
    import pandas
    from pvlib.solarposition import nrel_earthsun_distance, spa_python

    air_pressure_pa = pressure_pa(altitude_m) if air_pressure_pa is None else air_pressure_pa
    times = pandas.DatetimeIndex([moment])
    one = spa_python(
        times,
        latitude_deg,
        longitude_deg,
        altitude=altitude_m,
        pressure=air_pressure_pa,
        temperature=temperature_c,
        delta_t=None,  # by year and month
    ).iloc[0]
    distance = nrel_earthsun_distance(times, delta_t=None).iloc[0]
    # Below the horizon refraction lifts less and less, down to _UNLIFTED_DEG, so that the sun sinks steadily.
    lift = _HORIZON_LIFT_DEG * air_pressure_pa / _PRESSURE_PA
    sunk = float(one["elevation"]) + lift * min(max(1.0 + float(one["elevation"]) / _UNLIFTED_DEG, 0.0), 1.0)
    seen = float(one["apparent_elevation"])
    return SunPosition(seen if seen > 0 else min(sunk, 0.0), float(one["azimuth"]) % 360.0, float(distance))
