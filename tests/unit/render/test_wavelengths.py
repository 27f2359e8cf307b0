"""Nodes of the bands, under the light that falls on a scene."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.atmosphere.daylight import daylight
from forestgen.core.randomness import child_rng
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.spectra import load_bands
from forestgen.render.wavelengths import BandsBySpectrum

REFLECTANCE = Spectrum(np.array([300.0, 4000.0]), np.array([0.1, 0.6]))


@pytest.mark.parametrize("replicates", [1, 4])
def test_water_vapour_does_not_shake_the_bands(replicates: int) -> None:
    """One image's choice of wavelengths moves no band of Sentinel-2 by much, B9 and B10 in the vapour included."""
    light = daylight(50.0, 3.0).on_level
    ground = Spectrum(light.wavelength_nm, light.value * REFLECTANCE.at(light.wavelength_nm))
    bands = tuple(load_bands("sentinel2a"))
    truth = np.array([band.mean(ground) for band in bands])
    quadrature = BandsBySpectrum(bands, light)
    images = np.array(
        [
            np.mean(
                [
                    sum(one.weight @ one.channels.of_light(ground) for one in quadrature.draw(child_rng(seed), number))
                    for number in range(replicates)
                ],
                axis=0,
            )
            for seed in range(100)
        ]
    )
    assert (images.std(axis=0) / truth < 0.025 / replicates**0.5).all()
    np.testing.assert_allclose(images.mean(axis=0), truth, rtol=0.006)
    np.testing.assert_allclose(quadrature.of_light(ground), truth)
