"""Snow on the ground and on plants.

- On the ground it lies `depth_m` deep in the mean of the site: less below crowns, in wells around stems, in drifts, in
  mounds over low plants (scene/snow_depth.py). The ground rises by it, and what is lower is hidden. Needles and bits of
  bark lie on it, most below crowns. Ponds and streams stay open. It has the reflectance of `ground/snow`: fresh dry
  snow, computed by Kokhanovsky and Zege (2004) from the absorption of ice (Warren and Brandt 2008). 40% of the land
  around lies under it. Sizes and shares of what fell on it are numbers of ours.
- On plants it lies on sides that face up: on level wood, stones and roofs, and on a share of the leaves and needles,
  load by load. The more of it lies, the steeper is the wood that holds it. Loads look like cushions: white from above
  and from the side, dark from below. On stems it sticks in strips to the side of `site.wind_from_deg`. It takes all
  light that a leaf would let through. It adds no thickness, so masks are those of the plants without it
  (render/identity/weather.py).
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
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh, vertex_normals
from forestgen.plants.bark.texture import with_mean
from forestgen.recipe.fields import Fraction, NonNegative
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.spectra import load_spectra
from forestgen.recipe.weather import Weather
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.grounds.uneven import SNOW
from forestgen.scene.snow_depth import SnowDepth, Waves, drifts
from forestgen.scene.spec import GroundMixture, GroundPart, GroundPatch, SceneSpec, SnowCover
from forestgen.scene.terrain import tile_noise
from forestgen.scene.weather.kind import Place, WeatherKind, WeatherRequest, check_followed

Floats = NDArray[np.float64]
# Of what fell on snow: sizes; how much it clumps, and what it is rarer than, in standard deviations; share in the open.
_BITS_M, _CLUMPED, _RARE, _EVERYWHERE = (0.08, 0.032), 0.4, 2.2, 0.15


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
        return np.maximum(keys.depth_m + drifts(place_m, keys.depth_m, Waves.of(_rng(drawn))), 0.0)

    def laid_m(self, keys: SnowKeys, spec: SceneSpec, request: WeatherRequest, place_m: Floats) -> Floats:
        return _depth(keys, spec, request).at(place_m) if keys.depth_m > 0 else np.zeros(len(place_m))

    def is_relief(self, keys: SnowKeys) -> bool:
        return keys.depth_m > 0

    def on(self, keys: SnowKeys, spec: SceneSpec, request: WeatherRequest) -> SceneSpec:
        spectrum, far = SNOW.reflectance(), SNOW.far_reflectance()
        colour, far_colour = (colours_of_surface(one, None)[0] for one in (spectrum, far))
        if keys.on_plants > 0:
            wind = np.radians(request.drawn.recipe.site.wind_from_deg)
            windward = float(np.sin(wind)), float(np.cos(wind))
            spec = replace(spec, snow=SnowCover(keys.on_plants, colour, spectrum, windward))
        if keys.depth_m == 0:
            return spec
        vertices = spec.terrain.mesh.vertices_m.astype(np.float64)
        wet = request.ground.level(*vertices[:, :2].T) > vertices[:, 2]
        depth = _depth(keys, spec, request)
        rng = child_rng(request.drawn.image_seed, "snow_cover", "colour")
        texture = with_mean(SNOW.pattern(rng), colour)
        littered = _littered(texture, colour, np.where(wet, 0.0, depth.littered(vertices[:, :2])), rng)
        terrain = replace(
            spec.terrain,
            mesh=raised(spec.terrain.mesh, np.where(wet, 0.0, depth.at(vertices[:, :2]))),
            patches=(littered, *(replace(one, share=one.share * wet) for one in spec.terrain.patches)),
            texture=texture,
            spectrum=spectrum,
            far_reflectance=far_colour,
            far_spectrum=far,
            wet=None,
            bare=None,
            mixture=None,
        )
        if spec.film is not None:  # rain that fell before
            dry = np.zeros(len(vertices), np.float32)
            spec = replace(spec, film=replace(spec.film, ground=dry, pool_m=dry - np.float32(1.0)))
        return replace(spec, terrain=terrain, sky=replace(spec.sky, ground_albedo=float(np.mean(far_colour))))


def raised(mesh: Mesh, depth_m: Floats) -> Mesh:
    """A terrain's mesh raised by snow, by vertex (V,)."""
    vertices = mesh.vertices_m + np.pad(depth_m[:, None], ((0, 0), (2, 0)))
    normals = vertex_normals(vertices.astype(np.float64), mesh.faces)
    return replace(mesh, vertices_m=vertices.astype(np.float32), normals=normals.astype(np.float32))


def _littered(
    snow: NDArray[np.float32], colour: tuple[float, float, float], littered: Floats, rng: np.random.Generator
) -> GroundPatch:
    """Snow with what fell on it: needles, bits of bark and twigs, most where `littered` (V,) is 1."""
    spectrum, litter = SNOW.reflectance(), load_spectra("ground/litter_needles")["reflectance"]
    noise = tile_noise(*_BITS_M, 0.0, rng) + _CLUMPED * tile_noise(3.0, 0.3, 2.0, rng)
    bits = (noise > _RARE).astype(np.float32)
    share = float(bits.mean())
    grid = np.union1d(spectrum.wavelength_nm, litter.wavelength_nm)
    mean = Spectrum(grid, (1.0 - share) * spectrum.at(grid) + share * litter.at(grid))
    part = GroundPart(bits, colours_of_surface(litter, None)[0], litter)
    mixture = GroundMixture((np.float32(1.0) - bits)[..., None] * snow, colour, spectrum, (part,))
    cover = (_EVERYWHERE + (1.0 - _EVERYWHERE) * littered).astype(np.float32)
    return GroundPatch(cover, mixture.image(), colours_of_surface(mean, None)[0], mean, mixture)


def _depth(keys: SnowKeys, spec: SceneSpec, request: WeatherRequest) -> SnowDepth:
    return SnowDepth.of(keys.depth_m, spec, request.stems, request.ground.size_m, _rng(request.drawn))


def _rng(drawn: DrawnRecipe) -> np.random.Generator:
    return child_rng(drawn.image_seed, "snow_cover", "drifts")


KIND = Snow()
