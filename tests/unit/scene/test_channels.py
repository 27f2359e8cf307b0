"""Channels: what a pass's three numbers are made of."""

import numpy as np
import pytest

from forestgen.core.spectrum import Spectrum
from forestgen.recipe.assets import list_assets
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.colour import RGB, Channels, colour_of_reflectance
from forestgen.scene.surfaces import materials_of

GREEN = Spectrum(np.array([400.0, 500.0, 550.0, 600.0, 700.0, 900.0]), np.array([0.04, 0.06, 0.2, 0.1, 0.1, 0.9]))


def test_colours_pass_through_rgb_and_are_kept_in_range():
    np.testing.assert_array_equal(RGB.of_surface((0.1, 1.2, -0.1), None), [0.1, 1.0, 0.0])
    np.testing.assert_array_equal(RGB.of_texture((0.1, 0.2, 0.3), GREEN), np.eye(3))


def test_a_spectrum_is_taken_at_the_wavelengths():
    np.testing.assert_allclose(Channels((450, 575, 800)).of_surface((0, 0, 0), GREEN), [0.05, 0.15, 0.5])
    np.testing.assert_allclose(Channels((450, 575, 800)).of_light(GREEN), [0.05, 0.15, 0.5])


def test_a_colour_has_its_smooth_spectrum_and_grey_is_grey():
    np.testing.assert_allclose(Channels((380, 555, 1500)).of_surface((0.3, 0.3, 0.3), None), 0.3, rtol=1e-4)
    grid = np.arange(380.0, 781.0, 5.0)
    values = np.concatenate([Channels(tuple(three)).of_surface((0.2, 0.5, 0.1), None) for three in grid.reshape(-1, 3)])
    np.testing.assert_allclose(colour_of_reflectance(Spectrum(grid, values)), [0.2, 0.5, 0.1], atol=2e-3)


@pytest.mark.parametrize("wavelengths", [(450.0, 550.0, 650.0), (800.0, 1100.0, 1650.0)])
def test_a_textures_mean_has_the_spectrum(wavelengths):
    rng = np.random.default_rng(1)
    image = 0.3 * rng.random((16, 16, 3))
    channels = Channels(wavelengths)
    seen = image @ channels.of_texture(image.mean(axis=(0, 1)), GREEN).T
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), GREEN.at(wavelengths), rtol=1e-12)


def test_bright_textures_lose_contrast_and_no_light():
    rng = np.random.default_rng(2)
    image = rng.random((32, 32, 3)) ** 3
    most = 0.9 + 0.1 * rng.random((32, 32))
    mean = image.mean(axis=(0, 1))
    channels = Channels((500.0, 700.0, 900.0))
    seen = channels.texture(image, mean, GREEN, most)
    assert (seen <= most[..., None] + 1e-6).all()
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), GREEN.at([500, 700, 900]), rtol=1e-5)
    dark = image @ channels.of_texture(mean, GREEN).T
    np.testing.assert_allclose(seen[..., 1], dark[..., 1], rtol=1e-5)  # a dark channel stays as it was
    assert np.corrcoef(seen[..., 2].ravel(), dark[..., 2].ravel())[0, 1] > 0.999


PLANTS = list_assets("species")


@pytest.mark.parametrize(
    "names", [("log",), pytest.param(PLANTS, marks=pytest.mark.slow, id="all")]
)  # a sawn face is the brightest of all in the infrared
def test_shipped_barks_keep_their_light_at_every_wavelength(names):
    """As rendered, where a texel may hold no more than its facet's share of the sky: see render/surfaces.py."""
    species = {name: {"from": name} for name in names}
    recipe = load_recipe_data({"forestgen": 1, "species": species, "community": {"model": "placed"}}, "all").draw(0)
    materials = materials_of(recipe.species)
    assert all(one.reflectance_spectrum is not None for one in materials.values())
    barks = {key: one for key, one in materials.items() if one.texture is not None}
    assert len(barks) > 1
    for key, one in barks.items():
        seen = 0.5 + 0.5 * one.texture.normals()[::3, ::3, 2].astype(float)
        image = one.texture.colour[::3, ::3].astype(float)
        mean = image.mean(axis=(0, 1))
        for wavelengths in ((420.0, 550.0, 670.0), (850.0, 1100.0, 1300.0), (1650.0, 2000.0, 2400.0)):
            out = Channels(wavelengths).texture(image, mean, one.reflectance_spectrum, seen)
            assert (out <= seen[..., None] + 1e-6).all()
            expected = one.reflectance_spectrum.at(wavelengths)
            np.testing.assert_allclose(out.mean(axis=(0, 1)), expected, rtol=2e-3, err_msg=str(key))
