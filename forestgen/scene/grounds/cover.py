"""What a ground cover is: its reflectance, and the pattern of its texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Spectrum
from forestgen.recipe.spectra import load_spectra

TEXTURE_TILE_M, TEXTURE_PX = 24.0, 1536  # side of the square that repeats


class GroundCover:
    """What covers the ground of a site; `site.ground` names it.

    Parameters
    ----------
    table : of `reflectance`, in scenes/spectra/ground.
    darkens_when_wet : whether the water that a community has in its soil darkens it.
    """

    def __init__(self, table: str, *, darkens_when_wet: bool = False) -> None:
        self.table, self.darkens_when_wet = table, darkens_when_wet

    def reflectance(self) -> Spectrum:
        """Mean reflectance on the site and around it."""
        return load_spectra(f"ground/{self.table}")["reflectance"]

    def far_reflectance(self) -> Spectrum:
        """Mean reflectance of the land up to the horizon: woods and meadows."""
        return load_spectra("ground/far")["reflectance"]

    def pattern(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """(TEXTURE_PX, TEXTURE_PX, 3) linear Rec. 709, periodic; its mean is then made that of the reflectance."""
        raise NotImplementedError


def tile_noise(longest_m: float, shortest_m: float, slope: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, P) periodic noise of unit variance with power ~ k^-slope between two wavelengths."""
    cell = TEXTURE_TILE_M / TEXTURE_PX
    frequency = np.fft.fftfreq(TEXTURE_PX, cell)
    k = np.hypot(frequency[:, None], frequency[None, : TEXTURE_PX // 2 + 1])
    band = (k >= 1 / longest_m) & (k <= 1 / shortest_m)
    amplitude = np.where(band, np.maximum(k, 1e-9) ** (-slope / 2), 0.0)
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((TEXTURE_PX, TEXTURE_PX))) * amplitude)
    return np.asarray((field - field.mean()) / field.std())
