"""The sky's map: its integral, its directions, its ends."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import illuminance
from forestgen.render import light as light_module
from forestgen.render.light import SUN_RADIUS_DEG, sky_map, sun_radiance
from forestgen.render.skies import hosek, model
from forestgen.render.skies.model import daylight_of, map_directions
from forestgen.render.variant import drjit
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Sky

VISIBLE, INFRARED = Channels((450.0, 553.0, 690.0)), Channels((345.0, 865.0, 1610.0))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture(autouse=True)
def _no_map_of_another_size() -> Iterator[None]:
    yield
    hosek.hosek_shape.cache_clear()


def level_light(image: NDArray[np.float32], part: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """(3,) irradiance of a level plane under a map, straight lines between its rows: Gauss' rule in each gap.

    Parameters
    ----------
    part : (rows, columns) directions that count.
    """
    rows, columns = image.shape[:2]
    values = image.astype(np.float64) if part is None else image * part[..., None]
    by_row = values.sum(axis=1) * (2 * np.pi / columns)
    theta = np.arange(rows) / (rows - 1) * np.pi
    total = np.zeros(3)
    for low, high, below, above in zip(theta, theta[1:], by_row, by_row[1:], strict=False):
        for place, weight in ((-np.sqrt(0.6), 5 / 9), (0.0, 8 / 9), (np.sqrt(0.6), 5 / 9)):
            share = 0.5 + 0.5 * place
            t = low + share * (high - low)
            total += (
                weight * 0.5 * (high - low) * np.sin(t) * max(np.cos(t), 0.0) * ((1 - share) * below + share * above)
            )
    return total


@pytest.mark.parametrize(
    "sky",
    [
        Sky(1.0, 90.0, 3.0),
        Sky(10.0, 200.0, 2.0, 0.1),
        Sky(40.0, 140.0, 3.0),
        Sky(60.0, -30.0, 8.0, 0.6, altitude_m=1500.0),
        Sky(90.0, 0.0, 1.0),
        Sky(25.0, 140.0, 3.0, kind="overcast"),
    ],
)
def test_the_maps_light_on_level_ground_is_that_of_the_spectra(sky: Sky) -> None:
    light = daylight_of(sky)
    for channels in (VISIBLE, INFRARED):
        ours = level_light(sky_map(sky, channels))
        np.testing.assert_allclose(ours, light.sky.at(channels.wavelength_nm), rtol=5e-3)
    in_colour = level_light(sky_map(sky, RGB))
    assert in_colour @ LUMINANCE == pytest.approx(illuminance(light.sky), rel=5e-3)
    if sky.sun_elevation_deg > 5:  # else its orange lies outside of Rec. 709
        np.testing.assert_allclose(in_colour, RGB.of_light(light.sky), rtol=5e-3)


@pytest.mark.parametrize(("elevation_deg", "azimuth_deg"), [(8.0, 90.0), (30.0, 0.0), (50.0, 200.0), (70.0, -45.0)])
def test_the_sky_is_brightest_at_the_suns_azimuth(elevation_deg: float, azimuth_deg: float) -> None:
    sky = Sky(elevation_deg, azimuth_deg, 2.0)
    east, north = np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))
    image, directions = sky_map(sky, RGB) @ LUMINANCE, map_directions()
    # A low sun's sky is brightest below the sun, at the horizon.
    brightest = directions[np.unravel_index(np.argmax(image), image.shape)]
    assert brightest[:2] / np.linalg.norm(brightest[:2]) == pytest.approx([east, north], abs=0.06)
    # Around the sun it is brighter than at the same height to its left and right, which are alike.
    at_height = np.argmin(np.abs(directions[:, 0, 2] - np.sin(np.radians(elevation_deg))))
    turned_deg = np.degrees(np.arctan2(directions[at_height, :, 0], directions[at_height, :, 1])) - azimuth_deg
    around = np.argsort((turned_deg + 180) % 360 - 180)
    row = image[at_height][around]
    middle = len(row) // 2
    assert abs(np.argmax(row) - (middle - 0.5)) < 1
    np.testing.assert_allclose(row, row[::-1], rtol=0.03)
    assert row[middle] > 1.5 * row[middle // 2]


@pytest.mark.parametrize("kind", ["clear", "overcast"])
@pytest.mark.parametrize("channels", [RGB, VISIBLE])
def test_black_begins_right_below_the_horizon(kind: str, channels: Channels) -> None:
    image = sky_map(Sky(30.0, 140.0, 3.0, kind=kind), channels)  # type: ignore[arg-type]
    up = map_directions()[..., 2]
    horizon = len(image) // 2
    assert np.abs(up[horizon]).max() < 1e-12
    assert not image[horizon + 1 :].any()
    assert (image[: horizon + 1] > 0).all()
    # The horizon itself is about as bright as what is next to it: no dark seam, which a map without its row would have.
    np.testing.assert_allclose(image[horizon], image[horizon - 1], rtol=0.4)


@pytest.mark.parametrize("elevation_deg", [0.05, 1.0, 3.0, 45.0, 90.0])
@pytest.mark.parametrize("turbidity", [1.0, 3.0, 10.0])
def test_all_suns_and_hazes_give_colours_that_a_renderer_takes(elevation_deg: float, turbidity: float) -> None:
    sky = Sky(elevation_deg, 140.0, turbidity)
    for channels in (RGB, VISIBLE, INFRARED):
        for values in (sky_map(sky, channels), sun_radiance(sky, channels)):
            assert np.isfinite(values).all()
            assert (values >= 0).all()
    sun = daylight_of(sky).sun
    solid_angle = np.pi * np.sin(np.radians(SUN_RADIUS_DEG)) ** 2
    assert sun_radiance(sky, RGB) @ LUMINANCE * solid_angle == pytest.approx(illuminance(sun), rel=1e-3)
    np.testing.assert_allclose(sun_radiance(sky, VISIBLE) * solid_angle, sun.at(VISIBLE.wavelength_nm))


def test_the_suns_disc_has_the_luminance_that_is_known_of_it() -> None:
    # 1.6e9 cd/m² at noon (CIE, Ryer 1997), 2e9 above the air.
    assert 1.2e9 < sun_radiance(Sky(60.0, 180.0, 2.5), RGB) @ LUMINANCE < 1.8e9


def test_an_overcast_sky_is_three_times_as_bright_at_the_zenith_and_has_no_sun() -> None:
    sky = Sky(35.0, 140.0, 3.0, kind="overcast")
    image = sky_map(sky, VISIBLE).astype(np.float64)
    height = map_directions()[: len(image) // 2 + 1, 0, 2]
    np.testing.assert_allclose(image[: len(height)].std(axis=1), 0, atol=1e-9)
    expected = image[0, 0] * (1 + 2 * height[:, None]) / 3
    np.testing.assert_allclose(image[: len(height), 0], expected, rtol=1e-5)
    # Its light on level ground is 7 pi / 9 of the zenith's radiance (Moon and Spencer 1942).
    np.testing.assert_allclose(daylight_of(sky).sky.at(VISIBLE.wavelength_nm), image[0, 0] * 7 * np.pi / 9, rtol=1e-3)
    for channels in (RGB, VISIBLE):
        np.testing.assert_array_equal(sun_radiance(sky, channels), 0)


def test_a_finer_map_has_the_same_aureole(monkeypatch: pytest.MonkeyPatch) -> None:
    sky = Sky(30.0, 140.0, 8.0)
    near = {}
    for rows, columns in ((129, 256), (257, 512), (513, 1024)):
        for module in (hosek, model, light_module):
            monkeypatch.setattr(module, "MAP_ROWS", rows)
            monkeypatch.setattr(module, "MAP_COLUMNS", columns)
        hosek.hosek_shape.cache_clear()
        image = sky_map(sky, VISIBLE)
        angle_deg = np.degrees(np.arccos(np.clip(map_directions(rows, columns) @ sky.to_sun, -1, 1)))
        near[rows] = [level_light(image, angle_deg < degrees)[1] for degrees in (5.0, 10.0, 20.0)] + [image.max()]
    np.testing.assert_allclose(near[129], near[513], rtol=0.02)  # the edge of the part is as coarse as the map
    np.testing.assert_allclose(near[257], near[513], rtol=0.01)
    assert near[129][-1] == pytest.approx(near[513][-1], rel=0.005)
    assert near[129][1] / daylight_of(sky).sky.at(553.0) > 0.05


def test_the_number_of_threads_does_not_matter() -> None:
    dr = drjit()
    before = dr.thread_count()
    images = []
    try:
        for threads in (1, 3):
            dr.set_thread_count(threads)
            hosek.hosek_shape.cache_clear()
            images.append(sky_map(Sky(33.0, 77.0, 4.0), VISIBLE))
    finally:
        dr.set_thread_count(before)
    np.testing.assert_array_equal(*images)
