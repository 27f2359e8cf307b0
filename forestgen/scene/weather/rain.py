"""Rain: streaks before the camera, air that dims what is far, and wet leaves, bark and ground.

- Drops: N(D) = 8000 exp(-4.1 R^-0.21 D) per m³ and mm of diameter D in mm, at R mm/h (Marshall and Palmer 1948). They
  fall at 9.65 - 10.3 exp(-0.6 D) m/s (Atlas, Srivastava and Sekhon 1973, after Gunn and Kinzer 1949).
- Streaks: a drop that the shutter sees for T seconds is a line of its way in T, aslant in wind. It refracts light of a
  wide part of the scene behind it (Garg and Nayar 2007, a field of 165 degrees): it is as bright as the image's mean,
  and covers what it passes by its share of the time. A nearer surface hides it (render/falling.py).
- All drops are a medium of twice their cross-section, pi N0 / slope³, through which light is followed as in fog; it
  turns by few degrees (Henyey and Greenstein's g = 0.95).
- Wet surfaces: wood, ground and fallen leaves darken as under a film of water (scene/surfaces.py), which mirrors as
  water does. On stems the film lies in streaks where water runs down, and where rain falls on them, aslant in wind;
  living leaves have it on top (render/identity/weather.py). Leaves do not sag: labels would change.
- Puddles stand in hollows of paths and roads, where the ground is trodden (scene/puddles.py), and are seen alone.
- Streaks are faint: a drop of 2 mm covers a pixel of its streak for 3% of an exposure of 0.01 s.
- Labels are those without rain. The sky is the recipe's: `sky: {kind: overcast}` suits rain.

Example
-------
    sky: {kind: overcast}
    weather: [{what: rain, rate_mm_per_h: 15}]

References
----------
Marshall, J. S., Palmer, W. McK. (1948): The distribution of raindrops with size. J. Meteor. 5, 165-166.
Gunn, R., Kinzer, G. D. (1949): The terminal velocity of fall for water droplets in stagnant air. J. Meteor. 6, 243-248.
Atlas, D., Srivastava, R. C., Sekhon, R. S. (1973): Doppler radar characteristics of precipitation at vertical
incidence. Rev. Geophys. 11, 1-35.
Garg, K., Nayar, S. K. (2007): Vision and rain. Int. J. Comput. Vis. 75, 3-27.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.recipe.fields import Fraction, Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import SKIES
from forestgen.recipe.spectra import load_table
from forestgen.recipe.weather import Weather
from forestgen.scene.puddles import puddles_m
from forestgen.scene.spec import SceneSpec, WetFilm
from forestgen.scene.terrain import HeightField
from forestgen.scene.weather.kind import (
    Place,
    Shower,
    WeatherKind,
    WeatherRequest,
    check_followed,
    wind_m_per_s,
)

_N0_PER_M3_MM, _LEAST_MM = 8000.0, 0.5
_MEDIAN_VOLUME = 3.67  # of drops, half of the water is in those above: their diameter times the slope
_ASYMMETRY = 0.95
_DRIED_M = 0.1  # of puddles, where all is dry


class RainKeys(Weather):
    """Rain."""

    rate_mm_per_h: Positive = Field(8.0, le=200, description="How much falls: 2 light, 8 moderate, 30 heavy.")
    shutter_s: Positive = Field(
        0.01, le=1, description="How long a camera without an exposure sees the drops, seconds."
    )
    wet: Fraction = Field(1.0, description="How wet plants and ground are: 0 dry, 1 under a film of water.")


def slope_per_mm(rate_mm_per_h: float) -> float:
    """Of Marshall and Palmer's distribution."""
    return float(4.1 * rate_mm_per_h**-0.21)


def fall_m_per_s(diameter_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Speed of drops of 0.6 mm and more in still air; smaller ones are slower."""
    return np.asarray(np.maximum(9.65 - 10.3 * np.exp(-0.6 * diameter_mm), 0.1))


def extinction_per_m(rate_mm_per_h: float) -> float:
    """Of all drops, each with twice its cross-section: pi N0 / slope³ in mm²/m³."""
    return float(np.pi * _N0_PER_M3_MM / slope_per_mm(rate_mm_per_h) ** 3 * 1e-6)


class Rain(WeatherKind[RainKeys]):
    """Rain."""

    Parameters = RainKeys

    def check(self, keys: RainKeys, drawn: DrawnRecipe, place: Place) -> None:
        check_followed(drawn, place)

    def on(self, keys: RainKeys, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        slope, extinction = slope_per_mm(keys.rate_mm_per_h), extinction_per_m(keys.rate_mm_per_h)
        shower = Shower(_N0_PER_M3_MM, slope, _LEAST_MM, fall_m_per_s, extinction, _ASYMMETRY)
        spec = shower.on(spec, request, keys.shutter_s)
        return spec if keys.wet == 0 else wetted(spec, keys, wind_m_per_s(request.drawn), request.ground)

    def notes(self, keys: RainKeys, drawn: DrawnRecipe) -> list[str]:
        if SKIES.load(drawn.recipe.sky.kind).has_sun and not drawn.recipe.sky.clouds.has_clouds:
            return ["rain falls from a clear sky; sky.kind: overcast suits it"]
        return []


def wetted(spec: SceneSpec, keys: RainKeys, wind_m_per_s: tuple[float, float], ground: HeightField) -> SceneSpec:
    """The scene with a film of water on its surfaces, but for what lies under water. Soil that was wet stays so."""
    x, y, z = spec.terrain.mesh.vertices_m.astype(np.float64).T
    falls = float(fall_m_per_s(np.array(_MEDIAN_VOLUME / slope_per_mm(keys.rate_mm_per_h))))
    near = 1.0 - spec.terrain.far_share
    share = keys.wet * (ground.level(x, y) <= z) * near
    if spec.terrain.wet is not None:
        share = np.maximum(share, spec.terrain.wet.share * near)
    film = WetFilm(
        share=keys.wet,
        slant=(wind_m_per_s[0] / falls, wind_m_per_s[1] / falls),
        ground=share.astype(np.float32),
        pool_m=(puddles_m(ground, x, y) - _DRIED_M * (1.0 - keys.wet)).astype(np.float32),
        absorption=load_table("standards/water")["absorption_per_m"],
    )
    return replace(spec, film=film, terrain=replace(spec.terrain, wet=None))


KIND = Rain()
