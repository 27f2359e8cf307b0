"""Dusk, night and the moon."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from forestgen.atmosphere.daylight import colour_temperature, illuminance
from forestgen.atmosphere.moon import ecliptic_position, moonlight_share
from forestgen.atmosphere.twilight import illuminance_below, night_radiance
from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.recipe.spectra import load_table
from forestgen.render.light import has_sun, moon_phase, sky_map
from forestgen.render.skies.model import MAP_ROWS, casts_shadows, daylight_of, map_directions
from forestgen.render.skies.night import twilight_of
from forestgen.render.sky import level_irradiance
from forestgen.render.variant import SCALAR, using
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Moon, Sky

KINDS = ("clear", "overcast")


def lux(elevation_deg: float, kind: str = "clear", moon: Moon | None = None) -> float:
    return illuminance(daylight_of(Sky(elevation_deg, 140.0, 3.0, kind=kind, moon=moon)).on_level)


@pytest.mark.parametrize("kind", KINDS)
def test_dusk_goes_on_from_day_and_falls_steadily_into_night(kind: str) -> None:
    assert lux(1e-3, kind) == pytest.approx(lux(0.0, kind), rel=2e-3)
    falling = [lux(elevation, kind) for elevation in (0.0, -6.0, -12.0, -17.9, -18.1, -90.0)]
    assert np.all(np.diff(falling) <= 0)
    assert falling[-1] == pytest.approx(falling[-2], rel=1e-3)


def test_amounts_are_those_of_the_almanac() -> None:
    """Civil twilight ends at 3.4 lux, nautical at 0.008; the dark zenith has 2 to 3e-4 cd/m²."""
    assert illuminance_below(-6.0) == pytest.approx(3.4, rel=0.01)
    assert illuminance_below(-12.0) == pytest.approx(0.008, rel=0.1)
    assert illuminance_below(-18.0) == 0.0
    assert 2e-4 < illuminance(night_radiance()) < 3e-4


def test_the_scattering_model_itself_has_nearly_the_almanacs_fall() -> None:
    """Before its amount is set: within half from the horizon to -6 degrees."""
    sky = Sky(-6.0, 140.0, 3.0)
    light = twilight_of(sky)
    assert light.modelled_share == pytest.approx(illuminance_below(-6.0) / illuminance_below(0.0), rel=0.5)


def test_dusk_is_bright_where_the_sun_went_down_and_blue_above() -> None:
    sky = Sky(-6.0, 140.0, 3.0)
    with using(SCALAR):
        radiance = sky_map(sky, RGB).astype(np.float64)
    luminance = radiance @ np.array(LUMINANCE)
    assert level_irradiance(radiance.astype(np.float32)) @ np.array(LUMINANCE) == pytest.approx(lux(-6.0), rel=0.01)
    row = round(80.0 / 180.0 * (MAP_ROWS - 1))  # 10 degrees up
    towards = map_directions()[row] @ sky.to_sun
    assert luminance[row, np.argmax(towards)] > 4 * luminance[row, np.argmin(towards)]
    red, _, blue = radiance[0, 0]
    assert blue > 4 * red
    day, dusk = (colour_temperature(daylight_of(Sky(one, 140.0, 3.0)).sky)[0] for one in (0.0, -6.0))
    assert dusk > 2 * day  # ozone


def test_the_moons_place_and_light_are_the_published_ones() -> None:
    """Meeus (1998), example 47.a; magnitudes of Allen (1973) by Krisciunas and Schaefer (1991, equation 9)."""
    longitude, latitude, distance_km = ecliptic_position(datetime(1992, 4, 12, tzinfo=UTC))
    assert (longitude, latitude) == pytest.approx((133.163, -3.229), abs=0.3)
    assert distance_km == pytest.approx(368410, rel=0.005)
    sun = load_table("standards/spctrl2")["sun"]
    for phase in (7.0, 30.0, 60.0, 90.0, 120.0):
        share = moonlight_share(phase, sun.wavelength_nm)
        allen = 10.0 ** (-0.4 * (-12.73 + 0.026 * phase + 4e-9 * phase**4 + 13.98))
        assert illuminance(Spectrum(sun.wavelength_nm, sun.value * share)) == pytest.approx(allen, rel=0.04)


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_moon_lights_a_night_and_casts_shadows_in_the_open(kind: str) -> None:
    moon = Moon(40.0, 320.0, 0.0)
    sky = Sky(-30.0, 140.0, 3.0, kind=kind, moon=moon)
    assert (0.1 < lux(-30.0, kind, moon) < 0.3) == (kind == "clear")
    assert casts_shadows(sky) == (kind == "clear") == has_sun(sky)
    assert sky.to_light @ Sky(40.0, 320.0, 3.0).to_sun == pytest.approx(1.0)
    assert not casts_shadows(Sky(-30.0, 140.0, 3.0, kind=kind))
    by_day = Sky(30.0, 140.0, 3.0, kind=kind, moon=moon)
    assert moon_phase(by_day) is None
    assert np.array_equal(by_day.to_light, by_day.to_sun)
