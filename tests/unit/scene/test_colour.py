"""Colours of spectra against colour-science, and spectra of colours back to their colours."""

import numpy as np
import pytest

from forestgen.core.spectrum import LUMENS_PER_WATT, Spectrum
from forestgen.recipe.assets import list_assets
from forestgen.recipe.spectra import load_spectra
from forestgen.scene.colour import (
    colour_of_radiance,
    colour_of_reflectance,
    colour_science,
    colours_of_surface,
    observer,
    primaries,
    rec709_from_xyz,
)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def flat(value: float) -> Spectrum:
    return Spectrum(np.array([300.0, 2500.0]), np.array([value, value]))


def d65(wavelength_nm: np.ndarray) -> np.ndarray:
    daylight = colour_science().SDS_ILLUMINANTS["D65"]
    return np.interp(wavelength_nm, daylight.wavelengths, daylight.values)


def test_the_shipped_tables_are_colour_sciences():
    wavelength, response = observer()
    matching = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    np.testing.assert_array_equal(wavelength, matching.wavelengths)
    to_rgb = np.linalg.inv(colour_science().RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ)
    np.testing.assert_allclose(rec709_from_xyz(), to_rgb, atol=1e-12)
    np.testing.assert_allclose(response, LUMENS_PER_WATT * to_rgb @ matching.values.T, atol=1e-9)


@pytest.mark.parametrize("chart", ["ISO 17321-1", "babel_average"])
def test_colours_of_reflectances_are_colour_sciences(chart):
    """Every patch of a ColorChecker, by colour-science's integration with the same D65, to 1e-6."""
    matching = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    light = colour_science().SpectralDistribution(d65(matching.wavelengths), matching.wavelengths)
    patches = colour_science().SDS_COLOURCHECKERS[
        {"ISO 17321-1": "ISO 17321-1", "babel_average": "BabelColor Average"}[chart]
    ]
    assert len(patches) == 24
    for name, patch in patches.items():
        spectrum = Spectrum(np.asarray(patch.wavelengths, dtype=float), np.asarray(patch.values))
        fine = colour_science().SpectralDistribution(spectrum.at(matching.wavelengths), matching.wavelengths)
        xyz = colour_science().sd_to_XYZ(fine, matching, light, method="Integration") / 100
        np.testing.assert_allclose(
            colour_of_reflectance(spectrum), rec709_from_xyz() @ xyz, atol=1e-6, err_msg=f"{chart}: {name}"
        )


def test_a_white_surface_is_white_and_a_grey_one_grey():
    white = colour_of_reflectance(flat(1.0))
    assert LUMINANCE @ white == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(white, 1.0, atol=3e-4)  # D65 of the table against D65 of Rec. 709's white
    np.testing.assert_allclose(colour_of_reflectance(flat(0.18)), 0.18 * white, rtol=1e-12)


def test_light_of_555_nm_has_683_lumens_a_watt():
    line = Spectrum(np.array([554.0, 555.0, 556.0]), np.array([0.0, 1.0, 0.0]))  # 1 W/m²/sr in all
    assert LUMINANCE @ colour_of_radiance(line) == pytest.approx(683.0, rel=1e-4)


def test_infrared_has_no_colour():
    assert np.abs(colour_of_radiance(Spectrum(np.array([840.0, 841.0, 2500.0]), np.array([0.0, 1.0, 1.0])))).max() == 0


def test_colours_come_back_from_their_spectra():
    """Within 0.2% of white: the primaries were made by another table of daylight."""
    rng = np.random.default_rng(0)
    basis = primaries()
    grid = np.arange(300.0, 2501.0)
    for rgb in [*np.eye(3), *rng.random((20, 3))]:
        value = sum(share * one.at(grid) for share, one in zip(rgb, basis, strict=True))
        assert value.min() >= 0
        assert value.max() <= 1 + 1e-6
        np.testing.assert_allclose(colour_of_reflectance(Spectrum(grid, value)), rgb, atol=2e-3)


def test_colours_of_surfaces_conserve_energy():
    """Also that of a saturated orange, whose reflectance and transmittance hold more red than white does."""
    grid = np.array([300.0, 560.0, 565.0, 2500.0])
    orange = Spectrum(grid, np.array([0.0, 0.0, 0.5, 0.5]))
    assert 2 * colour_of_reflectance(orange)[0] > 1.05
    for r, t in [(orange, orange), (flat(1.0), None), (flat(0.6), flat(0.4))]:
        reflectance, transmittance = np.array(colours_of_surface(r, t))
        assert (reflectance >= 0).all()
        assert (transmittance >= 0).all()
        assert (reflectance + transmittance <= 1 + 1e-12).all()
    r, t = np.array(colours_of_surface(orange, orange))
    np.testing.assert_allclose(r, t)


def test_shipped_surfaces_have_the_colours_of_their_spectra():
    """Those of Rec. 709's gamut exactly; clipping changes transmittances alone, whose blue is about 0."""
    for name in list_assets("spectra"):
        if name.startswith(("responses/", "standards/")):
            continue
        columns = load_spectra(name)
        for key, spectrum in columns.items():
            if key.startswith("reflectance"):
                raw = colour_of_reflectance(spectrum)
                found, _ = colours_of_surface(spectrum, columns.get(key.replace("reflectance", "transmittance")))
                np.testing.assert_allclose(found, raw, atol=1e-9, err_msg=f"{name}: {key}")


def test_numbers_print_as_before() -> None:
    """colour-science asks NumPy for its printing of 2017."""
    assert colour_science().__name__ == "colour"
    assert (repr(np.array([np.nan])), repr(np.float64(1.5))) == ("array([nan])", "np.float64(1.5)")
