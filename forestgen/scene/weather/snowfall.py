"""Falling snow: flakes before the camera, and air that dims what is far.

- Flakes: N(d) = N0 exp(-slope d) per m³ and mm of melted diameter d in mm, with N0 = 3800 R^-0.87 and slope = 2.55
  R^-0.48 at R mm/h of water (Gunn and Marshall 1958). Those of less than 0.3 mm are left to the air.
- Size: a flake of mass M in mg shows M = 0.012 S^1.5 of its cross-section S in mm² (measured in Hokuriku; Papers in
  Meteorology and Geophysics 31, 1980), a disc here. Speed: 0.8 D^0.16 m/s, with M = 0.073 D^1.4 and D in mm: aggregates
  of dendrites without rime (Locatelli and Hobbs 1974). d = 1 mm is a flake of 4 mm that falls at 1 m/s. Their water is
  the rate within a fifth up to 1 mm/h; at 2.5 mm/h it is 40% more.
- A flake is a streak of its way while the shutter is open, aslant in wind, and as white as the light from all sides
  makes it: pale before trees and grey before the sky. A nearer surface hides it (render/falling.py).
- All flakes are a medium of twice their cross-section, through which light is followed as in fog. Half of what they
  scatter is bent ahead by their edges, the other half turns widely: g = 0.88 in all (from memory).
- Labels are those without it. What lies on ground and plants is `snow_cover`. `sky: {kind: overcast}` suits it.

Example
-------
    sky: {kind: overcast}
    weather: [{what: snowfall, rate_mm_per_h: 1.5}, {what: snow_cover, depth_m: 0.1}]

References
----------
Gunn, K. L. S., Marshall, J. S. (1958): The distribution with size of aggregate snowflakes. J. Meteor. 15, 452-461.
Locatelli, J. D., Hobbs, P. V. (1974): Fall speeds and masses of solid precipitation particles. J. Geophys. Res. 79,
2185-2197.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.recipe.fields import Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.weather import Weather
from forestgen.scene.spec import SceneSpec
from forestgen.scene.weather.kind import Place, Shower, WeatherKind, WeatherRequest, check_followed

Floats = NDArray[np.float64]
_ASYMMETRY = 0.88
_LEAST_MM = 0.3


class SnowfallKeys(Weather):
    """Snow that falls."""

    rate_mm_per_h: Positive = Field(1.0, le=10, description="Of water: 0.5 light, 1 moderate, 2.5 heavy.")
    shutter_s: Positive = Field(0.01, le=1, description="How long a camera without an exposure sees the flakes, s.")


def number_per_m3_mm(rate_mm_per_h: float) -> float:
    """N0 of Gunn and Marshall's distribution."""
    return float(3800.0 * rate_mm_per_h**-0.87)


def slope_per_mm(rate_mm_per_h: float) -> float:
    """Of Gunn and Marshall's distribution."""
    return float(2.55 * rate_mm_per_h**-0.48)


def seen_mm(melted_mm: Floats) -> Floats:
    """Diameter of the disc that a flake shows."""
    return np.asarray(2.0 * np.sqrt((_mass_mg(melted_mm) / 0.012) ** (2.0 / 3.0) / np.pi))


def fall_m_per_s(melted_mm: Floats) -> Floats:
    """Speed of flakes in still air."""
    return np.asarray(0.8 * (_mass_mg(melted_mm) / 0.073) ** (0.16 / 1.4))


def extinction_per_m(rate_mm_per_h: float) -> float:
    """Of all flakes, each with twice its cross-section, which goes with the square of its melted diameter."""
    per_square = 0.25 * np.pi * float(seen_mm(np.array(1.0))) ** 2
    return 2.0 * per_square * number_per_m3_mm(rate_mm_per_h) * 2.0 / slope_per_mm(rate_mm_per_h) ** 3 * 1e-6


def _mass_mg(melted_mm: Floats) -> Floats:
    return np.asarray(np.pi / 6.0 * melted_mm**3)


class Snowfall(WeatherKind[SnowfallKeys]):
    """Snow that falls."""

    Parameters = SnowfallKeys

    def check(self, keys: SnowfallKeys, drawn: DrawnRecipe, place: Place) -> None:
        check_followed(drawn, place)

    def on(self, keys: SnowfallKeys, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        rate = keys.rate_mm_per_h
        extinction = extinction_per_m(rate)
        shower = Shower(number_per_m3_mm(rate), slope_per_mm(rate), _LEAST_MM, fall_m_per_s, extinction, _ASYMMETRY)
        return shower.on(spec, request, keys.shutter_s, seen_mm, is_white=True)


KIND = Snowfall()
