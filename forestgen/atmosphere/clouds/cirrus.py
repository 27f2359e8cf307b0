"""Cirrus: thin high clouds of ice in streaks, without dynamics.

Model
-----
Ice forms in small cells at the top of the layer, and falls while the wind below is slower: it is drawn out into a
streak against the wind, ever farther with depth, as mare's tails are. The cells are noise of 300 m to 3 km, many times
longer along the wind than across, in patches of some ten kilometres; its exponential makes few strong streaks and much
thin veil. A layer at the share s of the thickness below the top lies `streak_m` s² upwind, where the fall through air
of constant shear has brought it, and holds less ice the lower it is, which sublimes.

Ice scatters forwards less than droplets do: asymmetry 0.75 for the rough aggregates of columns that satellites'
retrievals use (Yang et al. 2013; the number is that of MODIS collection 6, Platnick et al. 2017, quoted from memory).
Here it is that of two Henyey-Greenstein lobes, 0.82 and -0.55, with 95% of the light in the first. Halos need smooth
crystals, and are left out. The extinction is scaled such that the mean optical depth of the cloudy part is
`optical_depth`: cirrus have 0.03 to 3, thin ones up to 0.3 (Sassen and Cho 1992).

The field is a square about the site. It repeats to three squares a side, and fades out on the last quarter of the way:
seen from its middle there is no cirrus below an elevation of atan(base_m / (1.5 extent_m)), 6 degrees by default.
Cirrus above other clouds are a layer of their own: `CloudGrid.above`.

Example
-------
    sky: {clouds: {type: cirrus, cover: 0.5, optical_depth: 0.2}}
    sky: {clouds: {type: cumulus, cirrus: {cover: 0.5, optical_depth: 0.2}}}

Parameters: see below.

References
----------
Sassen, K., Cho, B. S. (1992): Subvisual-thin cirrus lidar dataset for satellite verification and climatological
research. J. Appl. Meteorol. 31, 1275-1285.
Yang, P., et al. (2013): Spectrally consistent scattering, absorption, and polarization properties of atmospheric ice
crystals at wavelengths from 0.2 to 100 um. J. Atmos. Sci. 70, 330-347.
Platnick, S., et al. (2017): The MODIS cloud optical and microphysical products: Collection 6 updates and examples from
Terra and Aqua. IEEE Trans. Geosci. Remote Sens. 55, 502-525.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.noise import shaped_noise
from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.atmosphere.conditions import wind_towards
from forestgen.atmosphere.extinction import ALBEDO
from forestgen.atmosphere.grid import CloudGrid, PhaseFunction
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sky import CirrusSection, Clouds

ICE = PhaseFunction(0.82, -0.55, 0.95)  # of asymmetry 0.75
_LAYERS, _CELLS = 8, 448  # cells along a side
_SQUARES, _FADES = 3, 0.25  # squares along a side, and the part of the way to the edge on which they fade out
CIRRUS_BYTES = (_SQUARES * _CELLS) ** 2 * _LAYERS * 24
_PATCH_M, _LONGEST_M = 12_000.0, 3000.0
_STRETCH = 7.0  # of the cells along the wind
_CONTRAST = 0.9  # of the noise before its exponential


class CirrusKeys(Clouds, CirrusSection):
    """Keys of `clouds: {type: cirrus}`."""

    @property
    def known_cover(self) -> float:
        return self.cover


class Cirrus(CloudSource[CirrusKeys]):
    """Thin high clouds of ice in streaks along the wind, made in a second."""

    Parameters = CirrusKeys

    def known_base_m(self, drawn: DrawnRecipe) -> float:
        return self.keys_of(drawn).base_m

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        return CIRRUS_BYTES

    def grid(self, request: CloudRequest) -> CloudGrid | None:
        return _cirrus_grid(self.keys_of(request.drawn), request)


def cirrus_above(drawn: DrawnRecipe) -> CirrusSection | None:
    """Cirrus that a recipe has above other clouds."""
    found: CirrusSection | None = getattr(drawn.recipe.sky.clouds, "cirrus", None)
    return found


def check_cirrus_above(drawn: DrawnRecipe) -> None:
    """Raise `RecipeError` for cirrus that light cannot reach."""
    if drawn.recipe.render.clouds == "exact" and cirrus_above(drawn) is not None:
        problem = "light through the clouds' volume cannot be combined with cirrus above them"
        where, hint = drawn.where("sky", "clouds", "cirrus"), "leave out the cirrus, or leave render.clouds out"
        raise RecipeError(problem, where=where, expected="render.clouds: farfield or auto", got="exact", hint=hint)


def below_cirrus(request: CloudRequest, clouds: CloudGrid | None) -> CloudGrid | None:
    """Clouds with the cirrus that the recipe has above them. `RecipeError`: they would not be above."""
    keys = cirrus_above(request.drawn)
    cirrus = None if keys is None else _cirrus_grid(keys, request)
    if keys is None or clouds is None or cirrus is None:
        return cirrus if clouds is None else clouds
    top_m = clouds.high_m[2] - request.ground_m
    if keys.base_m < top_m:
        problem, where = "the cirrus lie in the clouds below them", request.drawn.where("sky", "clouds", "cirrus")
        expected = f"cirrus.base_m of at least {top_m:g} m, where the other clouds end"
        hint = "raise cirrus.base_m, or leave the cirrus out"
        raise RecipeError(problem, where=where, expected=expected, got=f"{keys.base_m:g} m", hint=hint)
    return replace(clouds, above=cirrus)


def _cirrus_grid(keys: CirrusSection, request: CloudRequest) -> CloudGrid | None:
    """Squares around the site's one, over which the clouds go on, fading out at a distance."""
    if keys.cover == 0:
        return None
    rng, wind = child_rng(request.drawn.image_seed, "cirrus"), request.drawn.recipe.site.wind_from_deg
    field = np.tile(cirrus_field(keys, wind_towards(1.0, wind), rng), (1, _SQUARES, _SQUARES))
    place = (np.arange(field.shape[1]) + 0.5) / field.shape[1] * 2.0 - 1.0
    field *= np.clip((1.0 - np.hypot(place[:, None], place)) / _FADES, 0.0, 1.0).astype(np.float32)
    (x, y), half = request.middle_of_site_m, _SQUARES * keys.extent_m / 2.0
    base_m = request.ground_m + keys.base_m
    return CloudGrid(field, (x - half, y - half, base_m), (x + half, y + half, base_m + keys.thickness_m), ALBEDO, ICE)


