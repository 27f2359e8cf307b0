"""A field of cumulus without dynamics: shapes from noise, extinction on a grid.

Model
-----
A column is cloudy where a smooth random field c(x, y) exceeds the quantile that leaves the wanted cover. The excess
sets how high its cauliflower rises over the flat condensation level; billows are eroded from its surface by folded
noise; extinction grows with height over the base as adiabatic liquid water does, sigma ~ (z - base)^(2/3) (liquid water
grows linearly with height and the droplet radius with its cube root), up to `extinction_per_m` at the top.

The field is periodic in x and y, centred on the site.

Example
-------
    sky: {clouds: {type: noise, cover: 0.5, base_m: 1200}}

Parameters: see below.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.atmosphere.clouds.source import CloudRequest, CloudSource
from forestgen.atmosphere.extinction import ALBEDO, droplet_phase
from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Fraction, Positive
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sky import CloudsBelowCirrus

_DROPLET_UM = 10.0  # effective radius
_MOST_OPTICAL_DEPTH = 200.0  # straight up
_BYTES_PER_CELL = 60


class NoiseKeys(CloudsBelowCirrus):
    """Keys of `clouds: {type: noise}`."""

    cover: Fraction = Field(0.35, description="Of noise: fraction of the sky's area under cloud, 0 to 1.")
    base_m: Positive = Field(900.0, le=20000, description="Of noise: height of the base above ground, metres.")
    thickness_m: Positive = Field(350.0, le=20000, description="Of noise: height of the layer, metres.")
    extinction_per_m: Positive = Field(0.05, le=1, description="Of noise: extinction inside a cloud, per metre.")
    extent_m: Positive = Field(8000.0, le=20000, description="Of noise: side of the square of clouds, metres.")

    @property
    def known_cover(self) -> float:
        return self.cover


class NoiseClouds(CloudSource[NoiseKeys]):
    """Small cumulus without weather, made in a second."""

    Parameters = NoiseKeys

    def check(self, drawn: DrawnRecipe) -> None:
        keys = self.keys_of(drawn)
        depth = keys.extinction_per_m * keys.thickness_m
        if depth > _MOST_OPTICAL_DEPTH:
            problem = "the clouds are too thick to be traced in reasonable time"
            expected = f"extinction_per_m x thickness_m of at most {_MOST_OPTICAL_DEPTH:g}; cumulus have tens"
            got = f"{keys.extinction_per_m:g} x {keys.thickness_m:g} = {depth:g}"
            raise RecipeError(problem, where=drawn.where("sky", "clouds"), expected=expected, got=got)

    def known_base_m(self, drawn: DrawnRecipe) -> float:
        return self.keys_of(drawn).base_m

    def estimate_bytes(self, drawn: DrawnRecipe, model: object, parameters: object) -> int:
        keys = self.keys_of(drawn)
        return int((keys.extent_m / 40) ** 2 * max(8, keys.thickness_m / 20) * _BYTES_PER_CELL)

    def grid(self, request: CloudRequest) -> CloudGrid | None:
        keys = self.keys_of(request.drawn)
        if keys.cover == 0:
            return None
        return cumulus_field(keys, request.middle_of_site_m, child_rng(request.drawn.image_seed, "clouds"))


SOURCE = NoiseClouds()


def _spectral_noise(
    shape: tuple[int, ...],
    cell_m: tuple[float, ...],
    longest_m: float,
    shortest_m: float,
    slope: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Periodic Gaussian noise of unit variance with power ~ k^-slope between two wavelengths."""
    import scipy.fft

    axes = [scipy.fft.fftfreq(n, d) for n, d in zip(shape[:-1], cell_m[:-1], strict=True)]
    axes.append(scipy.fft.rfftfreq(shape[-1], cell_m[-1]))
    k = np.sqrt(sum(np.square(axis) for axis in np.meshgrid(*axes, indexing="ij", sparse=True)))
    low, high = 1.0 / longest_m, 1.0 / shortest_m
    return shaped_noise(np.where((k >= low) & (k <= high), np.maximum(k, low) ** (-slope / 2.0), 0.0), shape, rng)


def shaped_noise(
    amplitude: NDArray[np.float64], shape: tuple[int, ...], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Periodic Gaussian noise of unit variance with the amplitudes of its waves, in the order of `rfftn`."""
    import scipy.fft

    white = scipy.fft.rfftn(rng.standard_normal(shape, dtype=np.float32))
    field = scipy.fft.irfftn(white * amplitude.astype(np.float32), s=shape).astype(np.float32)
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def cumulus_field(
    keys: NoiseKeys, centre_m: tuple[float, float], rng: np.random.Generator, cell_m: float = 26.0
) -> CloudGrid:
    """A field of cumulus around world x and y, of cells so wide and half as high; the cover is above 0."""
    extent_m, thickness_m = keys.extent_m, keys.thickness_m
    across = max(16, round(extent_m / cell_m))
    up = max(8, round(thickness_m / (cell_m / 2.0)))
    cell = extent_m / across
    dz = thickness_m / up
    base_field = _spectral_noise((across, across), (cell, cell), min(1600.0, extent_m / 2), 3 * cell, 3.4, rng)
    threshold = np.quantile(base_field, 1.0 - keys.cover)
    excess = np.clip((base_field - threshold) / (base_field.max() - threshold), 0.0, None)
    tops = thickness_m * np.minimum(1.0, 1.25 * excess**0.6)

    billow = np.abs(_spectral_noise((up, across, across), (dz, cell, cell), 420.0, 2 * dz, 2.8, rng))
    z = (np.arange(up, dtype=np.float32) + 0.5) * dz
    # Billows bite deeper into the sides and tops than into the base, which condensation keeps flat.
    bite = thickness_m * 0.22 * billow * (0.25 + 0.75 * z / thickness_m)[:, None, None]
    depth = tops[None] - z[:, None, None] - bite
    rise = np.clip(depth / (1.2 * dz), 0.0, 1.0)
    profile = ((z + 0.5 * dz) / thickness_m) ** (2.0 / 3.0)
    extinction = (keys.extinction_per_m * rise * profile[:, None, None]).astype(np.float32)
    half = extent_m / 2.0
    return CloudGrid(
        extinction_per_m=extinction,
        low_m=(centre_m[0] - half, centre_m[1] - half, keys.base_m),
        high_m=(centre_m[0] + half, centre_m[1] + half, keys.base_m + thickness_m),
        albedo=ALBEDO,
        phase=droplet_phase(_DROPLET_UM),
    )
