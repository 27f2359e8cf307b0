"""Rain: streaks before the camera, air that dims what is far, and wet leaves, bark and ground.

- Drops: N(D) = 8000 exp(-4.1 R^-0.21 D) per m³ and mm of diameter D in mm, at R mm/h (Marshall and Palmer 1948). They
  fall at 9.65 - 10.3 exp(-0.6 D) m/s (Atlas, Srivastava and Sekhon 1973, after Gunn and Kinzer 1949).
- Streaks: a drop that the shutter sees for T seconds is a line of its way in T, aslant in wind. It refracts light of a
  wide part of the scene behind it (Garg and Nayar 2007, a field of 165 degrees): it is as bright as the image's mean,
  and covers what it passes by its share of the time. A nearer surface hides it (render/falling.py).
- All drops are a medium of twice their cross-section, pi N0 / slope³, through which light is followed as in fog; it
  turns by few degrees (Henyey and Greenstein's g = 0.95).
- Wet surfaces: wood, ground and fallen leaves darken as under a film of water (scene/surfaces.py). Living leaves
  have a film's mirror, a gloss of 0.04 of smooth water; fallen ones, which soak it up, get as smooth and keep theirs.
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

from forestgen.core.spectrum import Spectrum
from forestgen.recipe.fields import Fraction, Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.registries import SKIES
from forestgen.recipe.weather import Weather
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.ground_layers.layer import is_litter
from forestgen.scene.spec import Falling, FogLayer, Material, SceneSpec, Terrain, WetGround
from forestgen.scene.surfaces import under_film, wet_spectrum
from forestgen.scene.terrain import HeightField
from forestgen.scene.weather.kind import Place, WeatherKind, WeatherRequest, check_followed, wind_m_per_s

_N0_PER_M3_MM = 8000.0
_ASYMMETRY = 0.95
_DEEP_M = 500.0  # of the rain above the ground
_FILM_GLOSS, _FILM_ROUGHNESS = 0.04, 0.25


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
        layer = FogLayer(extinction_per_m(keys.rate_mm_per_h), request.ground_m + _DEEP_M, 1.0, _ASYMMETRY)
        least_mm = 0.5
        slope = slope_per_mm(keys.rate_mm_per_h)
        falling = Falling(
            number_per_m3=_N0_PER_M3_MM / slope * float(np.exp(-slope * least_mm)),
            least_mm=least_mm,
            mean_excess_mm=1.0 / slope,
            drift_m_per_s=wind_m_per_s(request.drawn),
            shutter_s=keys.shutter_s,
            fall=fall_m_per_s,
        )
        spec = replace(spec, fog=(*spec.fog, layer), falling=(*spec.falling, falling))
        return spec if keys.wet == 0 else wetted(spec, keys.wet, request.ground)

    def notes(self, keys: RainKeys, drawn: DrawnRecipe) -> list[str]:
        if SKIES.load(drawn.recipe.sky.kind).has_sun and not drawn.recipe.sky.clouds.has_clouds:
            return ["rain falls from a clear sky; sky.kind: overcast suits it"]
        return []


def wetted(spec: SceneSpec, share: float, ground: HeightField | None = None) -> SceneSpec:
    """The scene with a film of water on a share of its surfaces, but for what lies under water."""
    materials = {key: _wet(one, share, is_litter=is_litter(*key)) for key, one in spec.materials.items()}
    return replace(spec, materials=materials, terrain=_wet_terrain(spec.terrain, share, ground))


def _wet(material: Material, share: float, *, is_litter: bool) -> Material:
    if material.absorption is not None:  # water
        return material
    is_leaf = max(material.transmittance) > 0
    roughness = material.roughness + share * (min(material.roughness, _FILM_ROUGHNESS) - material.roughness)
    if is_leaf and not is_litter:  # its skin is smooth, and so is the film
        return replace(material, gloss=max(material.gloss, share * _FILM_GLOSS), roughness=roughness)
    texture, dry, spectrum = material.texture, material.reflectance_spectrum, None
    if dry is None:
        plain = np.array(material.reflectance)
        red, green, blue = ((1.0 - share) * plain + share * under_film(plain)).tolist()
        colour = (red, green, blue)
    else:
        film = wet_spectrum(dry)
        spectrum = Spectrum(film.wavelength_nm, (1.0 - share) * dry.at(film.wavelength_nm) + share * film.value)
        colour, _ = colours_of_surface(spectrum, None)
    if texture is not None:
        factor = np.array(colour) / np.maximum(material.reflectance, 1e-6)
        texture = replace(texture, colour=(texture.colour * factor).astype(np.float32))
    made = replace(material, reflectance=colour, reflectance_spectrum=spectrum, texture=texture)
    return replace(made, roughness=roughness) if is_litter else made


def _wet_terrain(terrain: Terrain, share: float, ground: HeightField | None) -> Terrain:
    if terrain.wet is not None:
        return terrain
    x, y, z = terrain.mesh.vertices_m.astype(np.float64).T
    drowned = False if ground is None else ground.level(x, y) > z
    wet = np.where(drowned, 0.0, np.full(len(x), share)).astype(np.float32)
    if terrain.spectrum is None:
        red, green, blue = under_film(np.array(terrain.mean_colour)).tolist()
        return replace(terrain, wet=WetGround(wet, (red, green, blue), None))
    film = wet_spectrum(terrain.spectrum)
    return replace(terrain, wet=WetGround(wet, colours_of_surface(film, None)[0], film))


KIND = Rain()
