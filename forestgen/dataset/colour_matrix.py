"""From a colour camera's balanced values to linear Rec. 709: the matrix that cameras and raw converters apply.

Filters overlap, so a camera's own colours are paler than those that eyes see. The matrix is the one of least squared
error over the 24 patches of a colour chart under D65 that leaves a white surface white: ISO 17321-1, annex B, with the
constraint of Finlayson and Drew (1997, Constrained least-squares regression in color spaces, J. Electronic Imaging 6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Band, Spectrum
from forestgen.scene.colour import colour_of_reflectance
from forestgen.scene.colour_checker import patches


def colour_matrix(bands: Sequence[Band], light: Spectrum) -> NDArray[np.float64]:
    """(3, 3) of bands for red, green and blue whose values a white surface under `light`, D65, has all at 1."""
    chart = list(patches().values())
    white = np.array([band.mean(light) for band in bands])
    seen = np.array([[band.mean(_product(patch, light)) for band in bands] for patch in chart]) / white
    wanted = np.array([colour_of_reflectance(patch) for patch in chart])
    matrix = np.empty((3, 3))
    for row in range(3):  # what the other two columns take away, the own one adds: rows sum to 1
        others = [column for column in range(3) if column != row]
        apart = seen[:, others] - seen[:, [row]]
        weights = np.linalg.lstsq(apart, wanted[:, row] - seen[:, row], rcond=None)[0]
        matrix[row, others], matrix[row, row] = weights, 1.0 - weights.sum()
    return matrix


def _product(surface: Spectrum, light: Spectrum) -> Spectrum:
    wavelength = np.union1d(surface.wavelength_nm, light.wavelength_nm)
    return Spectrum(wavelength, surface.at(wavelength) * light.at(wavelength))
