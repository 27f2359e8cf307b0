"""Moonlight: how much sunlight the moon returns by its phase and wavelength, and where it stands.

The irradiance of moonlight is that of sunlight times A Omega / pi, with Omega = 6.4177e-5 sr of the moon's disc at its
mean distance and the disk-equivalent reflectance A of the ROLO model (Kieffer and Stone 2005, equation 10), g the phase
angle, 0 at full moon:

    ln A = a0 + a1 g + a2 g² + a3 g³ + d1 exp(-g / p1) + d2 exp(-g / p2) + d3 cos((g - p3) / p4)

Terms of libration, and of the difference between waxing and waning moon (3%), are left out. The model is fitted from
1.55 to 97 degrees; a fuller moon counts as one of 1.55 degrees, and for a crescent the equation is extrapolated.

The position is that of the Astronomical Almanac's low-precision formulae (page D22 and before; 0.3 degrees), seen from
the place on the globe. Refraction is that of Saemundsson (1986).

References
----------
Kieffer, H. H., Stone, T. C. (2005): The spectral irradiance of the Moon. Astron. J. 129, 2887.
The Astronomical Almanac: Low-precision formulae for geocentric coordinates of the moon. U.S. Naval Observatory.
Saemundsson, T. (1986): Astronomical refraction. Sky and Telescope 72, 70.
Meeus, J. (1998): Astronomical algorithms. Willmann-Bell.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from forestgen.recipe.spectra import load_table

Floats = NDArray[np.float64]

MEAN_DISTANCE_KM = 384_400.0
_SOLID_ANGLE_SR = 6.4177e-5
_P1_DEG, _P2_DEG, _P3_DEG, _P4_DEG = 4.06054, 12.8802, -30.5858, 16.7498
_FULLEST_DEG = 1.55
_GLOBE_KM = 6378.14
_EPOCH = datetime(2000, 1, 1, 12, tzinfo=UTC)


@dataclass(frozen=True)
class MoonPosition:
    """The moon as it is seen from a place."""

    elevation_deg: float  # over the horizon, refraction included
    azimuth_deg: float  # clockwise from north, [0, 360)
    distance_km: float  # from the earth's middle


def moonlight_share(phase_angle_deg: float, wavelength_nm: Floats, distance_km: float = MEAN_DISTANCE_KM) -> Floats:
    """(W,) irradiance of moonlight over that of sunlight, both in space. The phase angle is 0 at full moon."""
    table = load_table("standards/moon")
    degrees = float(np.clip(abs(phase_angle_deg), _FULLEST_DEG, 180.0))
    g = np.radians(degrees)
    a0, a1, a2, a3, d1, d2, d3 = (table[name].value for name in ("a0", "a1", "a2", "a3", "d1", "d2", "d3"))
    log = a0 + g * (a1 + g * (a2 + g * a3))
    log = log + d1 * np.exp(-degrees / _P1_DEG) + d2 * np.exp(-degrees / _P2_DEG)
    log = log + d3 * np.cos((degrees - _P3_DEG) / _P4_DEG)
    reflectance = np.exp(np.interp(wavelength_nm, table["a0"].wavelength_nm, log))
    return np.asarray(reflectance * _SOLID_ANGLE_SR / np.pi * (MEAN_DISTANCE_KM / distance_km) ** 2)


def ecliptic_position(moment: datetime) -> tuple[float, float, float]:
    """Longitude and latitude on the ecliptic of date, degrees, and distance, km, seen from the earth's middle."""
    t = _centuries(moment)

    def total(terms: tuple[tuple[float, float, float], ...], of: np.ufunc) -> float:
        return float(sum(size * of(np.radians(start + rate * t)) for size, start, rate in terms))

    longitude = 218.32 + 481267.881 * t + total(_LONGITUDE, np.sin)
    latitude, parallax = total(_LATITUDE, np.sin), 0.9508 + total(_PARALLAX, np.cos)
    return longitude % 360.0, latitude, _GLOBE_KM / float(np.sin(np.radians(parallax)))


def moon_position(moment: datetime, latitude_deg: float, longitude_deg: float) -> MoonPosition:
    """The moon's place in the sky at a moment with its offset from UTC; north and east positive."""
    t = _centuries(moment)
    longitude, latitude, distance_km = ecliptic_position(moment)
    lam, beta, tilt = np.radians([longitude, latitude, 23.4393 - 0.0130 * t])
    x, y, z = np.cos(beta) * np.cos(lam), np.cos(beta) * np.sin(lam), np.sin(beta)
    y, z = y * np.cos(tilt) - z * np.sin(tilt), y * np.sin(tilt) + z * np.cos(tilt)
    # Greenwich mean sidereal time (Meeus 1998, equation 12.4).
    sidereal = np.radians(280.46062 + 360.98564736629 * 36525.0 * t + longitude_deg)
    place = np.radians(latitude_deg)
    hour = sidereal - np.arctan2(y, x)
    across = np.hypot(x, y)
    up = np.sin(place) * z + np.cos(place) * across * np.cos(hour)
    north = np.cos(place) * z - np.sin(place) * across * np.cos(hour)
    east = -across * np.sin(hour)
    up -= _GLOBE_KM / distance_km  # seen from the ground, not from the middle
    true = float(np.degrees(np.arctan2(up, np.hypot(north, east))))
    azimuth = float(np.degrees(np.arctan2(east, north))) % 360.0
    return MoonPosition(true + _refraction_deg(true), azimuth, distance_km)


def _refraction_deg(true_deg: float) -> float:
    return float(1.02 / 60.0 / np.tan(np.radians(true_deg + 10.3 / (true_deg + 5.11)))) if true_deg > -1.0 else 0.0


def _centuries(moment: datetime) -> float:
    return (moment - _EPOCH).total_seconds() / (36525.0 * 86400.0)


# Size in degrees, phase at the epoch and its rate a century.
_LONGITUDE = (
    (6.29, 135.0, 477198.87),
    (-1.27, 259.3, -413335.36),
    (0.66, 235.7, 890534.22),
    (0.21, 269.9, 954397.74),
    (-0.19, 357.5, 35999.05),
    (-0.11, 186.5, 966404.03),
)
_LATITUDE = (
    (5.13, 93.3, 483202.02),
    (0.28, 228.2, 960400.89),
    (-0.28, 318.3, 6003.15),
    (-0.17, 217.6, -407332.21),
)
_PARALLAX = (
    (0.0518, 135.0, 477198.87),
    (0.0095, 259.3, -413335.36),
    (0.0078, 235.7, 890534.22),
    (0.0028, 269.9, 954397.74),
)
