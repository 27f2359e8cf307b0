"""Fog on the ground: a level layer of small drops, as dense everywhere up to its depth, thinner and thinner above.

- At the visibility V a black thing is just seen against the fog, with a contrast of 2%: the extinction is 3.912 / V
  (Koschmieder 1924). Drops are large against the wavelength, so fog is grey, and they absorb nothing in the visible.
- Its top lies level `depth_m` above the mean ground of the site, so it fills valleys and leaves hilltops out. Above the
  top the extinction falls by e in `fade_m`.
- With `patch_m` it is thicker and thinner by place: its extinction is multiplied by 1 plus waves of a third of this
  length to all of it, sideways, and upwards as short as half of that: of 0.95 together, so that 0.05 of the mean stays.
  The number, shape and size of these waves are ours.
- Light is followed through it, scattering by scattering (render/paths/fog.py): so it dims sun and sky, brightens shade,
  and has shafts of light between stems. The phase function is Henyey and Greenstein's with g = 0.85, as drops of some
  micrometres have in the visible (Hansen and Travis 1974, figure 13).
- The sky's light is that above the fog. Labels, depth and masks are those of the scene without fog.

`sky.visibility_m` is thin haze far beyond the site, and costs less; `sky.clouds: fog` is fog that weather makes.

Example
-------
    weather: [{what: ground_fog, visibility_m: 120, depth_m: 6, patch_m: 40}]

References
----------
Koschmieder, H. (1924): Theorie der horizontalen Sichtweite. Beitr. Phys. freien Atmos. 12, 33-53, 171-181.
Hansen, J. E., Travis, L. D. (1974): Light scattering in planetary atmospheres. Space Sci. Rev. 16, 527.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from forestgen.atmosphere.extinction import KOSCHMIEDER
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Number
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.weather import Weather
from forestgen.scene.spec import FogLayer, SceneSpec, Wave
from forestgen.scene.weather.kind import Place, WeatherKind, WeatherRequest, check_followed

_ASYMMETRY = 0.85
_WAVES, _AMPLITUDE, _SHORTEST, _STEEPEST = 4, 0.95, 1 / 3, 2.0


class GroundFogKeys(Weather):
    """Fog on the ground."""

    visibility_m: Number = Field(200.0, ge=5, le=20000, description="How far one sees in it, metres: fog below 1000.")
    depth_m: Number = Field(8.0, ge=0, le=2000, description="Height of its top over the site's mean ground, metres.")
    fade_m: Number = Field(
        3.0, ge=0.05, le=2000, description="Way up above the top in which it gets thinner by e, metres."
    )
    patch_m: Number | None = Field(
        None, ge=5, le=1000, description="Length of patches of thicker and thinner fog, metres. None: even fog."
    )


class GroundFog(WeatherKind[GroundFogKeys]):
    """Fog on the ground."""

    Parameters = GroundFogKeys

    def check(self, keys: GroundFogKeys, drawn: DrawnRecipe, place: Place) -> None:
        check_followed(drawn, place)

    def on(self, keys: GroundFogKeys, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        top_m = request.ground_m + keys.depth_m
        patches = (
            () if keys.patch_m is None else _patches(keys.patch_m, child_rng(request.drawn.image_seed, "ground fog"))
        )
        layer = FogLayer(KOSCHMIEDER / keys.visibility_m, top_m, keys.fade_m, _ASYMMETRY, patches)
        return replace(spec, fog=(*spec.fog, layer))


def _patches(longest_m: float, rng: np.random.Generator) -> tuple[Wave, ...]:
    """Waves of the extinction over its mean: vectors in radians a metre, phases in radians, amplitudes, 0.95 in all.

    `longest_m`: length of the longest one, metres.
    """
    waves = []
    for index in range(_WAVES):
        length = 2.0 * np.pi / (longest_m * _SHORTEST ** ((index + rng.random()) / _WAVES))
        angle = np.pi * (index + rng.random()) / _WAVES
        x, y, z = length * np.array([np.cos(angle), np.sin(angle), rng.uniform(-_STEEPEST, _STEEPEST)])
        waves.append(((float(x), float(y), float(z)), float(2.0 * np.pi * rng.random()), _AMPLITUDE / _WAVES))
    return tuple(waves)


KIND = GroundFog()
