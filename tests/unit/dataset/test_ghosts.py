"""Ghosts of a double Gauss: where they lie, and that they have the light that two surfaces throw back."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.dataset import ghosts
from forestgen.dataset.ghosts import ghosts_of, reflectance


def about(sun_px, f_number=8.0, focal_px=300.0):
    nm, light = [610.0, 550.0, 465.0], [1e5, 1e5, 1e5]
    return {
        "surfaces": "coated",
        "sun_px": sun_px,
        "focal_px": focal_px,
        "f_number": f_number,
        "irradiance": light,
        "wavelength_nm": nm,
    }


def test_the_lens_is_that_of_the_patent():
    """Of 50 mm, f/2: the pupil of 25 mm passes the stop of 17.1 mm."""
    at_stop, height, slope = ghosts._trace(1.0, 0.0, None)
    assert -1.0 / slope == pytest.approx(50.0, rel=0.01)
    assert -height / slope == pytest.approx(36.1, abs=0.1)
    assert at_stop * 12.6 == pytest.approx(17.1 / 2, rel=0.02)


def test_coatings_reflect_little_in_green_and_cemented_glasses_less():
    assert reflectance(0, 550.0) == pytest.approx(((1.0 * 1.67 - 1.38**2) / (1.67 + 1.38**2)) ** 2, rel=1e-9)
    assert reflectance(0, 465.0) > reflectance(0, 550.0) < reflectance(0, 610.0)
    assert reflectance(0, 550.0, coated=False) == pytest.approx((0.67 / 2.67) ** 2)
    assert reflectance(7, 550.0) == pytest.approx((0.055 / 3.261) ** 2, rel=1e-6)


@pytest.mark.parametrize("number", [1, 8, 18])
def test_a_ghost_has_all_light_that_two_surfaces_throw_back(monkeypatch, number):
    """Luminance times pi / 4 N² is light on the sensor; in all, that through the stop's image in the front lens."""
    one = ghosts.ghosts()[number]
    monkeypatch.setattr(ghosts, "ghosts", lambda: (one,))
    given = about([0.0, 0.0])
    found = ghosts_of(given, (1200, 1200))[..., 1].sum() * np.pi / (4.0 * 8.0**2)
    back = reflectance(one.surfaces[0], 550.0) * reflectance(one.surfaces[1], 550.0)
    pupil_px = one.radius / one.spread / 8.0 * 300.0
    assert found == pytest.approx(1e5 * back * np.pi * pupil_px**2, rel=0.02)


def test_ghosts_lie_on_the_line_through_the_sun_and_the_middle():
    image = ghosts_of(about([90.0, 0.0]), (400, 300))[..., 1]
    assert image.max() > 100.0
    np.testing.assert_allclose(image, image[::-1], atol=1e-9 * image.max())
    turned = ghosts_of(about([-90.0, 0.0]), (400, 300))[..., 1]
    np.testing.assert_allclose(turned, image[:, ::-1], atol=1e-9 * image.max())
