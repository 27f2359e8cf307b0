"""Wet ground: never brighter than dry ground, the darker the wetter, and without an edge anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.surfaces import (
    Wetness,
    film_factor,
    film_reflectances,
    wet_share,
    wet_spectrum,
)
from forestgen.scene.terrain import HeightField, build_terrain, terrain_mesh

SIZE_M = (12.0, 8.0)
PATCHY = Wetness(SIZE_M, np.random.default_rng(1).random((4, 6)))


def grey(reflectance: float) -> Spectrum:
    return Spectrum(np.array([400.0, 700.0]), np.full(2, reflectance))


def terrain(ground: str = "sand", saturation: object = PATCHY.saturation):
    wetness = None if saturation is None else Wetness(SIZE_M, np.broadcast_to(saturation, (4, 6)).astype(float))
    return build_terrain(HeightField(SIZE_M), np.random.default_rng(2), ground, wetness)


def test_a_surface_of_water_reflects_what_fresnels_equations_say() -> None:
    """Both sides against integrals over angles; from below beyond the critical angle everything."""

    def mean(n: float) -> float:
        def fresnel(angle: float) -> float:
            if np.sin(angle) >= n:
                return np.sin(2 * angle)
            c, t = np.cos(angle), np.sqrt(1 - (np.sin(angle) / n) ** 2)
            both = ((c - n * t) / (c + n * t)) ** 2 + ((n * c - t) / (n * c + t)) ** 2
            return both / 2 * np.sin(2 * angle)

        return quad(fresnel, 0, np.pi / 2, limit=400, points=[np.arcsin(min(n, 1.0))])[0]

    assert film_reflectances() == pytest.approx((mean(1.33), mean(1 / 1.33)), abs=2e-5)


@pytest.mark.parametrize("ground", ["litter", "soil_dry", "rock", "sand"])
def test_a_film_of_water_takes_light_at_every_wavelength(ground: str) -> None:
    dry = load_spectra(f"ground/{ground}")["reflectance"]
    wet = wet_spectrum(dry)
    assert (wet.value > 0).all()
    assert (wet.value < 0.64 * dry.at(wet.wavelength_nm)).all()
    share = [float(wet.at(nm) / dry.at(nm)) for nm in (1600.0, 1450.0, 1940.0)]
    assert share == sorted(share, reverse=True), "by how strongly water absorbs there"


@given(st.floats(1e-6, 1 - 1e-6), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_energy_and_order(dry: float, one: float, other: float) -> None:
    wet = float(wet_spectrum(grey(dry)).at(550.0))
    assert 0 < wet < dry
    low, high = wet_share(np.sort([one, other]), dry, wet)
    assert 0 <= low <= high <= 1
    np.testing.assert_allclose(wet_share(np.array([0.0, 1.0]), dry, wet), [0, 1], atol=1e-5)


def test_the_transformed_reflectance_is_linear_in_saturation() -> None:
    saturation = np.linspace(0, 1, 11)
    reflectance = 0.3 - (0.3 - 0.17) * wet_share(saturation, 0.3, 0.17)
    transformed = (1 - reflectance) ** 2 / (2 * reflectance)
    np.testing.assert_allclose(np.diff(transformed, 2), 0.0, atol=1e-12)
    assert reflectance[[0, -1]] == pytest.approx([0.3, 0.17])


def test_the_map_has_its_cells_values_and_no_edge() -> None:
    def at(x, y, away=0.0):
        x, y = (np.atleast_1d(np.asarray(one, dtype=float)) for one in (x, y))
        return PATCHY.at(x, y, np.broadcast_to(away, x.shape))

    np.testing.assert_allclose(at([1.0, 5.0, 11.0], [1.0, 3.0, 7.0]), PATCHY.saturation[[0, 1, 3], [0, 2, 5]])
    np.testing.assert_allclose(at(2.0, 1.0), PATCHY.saturation[0, :2].mean())
    x = np.linspace(-3.0, 15.0, 4000)
    for y in (-2.0, 0.3, 4.0, 8.0, 9.5):
        assert np.abs(np.diff(at(x, np.full(x.shape, y)))).max() < 0.005
    np.testing.assert_allclose(at([50.0, -90.0], [4.0, 80.0], 1.0), PATCHY.saturation.mean())


def test_the_ground_is_seamless_from_the_site_to_its_mean() -> None:
    height = HeightField(SIZE_M)
    wet = terrain().wet
    assert wet is not None
    x, y = terrain_mesh(height).vertices_m[:, :2].astype(np.float64).T
    away = height.distance_m(x, y)
    outside = wet.share[away >= 20.0]
    assert np.ptp(outside) == 0
    colours = [float(np.dot(LUMINANCE, one)) for one in (terrain(saturation=None).mean_colour, wet.reflectance)]
    assert outside[0] == pytest.approx(wet_share(PATCHY.saturation.mean()[None], *colours)[0], abs=1e-4)
    row = np.flatnonzero(np.abs(y - y[np.argmin(np.abs(y - 4.0))]) < 1e-6)
    row = row[(x[row] > -25) & (x[row] < 40)]
    row = row[np.argsort(x[row])]
    # As steep as between two cells at most: the share rises by 2 at most where the saturation rises by 1.
    assert (np.abs(np.diff(wet.share[row])) / np.diff(x[row])).max() < 2 / 2.0


@pytest.mark.parametrize("ground", ["litter", "sand", "rock", "soil_dry"])
def test_these_grounds_darken(ground: str) -> None:
    factor = film_factor(terrain(ground), RGB)
    assert ((factor > 0.4) & (factor < 0.65)).all()


@pytest.mark.parametrize("ground", ["soil_wet", "snow", "grass"])
def test_these_grounds_stay_as_they_are(ground: str) -> None:
    assert terrain(ground, 1.0).wet is None


def test_dry_soil_is_as_if_nobody_knew() -> None:
    known, unknown = terrain(saturation=0.0), terrain(saturation=None)
    assert known.wet is unknown.wet is None
    np.testing.assert_array_equal(known.texture, unknown.texture)
    np.testing.assert_array_equal(film_factor(known, RGB), np.ones(3))


def test_the_factor_is_the_spectras_at_wavelengths_and_the_colours_in_colour() -> None:
    ground = terrain("soil_dry", 1.0)
    assert ground.wet is not None
    assert ground.spectrum is not None
    nm = (480.0, 850.0, 2200.0)
    wanted = ground.wet.spectrum.at(nm) / ground.spectrum.at(nm)
    np.testing.assert_allclose(film_factor(ground, Channels(nm)), wanted)
    np.testing.assert_allclose(film_factor(ground, RGB), np.divide(ground.wet.reflectance, ground.mean_colour))
    assert film_factor(ground, Channels(nm))[2] < 0.4
