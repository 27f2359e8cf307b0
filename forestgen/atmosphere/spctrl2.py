"""SPCTRL2, the simple spectral model of clear skies of Bird and Riordan (1984, 1986), 300 to 4000 nm.

Light of the sun is weakened by Rayleigh scattering, aerosol, water vapour, ozone and mixed gases, each by a law of its
own; what is scattered out of the beam, and what ground and sky throw back and forth, makes the sky's light. The
equations are those of the report SERI/TR-215-2436 with the changes of NREL's program spectrl2_2.c, as pvlib has them:
without pandas, which takes seconds to load.

References
----------
Bird, R. E., Riordan, C. (1984): Simple solar spectral model for direct and diffuse irradiance on horizontal and tilted
planes at the earth's surface for cloudless atmospheres. SERI/TR-215-2436. Also J. Climate Appl. Meteor. 25 (1986) 87.
Kasten, F., Young, A. T. (1989): Revised optical air mass tables and approximation formula. Appl. Opt. 28, 4735.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# The rural aerosol of the report, but for its exponent, which belongs to the aerosol's amount.
_SCATTERING_ALBEDO_400NM, _SCATTERING_ALBEDO_SLOPE = 0.945, 0.095
_ASYMMETRY = 0.65
_PRESSURE_PA = 101300.0  # that the model's air masses refer to


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
    """(122,) nm; (122,) W/m²/nm of the sun on a plane that faces it; (122,) of the sky on a level plane.

    Parameters
    ----------
    elevation_deg : of the sun above the horizon as it is seen, in (0, 90].
    distance_au : from the earth to the sun.
    """
    wavelength, space = _coefficients()[:2]
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
def _coefficients() -> Floats:
    """(5, 122) rows: wavelength, sunlight in space, absorption by water vapour, ozone and mixed gases."""
    return np.ascontiguousarray(np.array(_TABLE.split(), dtype=np.float64).reshape(-1, 5).T)


# Table 2-1 of the report: nm; W/m²/nm at 1 astronomical unit; absorption of water vapour (1/cm), of ozone (1/cm), and
# of uniformly mixed gases (no unit).
_TABLE = """
300 0.5359 0 10 0
305 0.5583 0 4.8 0
310 0.622 0 2.7 0
315 0.6927 0 1.35 0
320 0.7151 0 0.8 0
325 0.8329 0 0.38 0
330 0.9619 0 0.16 0
335 0.9319 0 0.075 0
340 0.9006 0 0.04 0
345 0.9113 0 0.019 0
350 0.9755 0 0.007 0
360 0.9759 0 0 0
370 1.1199 0 0 0
380 1.1038 0 0 0
390 1.0338 0 0 0
400 1.4791 0 0 0
410 1.7013 0 0 0
420 1.7404 0 0 0
430 1.5872 0 0 0
440 1.837 0 0 0
450 2.005 0 0.003 0
460 2.043 0 0.006 0
470 1.987 0 0.009 0
480 2.027 0 0.014 0
490 1.896 0 0.021 0
500 1.909 0 0.03 0
510 1.927 0 0.04 0
520 1.831 0 0.048 0
530 1.891 0 0.063 0
540 1.898 0 0.075 0
550 1.892 0 0.085 0
570 1.84 0 0.12 0
593 1.768 0.075 0.119 0
610 1.728 0 0.12 0
630 1.658 0 0.09 0
656 1.524 0 0.065 0
667.6 1.531 0 0.051 0
690 1.42 0.016 0.028 0.15
710 1.399 0.0125 0.018 0
718 1.374 1.8 0.015 0
724.4 1.373 2.5 0.012 0
740 1.298 0.061 0.01 0
752.5 1.269 0.0008 0.008 0
757.5 1.245 0.0001 0.007 0
762.5 1.223 1e-05 0.006 4
767.5 1.205 1e-05 0.005 0.35
780 1.183 0.0006 0 0
800 1.148 0.036 0 0
816 1.091 1.6 0 0
823.7 1.062 2.5 0 0
831.5 1.038 0.5 0 0
840 1.022 0.155 0 0
860 0.9987 1e-05 0 0
880 0.9472 0.0026 0 0
905 0.8932 7 0 0
915 0.8682 5 0 0
925 0.8297 5 0 0
930 0.8303 27 0 0
937 0.814 55 0 0
948 0.7869 45 0 0
965 0.7683 4 0 0
980 0.767 1.48 0 0
993.5 0.7576 0.1 0 0
1040 0.6881 1e-05 0 0
1070 0.6407 0.001 0 0
1100 0.6062 3.2 0 0
1120 0.5859 115 0 0
1130 0.5702 70 0 0
1145 0.5641 75 0 0
1161 0.5442 10 0 0
1170 0.5334 5 0 0
1200 0.5016 2 0 0
1240 0.4775 0.002 0 0.05
1270 0.4427 0.002 0 0.3
1290 0.44 0.1 0 0.02
1320 0.4168 4 0 0.0002
1350 0.3914 200 0 0.00011
1395 0.3589 1000 0 1e-05
1442.5 0.3275 185 0 0.05
1462.5 0.3175 80 0 0.011
1477 0.3073 80 0 0.005
1497 0.3004 12 0 0.0006
1520 0.2928 0.16 0 0
1539 0.2755 0.002 0 0.005
1558 0.2721 0.0005 0 0.13
1578 0.2593 0.0001 0 0.04
1592 0.2469 1e-05 0 0.06
1610 0.244 0.0001 0 0.13
1630 0.2435 0.001 0 0.001
1646 0.2348 0.01 0 0.0014
1678 0.2205 0.036 0 0.0001
1740 0.1908 1.1 0 1e-05
1800 0.1711 130 0 1e-05
1860 0.1445 1000 0 0.0001
1920 0.1357 500 0 0.001
1960 0.123 100 0 4.3
1985 0.1238 4 0 0.2
2005 0.113 2.9 0 21
2035 0.1085 1 0 0.13
2065 0.0975 0.4 0 1
2100 0.0924 0.22 0 0.08
2148 0.0824 0.25 0 0.001
2198 0.0746 0.33 0 0.00038
2270 0.0683 0.5 0 0.001
2360 0.0638 4 0 0.0005
2450 0.0495 80 0 0.00015
2500 0.0485 310 0 0.00014
2600 0.0386 15000 0 0.00066
2700 0.0366 22000 0 100
2800 0.032 8000 0 150
2900 0.0281 650 0 0.13
3000 0.0248 240 0 0.0095
3100 0.0221 230 0 0.001
3200 0.0196 100 0 0.8
3300 0.0175 120 0 1.9
3400 0.0157 19.5 0 1.3
3500 0.0141 3.6 0 0.075
3600 0.0127 3.1 0 0.01
3700 0.0115 2.5 0 0.00195
3800 0.0104 1.4 0 0.004
3900 0.0095 0.17 0 0.29
4000 0.0086 0.0045 0 0.025
"""
