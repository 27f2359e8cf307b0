"""Snow on the ground and on plants.

- On the ground it lies `depth_m` deep, a quarter more or less in drifts and hollows of some metres: the ground rises by
  it, and what is lower is hidden. Ponds and streams stay open. It has the reflectance of `ground/snow`: fresh dry snow,
  computed by Kokhanovsky and Zege (2004) from the absorption of ice (Warren and Brandt 2008). 40% of the land around
  lies under it.
- On plants it lies on sides that face up: on level wood, stones and roofs, and on a share of the leaves and needles,
  shoot by shoot. The more of it lies, the steeper is the wood that holds it. It takes all light that a leaf would let
  through. A conifer is white from above and dark from below. It adds no thickness, so masks are those of the plants
  without it.
- Whether broad-leaved trees are bare is the season's: `plants.season: winter`, or a date.

Example
-------
    weather: [{what: snow_cover, depth_m: 0.2, on_plants: 0.6}]

References
----------
Kokhanovsky, A. A., Zege, E. P. (2004): Scattering optics of snow. Appl. Opt. 43, 1589-1602.
Warren, S. G., Brandt, R. E. (2008): Optical constants of ice. J. Geophys. Res. 113, D14220.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.fields import Fraction, NonNegative
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.weather import Weather
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.grounds.uneven import SNOW
from forestgen.scene.spec import SceneSpec, SnowCover
from forestgen.scene.weather.kind import Place, WeatherKind, WeatherRequest, check_followed

Floats = NDArray[np.float64]
_DRIFT = 0.25  # of the depth: standard deviation
_WAVES, _WAVE_M = 32, (1.6, 15.0)  # of drifts


class SnowKeys(Weather):
    """Snow that lies."""

    depth_m: NonNegative = Field(0.15, le=3, description="Mean depth on the ground, metres; 0: on plants alone.")
    on_plants: Fraction = Field(
        0.5, description="Share of level leaves under snow; wood up to 55° steep at 0.5, 81° at 1; 0: none."
    )


class Snow(WeatherKind[SnowKeys]):
    """Snow that lies."""

    Parameters = SnowKeys

    def check(self, keys: SnowKeys, drawn: DrawnRecipe, place: Place) -> None:
        check_followed(drawn, place)

    def raised_m(self, keys: SnowKeys, drawn: DrawnRecipe, place_m: Floats) -> Floats:
        return drifts(place_m, keys.depth_m, _rng(drawn))[0]

    def on(self, keys: SnowKeys, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        spectrum, far = SNOW.reflectance(), SNOW.far_reflectance()
        colour, far_colour = (colours_of_surface(one, None)[0] for one in (spectrum, far))
        if keys.on_plants > 0:
            spec = replace(spec, snow=SnowCover(keys.on_plants, colour, spectrum))
        if keys.depth_m == 0:
            return spec
        x, y, z = spec.terrain.mesh.vertices_m.astype(np.float64).T
        wet = request.ground.level(x, y) > z
        terrain = replace(
            spec.terrain,
            mesh=drifted(spec.terrain.mesh, keys.depth_m, _rng(request.drawn), wet),
            patches=tuple(replace(one, share=one.share * wet) for one in spec.terrain.patches),
            texture=with_mean(SNOW.pattern(child_rng(request.drawn.image_seed, "snow_cover", "colour")), colour),
            spectrum=spectrum,
            far_reflectance=far_colour,
            far_spectrum=far,
            wet=None,
            bare=None,
            mixture=None,
        )
        return replace(spec, terrain=terrain, sky=replace(spec.sky, ground_albedo=float(np.mean(far_colour))))


def drifted(mesh: Mesh, depth_m: float, rng: np.random.Generator, wet: NDArray[np.bool_] | None = None) -> Mesh:
    """A terrain's mesh raised by snow, but for vertices (V,) under water."""
    assert mesh.normals is not None
    deep, slope = drifts(mesh.vertices_m[:, :2].astype(np.float64), depth_m, rng)
    if wet is not None:
        deep, slope = np.where(wet, 0.0, deep), np.where(wet[:, None], 0.0, slope)
    normals = mesh.normals.astype(np.float64)
    normals = normals / np.maximum(normals[:, 2:], 1e-6) - np.pad(slope, ((0, 0), (0, 1)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices = mesh.vertices_m + np.pad(deep[:, None], ((0, 0), (2, 0)))
    return replace(mesh, vertices_m=vertices.astype(np.float32), normals=normals.astype(np.float32))


def drifts(place_m: Floats, depth_m: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Depth of snow (N,) at places (N, 2), metres, and its slope (N, 2) eastward and northward."""
    shortest, longest = np.log(_WAVE_M)
    length, turn = np.exp(rng.uniform(shortest, longest, _WAVES)), rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    wave = 2.0 * np.pi / length * np.stack([np.cos(turn[0]), np.sin(turn[0])])
    size_m = depth_m * _DRIFT * np.sqrt(2.0 / _WAVES)
    angle = place_m @ wave + turn[1]
    deep = np.maximum(depth_m + size_m * np.sin(angle).sum(axis=1), 0.0)
    return deep, size_m * np.cos(angle) @ wave.T * (deep > 0)[:, None]


def _rng(drawn: DrawnRecipe) -> np.random.Generator:
    return child_rng(drawn.image_seed, "snow_cover", "drifts")


KIND = Snow()
