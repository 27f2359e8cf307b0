"""A quantity by wavelength, and what eyes make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

SECOND_RADIATION_NM_K = 1.438776877e7  # Planck's h c / k
LUMENS_PER_WATT = 683.002  # of light at 540 THz (CIE 018:2019)
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear Rec. 709's red, green and blue: ITU-R BT.709-6, item 3.2


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Values at wavelengths, straight lines between them; beyond its ends a spectrum keeps its last value."""

    wavelength_nm: NDArray[np.float64]  # (W,) strictly rising
    value: NDArray[np.float64]  # (W,) in the unit of what it is a spectrum of

    def __post_init__(self) -> None:
        if self.wavelength_nm.ndim != 1 or self.wavelength_nm.shape != self.value.shape or not len(self.value):
            raise ValueError("a spectrum needs as many values as wavelengths, and at least one")
        if not (np.diff(self.wavelength_nm) > 0).all():
            raise ValueError("a spectrum's wavelengths must rise")

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Values at wavelengths in nm, of any shape."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, dtype=np.float64), self.wavelength_nm, self.value))


@dataclass(frozen=True, eq=False)
class Band:
    """A sensor's channel: what it answers to light of each wavelength. Its value is the radiance that it weighs."""

    name: str
    response: Spectrum  # no unit, any scale; zero outside its wavelengths

    def mean(self, spectrum: Spectrum) -> float:
        """A spectrum's mean, weighted by the response: band radiance per nm from spectral radiance per nm."""
        grid = np.union1d(self.response.wavelength_nm, spectrum.wavelength_nm)
        low, high = self.response.wavelength_nm[[0, -1]]
        grid = grid[(grid >= low) & (grid <= high)]
        weight = self.response.at(grid)
        return float(np.trapezoid(weight * spectrum.at(grid), grid) / np.trapezoid(weight, grid))
