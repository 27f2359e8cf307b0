"""Light of sun and sky against published values, and what it must do whatever the values."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from forestgen.atmosphere.daylight import (
    STANDARD_OZONE_DU,
    STANDARD_WATER_MM,
    Daylight,
    aerosol_optical_depth,
    air_mass,
    air_of,
    colour_temperature,
    daylight,
    illuminance,
    sunlight_aloft,
)
from forestgen.core.spectrum import Spectrum
from forestgen.render.skies.model import daylight_of
from forestgen.render.skies.overcast import overcast_daylight, overcast_illuminance
from forestgen.scene.colour import colour_science
from forestgen.scene.spec import Sky


def watts(spectrum: Spectrum) -> float:
    return float(np.trapezoid(spectrum.value, spectrum.wavelength_nm))


def seidelmann_lux(elevation_deg: float) -> float:
    """Level ground under an average clear sky (Explanatory Supplement to the Astronomical Almanac, 1992, 9.34)."""
    pieces = {
        20.0: (3.74, 3.97, -4.07, 1.47),
        5.0: (3.05, 13.28, -45.98, 64.33),
        -0.8: (2.88, 22.26, -207.64, 1034.30),
    }
    start = max(low for low in pieces if elevation_deg >= low)
    return float(10 ** np.polynomial.Polynomial(pieces[start])(elevation_deg / 90.0))


def ies_lux(elevation_deg: float) -> tuple[float, float]:
    """Sun and sky on level ground under a clear sky (IES RP-21 1984: extinction 0.21, air mass 1 / sine)."""
    sine = np.sin(np.radians(elevation_deg))
    return float(127_500 * np.exp(-0.21 / sine) * sine), float(800 + 15_500 * np.sqrt(sine))


@pytest.mark.parametrize("elevation_deg", [0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0])
def test_illuminance_of_level_ground_lies_in_the_range_of_seidelmanns_clear_days(elevation_deg: float) -> None:
    hazy, clear, pure = (illuminance(daylight(elevation_deg, turbidity).on_level) for turbidity in (7.0, 3.0, 1.5))
    expected = seidelmann_lux(elevation_deg)
    assert 0.9 * hazy < expected < 1.06 * pure
    assert clear == pytest.approx(expected, rel=0.2 if elevation_deg < 5 or elevation_deg == 45 else 0.15)


@pytest.mark.parametrize("elevation_deg", [30.0, 45.0, 60.0, 75.0, 90.0])
def test_illuminance_at_clear_noon_and_the_suns_share_as_the_ies_has_them(elevation_deg: float) -> None:
    sun, sky = ies_lux(elevation_deg)
    for turbidity, of_total in ((2.0, 0.1), (3.0, 0.1)):
        light = daylight(elevation_deg, turbidity)
        assert illuminance(light.on_level) == pytest.approx(sun + sky, rel=of_total)
    clearer, hazier = daylight(elevation_deg, 2.0), daylight(elevation_deg, 3.0)
    # The clear day of the IES has a turbidity of a little over 2.
    assert 0.78 * sun < illuminance(hazier.sun_on_level) < sun * 1.07
    assert 0.97 * sun < illuminance(clearer.sun_on_level) < sun * 1.07
    assert 0.97 * sky < illuminance(clearer.sky) < 1.1 * sky < illuminance(hazier.sky)


def test_the_skys_share_grows_with_haze_and_as_the_sun_sinks() -> None:
    def share(elevation_deg: float, turbidity: float) -> float:
        light = daylight(elevation_deg, turbidity)
        return illuminance(light.sky) / illuminance(light.on_level)

    by_haze = [share(50.0, turbidity) for turbidity in (1.0, 2.0, 3.0, 5.0, 7.0, 10.0)]
    by_height = [share(elevation, 3.0) for elevation in (80.0, 40.0, 20.0, 10.0, 5.0, 2.0)]
    assert (np.diff(by_haze) > 0.02).all()
    assert (np.diff(by_height) > 0.02).all()
    assert by_haze[0] < 0.08  # air alone scatters some 6% of the light
    assert by_height[-1] > 0.95


def test_what_each_number_does() -> None:
    base = daylight(40.0, 3.0)
    near = daylight(40.0, 3.0, sun_distance_au=0.983)
    np.testing.assert_allclose(near.sun.value, base.sun.value / 0.983**2, rtol=1e-12)
    np.testing.assert_allclose(near.sky.value, base.sky.value / 0.983**2, rtol=1e-12)
    wet, ozone = daylight(40.0, 3.0, precipitable_water_mm=40.0), daylight(40.0, 3.0, ozone_du=500.0)
    assert wet.sun.at(940.0) < 0.75 * base.sun.at(940.0)
    assert wet.sun.at(550.0) == base.sun.at(550.0)
    assert ozone.sun.at(600.0) < 0.985 * base.sun.at(600.0)
    assert ozone.sun.at(865.0) == base.sun.at(865.0)
    mountain = daylight(40.0, 3.0, altitude_m=3000.0)
    assert mountain.sun.at(350.0) > 1.2 * base.sun.at(350.0)
    snow = daylight(40.0, 3.0, 0.8)
    np.testing.assert_array_equal(snow.sun.value, base.sun.value)
    assert 1.1 < snow.sky.at(450.0) / base.sky.at(450.0) < 1.5


def test_haze_is_that_of_preetham() -> None:
    # Beta of appendix 1 at 1000 nm, Angstrom's exponent 1.3.
    assert aerosol_optical_depth(1.0, 1000.0) == pytest.approx(0.0002, abs=5e-5)
    assert aerosol_optical_depth(3.0, 1000.0) == pytest.approx(0.04608 * 3 - 0.04586, abs=1e-4)
    assert aerosol_optical_depth(3.0) / aerosol_optical_depth(3.0, 1000.0) == pytest.approx(2**1.3)


@pytest.mark.parametrize("elevation_deg", [1.0, 20.0, 45.0, 90.0])
def test_an_overcast_sky_has_its_illuminance_its_colour_and_no_sun(elevation_deg: float) -> None:
    light = overcast_daylight(daylight(elevation_deg, 3.0))
    assert not light.sun.value.any()
    assert illuminance(light.sun_on_level) == 0
    expected = 300 + 21_000 * np.sin(np.radians(elevation_deg))
    assert overcast_illuminance(elevation_deg) == pytest.approx(expected)
    assert illuminance(light.on_level) == pytest.approx(expected, rel=1e-9)
    kelvins, distance = colour_temperature(light.sky)
    assert kelvins == pytest.approx(6503, abs=10)
    assert distance == pytest.approx(0.0032, abs=2e-4)
    assert (light.sky.value > 0).all()
    # Clouds take away infrared, more where water absorbs: the share of the clear sky's light falls.
    clear = daylight(elevation_deg, 3.0).on_level
    through = light.sky.at([780.0, 865.0, 1040.0, 1240.0, 1650.0, 2200.0])
    through /= clear.at([780.0, 865.0, 1040.0, 1240.0, 1650.0, 2200.0])
    assert (np.diff(through) < 0).all()
    assert 0.3 < through[4] / through[0] < 0.8


def test_an_overcast_sky_gives_a_plausible_share_of_the_clear_ones_energy() -> None:
    for elevation_deg in (20.0, 40.0, 60.0):
        dull, clear = overcast_daylight(daylight(elevation_deg, 3.0)), daylight(elevation_deg, 3.0)
        assert 0.12 < watts(dull.on_level) / watts(clear.on_level) < 0.35
        assert 105 < illuminance(dull.sky) / watts(dull.sky) < 130  # lm/W of overcast skies, Littlefair 1985


def test_parts_on_level_ground_add_up() -> None:
    sky = Sky(30.0, 100.0, 3.0, altitude_m=500.0, sun_distance_au=1.01, precipitable_water_mm=20.0, ozone_du=300.0)
    light = daylight_of(sky)
    np.testing.assert_allclose(light.sun_on_level.value, 0.5 * light.sun.value)
    np.testing.assert_allclose(light.on_level.value, 0.5 * light.sun.value + light.sky.value)
    same = daylight(30.0, 3.0, 0.2, 500.0, sun_distance_au=1.01, precipitable_water_mm=20.0, ozone_du=300.0)
    np.testing.assert_array_equal(same.sun.value, light.sun.value)


@pytest.mark.parametrize("elevation_deg", [-5.0, 0.0, 90.1, float("nan")])
def test_a_sun_that_is_not_up_is_refused(elevation_deg: float) -> None:
    with pytest.raises(ValueError, match="above the horizon"):
        daylight(elevation_deg, 3.0)


def lights() -> list[Spectrum]:
    clear: Daylight = daylight(40.0, 3.0)
    names = ("A", "D50", "D65", "FL2", "FL11")
    return [clear.sun, clear.sky, daylight(2.0, 3.0).sun, daylight(60.0, 1.0).sky, *map(illuminant, names)]


def illuminant(name: str) -> Spectrum:
    colour = colour_science()

    light = colour.SDS_ILLUMINANTS[name]
    return Spectrum(np.asarray(light.wavelengths), np.asarray(light.values))


@pytest.mark.slow
def test_colour_temperatures_are_those_of_colour_science() -> None:
    colour = colour_science()
    cct_of_uv = colour.temperature.uv_to_CCT_Ohno2013

    matching = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    for light in lights():
        x, y, z = np.asarray(matching.values).T @ light.at(matching.wavelengths)
        assert illuminance(light) == pytest.approx(683.002 * y, rel=2e-4)
        kelvins, distance = cct_of_uv(np.array([4 * x, 6 * y]) / (x + 15 * y + 3 * z))
        ours = colour_temperature(light)
        assert ours[0] == pytest.approx(kelvins, rel=1e-3)
        assert ours[1] == pytest.approx(distance, abs=1e-4)


def test_colour_temperatures_of_black_bodies() -> None:
    wavelength = np.arange(300.0, 901.0)
    for kelvins in (1005.0, 2856.0, 6504.0, 25_000.0, 99_000.0):
        body = Spectrum(wavelength, wavelength**-5.0 / np.expm1(1.438776877e7 / (wavelength * kelvins)))
        found, distance = colour_temperature(body)
        assert found == pytest.approx(kelvins, rel=1e-4)
        assert abs(distance) < 1e-5


def test_light_by_angles_waits_for_no_heavy_library() -> None:
    """Pandas, pvlib and colour-science take seconds to load."""
    code = (
        "import sys\n"
        "from forestgen.atmosphere import daylight\n"
        "daylight.colour_temperature(daylight.daylight(30.0, 3.0, 0.2).sky)\n"
        "print([name for name in ('pandas', 'pvlib', 'colour', 'scipy', 'mitsuba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_clouds_under_a_low_sun_get_more_light_than_the_ground_and_less_red() -> None:
    """The air below them has not reddened it; a high sun's light is that of the ground."""
    air = air_of(3.0, 0.0, STANDARD_WATER_MM, STANDARD_OZONE_DU)
    wavelength = np.array([450.0, 550.0, 650.0])

    def gain(elevation_deg: float, height_m: float) -> np.ndarray:
        light = daylight(elevation_deg, 3.0).sun
        return sunlight_aloft(light, elevation_deg, air, 0.0, height_m).at(wavelength) / light.at(wavelength)

    np.testing.assert_array_equal(gain(50.0, 2000.0), 1.0)
    np.testing.assert_allclose(gain(3.0, 0.0), 1.0, rtol=1e-12)
    low, high = gain(3.0, 2000.0), gain(3.0, 9000.0)
    assert (np.diff(low) < 0).all()
    assert (high > low).all()
    # By hand at 550 nm: 74% of the aerosol and 21.5% of the air's molecules, of depth 0.0979, lie below 2 km.
    depth = 0.7364 * aerosol_optical_depth(3.0, 550.0) + 0.2150 * 0.0979
    assert low[1] == pytest.approx(np.exp(depth * (air_mass(3.0) - 1.66)), rel=0.06)