def cirrus_field(keys: CirrusSection, wind: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float32]:
    """(Z, Y, X) extinction per metre; `wind` is the unit vector towards which it blows, east and north."""
    import scipy.fft

    side_m = keys.extent_m / _CELLS
    north, east = np.meshgrid(scipy.fft.fftfreq(_CELLS, side_m), scipy.fft.rfftfreq(_CELLS, side_m), indexing="ij")
    along, across = east * wind[0] + north * wind[1], east * wind[1] - north * wind[0]
    size = np.hypot(along * _STRETCH, across)
    # Power of k^-2.5 from the longest wavelength across the wind on; patches are round.
    cells = np.maximum(size, 1.0 / _LONGEST_M) ** (-0.5 * (2.5 + 1.0)) * (size > 0.5 / _LONGEST_M)
    patches = np.exp(-((np.hypot(along * 2.0, across) * _PATCH_M) ** 2)) * (size > 0)
    streaks, patch = (shaped_noise(one, (_CELLS, _CELLS), rng) for one in (cells, patches))
    there = np.clip((patch - np.quantile(patch, 1.0 - keys.cover)) / 0.6, 0.0, 1.0)
    ice = np.exp(_CONTRAST * streaks) * there
    spectrum = scipy.fft.rfft2(ice)
    share = (np.arange(_LAYERS)[::-1] + 0.5) / _LAYERS  # of the way down, of layers from the base up
    layers = []
    for down in share:
        moved = spectrum * np.exp(2j * np.pi * along * keys.streak_m * down**2)  # upwind
        layers.append((1.0 - down) ** 0.7 * np.maximum(scipy.fft.irfft2(moved, s=ice.shape), 0.0))
    field = np.stack(layers)
    depth = field.sum(axis=0) * keys.thickness_m / _LAYERS
    cloudy = max(float(np.mean(there > 0)), 1.0 / _CELLS**2)
    return np.ascontiguousarray(field * (keys.optical_depth * cloudy / depth.mean()), dtype=np.float32)


SOURCE = Cirrus()
