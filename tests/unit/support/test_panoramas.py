"""Figures of panoramas whose figures are known."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from support.panoramas import (
    BANDS_DEG,
    chromaticity,
    compare,
    elevation_deg,
    exact_gaps,
    halved,
    mean_log,
    measure,
    otsu,
    read_panorama,
    slope,
    solid_angles,
    sunlit_over_shaded,
)

ROWS = 128
GREY = np.ones(3)


def banded(values: list[float], colour: np.ndarray = GREY, rows: int = ROWS) -> np.ndarray:
    """A panorama with one brightness in each band."""
    elevations = elevation_deg(rows)
    picture = np.empty((rows, 2 * rows, 3))
    for (low, high), value in zip(BANDS_DEG, values, strict=True):
        picture[(elevations >= low) & (elevations < high)] = value * colour
    return picture


def fractal_rows(exponent: float, elevations_deg: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
    """Rows whose power per cycle per degree of arc falls as frequency to the `exponent`, the same at all elevations."""
    rows = []
    for elevation in elevations_deg:
        arc_deg = 360.0 * np.cos(np.radians(elevation))
        frequency = np.arange(1, width // 2 + 1) / arc_deg
        noise = rng.standard_normal((2, len(frequency)))
        amplitude = np.sqrt(frequency**exponent / arc_deg) * width * (noise[0] + 1j * noise[1])
        rows.append(np.fft.irfft(np.concatenate([[0.0], amplitude]), width))
    return np.array(rows)


def test_bands_of_known_brightness_and_colour():
    values, colour = [0.5, 0.6, 0.8, 1.0, 2.0, 3.0, 4.0], np.array([1.3, 1.0, 0.6])
    grain = np.exp(0.01 * np.random.default_rng(0).standard_normal((ROWS, 2 * ROWS, 1)))
    found = measure(banded(values, colour) * grain).bands
    brightness = colour @ [0.2126, 0.7152, 0.0722]
    for value, band in zip(values, found, strict=True):
        assert band.log_luminance == pytest.approx(np.log(value * brightness), abs=0.001)
        assert band.uv == pytest.approx(chromaticity(colour))


def test_chromaticities_of_white_and_of_the_primaries():
    assert chromaticity(GREY) == pytest.approx((0.1978, 0.4683), abs=1e-4)  # D65
    assert chromaticity(np.array([1.0, 0.0, 0.0])) == pytest.approx((0.4507, 0.5229), abs=1e-4)
    assert chromaticity(np.array([0.0, 0.0, 1.0])) == pytest.approx((0.1754, 0.1579), abs=1e-4)


def test_pixels_count_by_their_solid_angle():
    assert solid_angles(ROWS)[elevation_deg(ROWS) > 30].sum() / solid_angles(ROWS).sum() == pytest.approx(
        0.25, abs=0.01
    )
    half = np.where(elevation_deg(ROWS) > 30, np.e, 1.0)[:, None, None] * np.ones((ROWS, 2 * ROWS, 3))
    assert mean_log(half) == pytest.approx(0.25, abs=0.01)


def test_the_spread_of_log_luminance():
    rng = np.random.default_rng(1)
    picture = np.exp(0.4 * rng.standard_normal((ROWS, 2 * ROWS, 1))) * GREY
    assert [band.spread for band in measure(picture).bands] == pytest.approx([0.4] * 7, rel=0.05)


def test_values_of_zero_and_below_count_as_a_tenth_of_the_median():
    picture = banded([1.0] * 7)
    dark = np.random.default_rng(8).random((ROWS, 2 * ROWS)) < 0.25
    picture[dark] = -3.0
    assert mean_log(picture) == pytest.approx(0.25 * np.log(0.1), abs=0.03)


def test_otsu_parts_two_classes():
    values = np.concatenate(
        [np.random.default_rng(2).normal(0, 0.3, 3000), np.random.default_rng(3).normal(4, 0.3, 700)]
    )
    assert 1.0 < otsu(values) < 3.0


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_gaps_of_a_known_mask(share):
    """Crowns whose edges run through pixels: plants of uneven brightness, a sky that is brighter below 40 degrees."""
    rng, finer = np.random.default_rng(4), 4
    rows = finer * ROWS
    noise = gaussian_filter(rng.standard_normal((rows, 2 * rows)), 5.0, mode=("nearest", "wrap"))
    mask = (noise > np.quantile(noise, 1 - share)) & (elevation_deg(rows) > 0)[:, None]
    plants = 0.1 * np.exp(0.6 * rng.standard_normal((rows, 2 * rows)))
    light = np.where(mask, 6.0 + 3.0 * (elevation_deg(rows)[:, None] < 40), plants)
    picture = light.reshape(ROWS, finer, 2 * ROWS, finer).mean(axis=(1, 3))[..., None] * np.array([0.7, 1.0, 1.8])
    assert [band.gaps for band in measure(picture).bands] == pytest.approx(exact_gaps(mask), abs=0.05)


@pytest.mark.parametrize("exponent", [-0.6, -1.4, -2.2])
def test_the_slope_of_a_power_law(exponent):
    elevations = elevation_deg(256)[::2]
    rows = fractal_rows(exponent, elevations, 512, np.random.default_rng(5))
    assert slope(rows, elevations) == pytest.approx(exponent, abs=0.04)
    high = elevations > 60
    assert slope(rows[high], elevations[high]) == pytest.approx(exponent, abs=0.15)


def test_sunlit_over_shaded_ground():
    picture = banded([1.0] * 7)
    picture[:, ::5] *= 4.0
    assert sunlit_over_shaded(picture) == pytest.approx(4.0)


def test_equal_panoramas_keep_all_bounds_and_others_break_their_own():
    rng = np.random.default_rng(6)
    picture = np.exp(0.5 * rng.standard_normal((256, 512, 1))) * np.array([1.0, 1.0, 0.8])
    picture[:90, ::3] *= 30.0
    assert all(one.kept for one in compare(picture, picture))
    dark = picture.copy()
    dark[elevation_deg(256) < -60] *= 0.7
    broken = [(one.band, one.name) for one in compare(picture, dark) if not one.kept]
    assert broken == [("-90 to -60", "luminance")]
    red = picture.copy()
    red[(elevation_deg(256) > -30) & (elevation_deg(256) < -10)] *= [2.0, 1.0, 1.0]
    assert ("-30 to -10", "u'v'") in [(one.band, one.name) for one in compare(picture, red) if not one.kept]


def test_halving_keeps_even_light_and_the_seam():
    even = np.full((64, 128, 3), 2.0)
    assert halved(even) == pytest.approx(np.full((32, 64, 3), 2.0), rel=1e-5)
    waves = np.sin(np.arange(128) / 128 * 4 * np.pi)[None, :, None] * np.ones((64, 1, 3))
    smaller = halved(waves)
    assert smaller == pytest.approx(np.roll(smaller, 32, axis=1), abs=1e-5)


def test_a_module_of_base64_and_its_file_are_the_same(tmp_path: Path):
    import OpenEXR

    picture = np.random.default_rng(7).random((4, 8, 3)).astype(np.float16)
    channels = {name: np.ascontiguousarray(picture[..., k]) for k, name in enumerate("RGB")}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(
        str(tmp_path / "one.exr")
    )
    text = base64.b64encode((tmp_path / "one.exr").read_bytes()).decode()
    (tmp_path / "one.exr.js").write_text(f"export default 'data:application/exr;base64,{text}'\n")
    for name in ("one.exr", "one.exr.js"):
        assert np.array_equal(read_panorama(tmp_path / name), picture.astype(np.float64))
