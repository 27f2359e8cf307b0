"""SPCTRL2 against another implementation, and against the standard solar spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.atmosphere.daylight import Air, air_mass, clear_spectra, daylight, pressure_pa


@pytest.mark.parametrize("elevation_deg", [0.5, 5.0, 40.0, 90.0])
@pytest.mark.parametrize(("depth", "exponent", "altitude_m"), [(0.0, 1.3, 0.0), (0.2, 1.14, 0.0), (1.0, 1.3, 3000.0)])
def test_it_is_the_model_that_pvlib_has(elevation_deg: float, depth: float, exponent: float, altitude_m: float) -> None:
    from pvlib.atmosphere import alt2pres, get_relative_airmass
    from pvlib.spectrum import spectrl2

    zenith = 90.0 - elevation_deg
    theirs = spectrl2(
        apparent_zenith=zenith,
        aoi=zenith,
        surface_tilt=0,
        ground_albedo=0.3,
        surface_pressure=alt2pres(altitude_m),
        relative_airmass=get_relative_airmass(zenith, "kastenyoung1989"),
        precipitable_water=2.0,
        ozone=0.25,
        aerosol_turbidity_500nm=depth,
        alpha=exponent,
        dayofyear=93,
    )
    nearer = np.ravel(theirs["dni_extra"])[25] / 1.909  # of day 93 against the mean distance, at 500 nm
    air = Air(depth, exponent, water_cm=2.0, ozone_cm=0.25, pressure_pa=pressure_pa(altitude_m))
    wavelength, sun, sky = clear_spectra(elevation_deg, air, 0.3, 1.0)
    np.testing.assert_array_equal(wavelength, theirs["wavelength"])
    np.testing.assert_allclose(sun * nearer, np.ravel(theirs["dni"]), rtol=1e-10, atol=1e-30)
    np.testing.assert_allclose(sky * nearer, np.ravel(theirs["dhi"]), rtol=1e-10, atol=1e-30)


def test_the_sun_of_the_standard_spectrum_astm_g173() -> None:
    """AM 1.5, aerosol 0.084 at 500 nm, 1.416 cm of water, 343.8 DU: direct light of 900.1 W/m² (ASTM G173-03)."""
    from pvlib.spectrum import get_reference_spectra

    standard = get_reference_spectra(standard="ASTM G173-03")["direct"]
    air = Air(0.084, 1.3, water_cm=1.416, ozone_cm=0.3438, pressure_pa=101325.0)
    wavelength, sun, _ = clear_spectra(90.0 - 48.19, air, 0.2, 1.0)
    assert air_mass(90.0 - 48.19) == pytest.approx(1.5, abs=0.003)
    assert np.trapezoid(sun, wavelength) == pytest.approx(900.1, rel=0.025)
    for low, high in ((400, 500), (500, 600), (600, 700), (700, 900), (1000, 1300), (1500, 1700), (2050, 2350)):
        grid = np.arange(low, high + 1.0)
        ours = np.interp(grid, wavelength, sun).mean()
        assert ours == pytest.approx(np.interp(grid, standard.index, standard).mean(), rel=0.06), (low, high)


def test_air_masses_and_pressures_as_published() -> None:
    # Kasten and Young 1989, table II; ISO 2533.
    for elevation_deg, expected in ((90.0, 1.0), (30.0, 1.9943), (10.0, 5.5841), (5.0, 10.3164), (1.0, 26.3096)):
        assert air_mass(elevation_deg) == pytest.approx(expected, rel=2e-3)
    for altitude_m, expected_hpa in ((0.0, 1013.25), (1000.0, 898.8), (3000.0, 701.1)):
        assert pressure_pa(altitude_m) / 100 == pytest.approx(expected_hpa, rel=2e-3)


@pytest.mark.parametrize("elevation_deg", [0.05, 0.5, 1.0, 2.0, 5.0, 20.0, 60.0, 90.0])
def test_low_suns_and_every_haze_give_light_that_can_be(elevation_deg: float) -> None:
    skies, suns = [], []
    for turbidity in (1.0, 1.5, 3.0, 6.0, 10.0):
        for altitude_m in (-400.0, 0.0, 5000.0):
            light = daylight(elevation_deg, turbidity, 0.5, altitude_m=altitude_m)
            for spectrum in (light.sun.value, light.sky.value):
                assert np.isfinite(spectrum).all()
                assert (spectrum >= 0).all()
            assert (light.sun.value < 2.1).all()  # what there is in space
            assert light.sky.at(550.0) > 1e-6
        suns.append(float(daylight(elevation_deg, turbidity).sun.at(550.0)))
        skies.append(float(daylight(elevation_deg, turbidity).sky.at(550.0)))
    assert (np.diff(suns) < 0).all()  # haze takes from the sun
    if elevation_deg >= 20:
        assert (np.diff(skies) > 0).all()  # and gives to the sky
