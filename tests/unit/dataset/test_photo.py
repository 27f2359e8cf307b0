"""Lenses of raw images, and the pictures that cameras make of them."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from forestgen.core.spectrum import Band, Spectrum
from forestgen.dataset.check import light as light_checks
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.colour_matrix import colour_matrix
from forestgen.dataset.optics import falloff, through_lens
from forestgen.dataset.photo import NAME, daylight_rgb, grey_temperature, linear_colours, photo_of, with_photo
from forestgen.dataset.raw import d65, raw_image, write_raw
from forestgen.recipe.exposure import Exposure, Jpeg
from forestgen.recipe.spectra import load_table
from forestgen.render.frame import Radiance
from forestgen.scene.colour import colour_of_reflectance
from forestgen.scene.colour_checker import patches
from support.scenes import camera_at

CAMERA = camera_at((0.0, 0.0, 1.7), (0.0, 10.0, 1.7), (96, 64))


def raw_of(light, **keys):
    light = np.asarray(light, np.float32)
    return raw_image(Radiance(light, light, None, 4), CAMERA, Exposure(**keys), 1)


def test_glare_keeps_the_light_and_spreads_a_point():
    light = np.zeros((40, 60, 3))
    light[30, 50] = 1000.0
    found = through_lens(light, (0.0, 0.0), 0.05)
    np.testing.assert_allclose(found.sum(axis=(0, 1)), 1000.0, rtol=1e-9)
    assert 950.0 <= found[30, 50, 0] < 953.0
    assert found[30, 49, 0] > found[20, 20, 0] > 0.0
    np.testing.assert_allclose(through_lens(np.ones((40, 60, 3)), (0.0, 0.0), 0.3), 1.0, rtol=1e-12)


def test_blur_has_its_width_and_keeps_the_light():
    light = np.zeros((41, 61, 1))
    light[20, 30] = 1000.0
    found = through_lens(light, (0.0, 0.0), 0.0, 1.5)[..., 0]
    x = np.arange(61.0) - 30.0
    assert found.sum() == pytest.approx(1000.0, rel=1e-4)
    assert (found.sum(axis=0) * x**2).sum() / 1000.0 == pytest.approx(1.5**2, rel=1e-3)


def test_a_colour_chart_has_its_colours_in_a_camera_with_filters_that_overlap():
    responses = load_table("responses/nikon_5100")
    bands = [Band(name, responses[name]) for name in ("red", "green", "blue")]
    matrix = colour_matrix(bands, d65())
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    power = [band.mean(d65()) for band in bands]
    wavelength = d65().wavelength_nm
    off, without = [], []
    for patch in patches().values():
        light = Spectrum(wavelength, patch.at(wavelength) * d65().value)
        seen = np.array([band.mean(light) for band in bands]) / power
        wanted = colour_of_reflectance(patch)
        off.append(np.abs(matrix @ seen - wanted).max())
        without.append(np.abs(seen - wanted).max())
    assert np.mean(off) < 0.25 * np.mean(without)


def test_saturation_and_contrast_of_a_photograph():
    light = np.array([[[900.0, 1100.0, 700.0], [3000.0, 2500.0, 3500.0]]] * 2).repeat(32, axis=0).repeat(48, axis=1)
    raw = raw_of(light, mosaic=False, read_noise_electrons=0.0, full_well_electrons=1e8)

    def colours(**keys):
        return photo_of(raw, Jpeg(white_balance="daylight", **keys)).picture[32, [10, 80]].astype(float)

    assert np.ptp(colours(saturation=0), axis=1).max() <= 1.0
    assert (np.ptp(colours(saturation=1.5), axis=1) > 1.2 * np.ptp(colours(), axis=1)).all()
    dark, bright = colours(contrast=2.0).mean(axis=1) - colours().mean(axis=1)
    assert dark < -2.0
    assert bright > 2.0


def test_red_and_blue_are_larger_about_the_middle():
    x = np.arange(101.0) - 50.0
    light = np.repeat(np.broadcast_to(x, (51, 101))[..., None], 3, axis=-1)
    found = through_lens(light, (0.02, -0.01), 0.0)
    np.testing.assert_allclose(found[25, 10:90, 0], x[10:90] / 1.02, atol=1e-9)
    np.testing.assert_array_equal(found[..., 1], light[..., 1])
    np.testing.assert_allclose(found[25, 10:90, 2], x[10:90] / 0.99, atol=1e-9)


def test_falloff_is_that_of_its_coefficients_in_the_corners():
    found = falloff((200, 100), (-0.3, 0.1, -0.05))
    assert found[50, 100] == pytest.approx(1.0, abs=1e-3)
    assert found[0, 0] == pytest.approx(0.75, abs=0.01)


def test_daylight_is_that_of_published_chromaticities():
    # CIE 15:2004: D50 at x 0.3457, y 0.3585; D65 is white.
    x, y = 0.3457, 0.3585
    d50 = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]) @ [
        x / y,
        1.0,
        (1 - x - y) / y,
    ]
    np.testing.assert_allclose(daylight_rgb(5003.0), d50 / d50[1], rtol=0.01)
    np.testing.assert_allclose(daylight_rgb(6504.0), 1.0, rtol=1e-3)


@pytest.mark.parametrize("kelvin", [4500.0, 6504.0, 9000.0])
def test_greys_give_the_temperature_of_their_light_beside_leaves(kelvin):
    light = np.empty((20, 30, 3))
    light[:10] = 0.3 * daylight_rgb(kelvin)
    light[10:] = [0.05, 0.10, 0.03]
    assert grey_temperature(light) == pytest.approx(kelvin, rel=0.01)
    assert grey_temperature(light[10:]) == 6504.0


@pytest.mark.parametrize("mosaic", [True, False])
def test_a_metered_grey_surface_becomes_the_same_middle_grey(mosaic):
    raw = raw_of(np.full((64, 96, 3), 2000.0), mosaic=mosaic, read_noise_electrons=0.0, full_well_electrons=1e6)
    np.testing.assert_allclose(linear_colours(raw).mean(axis=(0, 1)), 0.126, rtol=0.01)
    photo = photo_of(raw, Jpeg(white_balance="daylight"))
    assert abs(float(photo.picture.mean()) - 118.0) < 2.0  # sRGB of 18%
    with Image.open(io.BytesIO(photo.content)) as image:
        assert (image.size, image.format) == ((96, 64), "JPEG")
        assert [component[1:3] for component in image.layer] == [(2, 2), (1, 1), (1, 1)]  # 4:2:0
        assert float(image.getexif().get_ifd(0x8769)[33437]) == 8.0


def test_a_grey_ramp_has_its_colours_in_all_pixels_of_a_mosaic():
    ramp = np.linspace(500.0, 4000.0, 96) + np.linspace(0.0, 1000.0, 64)[:, None]
    keys = {"read_noise_electrons": 0.0, "full_well_electrons": 1e8, "bits": 16}
    one, other = (
        linear_colours(raw_of(np.repeat(ramp[..., None], 3, axis=-1), mosaic=on, **keys)) for on in (True, False)
    )
    np.testing.assert_allclose(one[2:-2, 2:-2], other[2:-2, 2:-2], atol=5e-4)


def test_noise_of_the_iso_is_in_the_picture():
    light = np.full((64, 96, 3), 50.0)
    spread = [
        float(photo_of(raw_of(light, iso=iso, base_iso=100), Jpeg()).picture.std(axis=(0, 1)).mean())
        for iso in (100, 3200)
    ]
    assert spread[1] > 3 * spread[0]


def test_clipped_highlights_are_white_whatever_the_balance():
    light = np.tile(2000.0 * daylight_rgb(4500.0), (64, 96, 1))
    light[:5, :5] = 1e6  # which the meter leaves out
    raw = raw_of(light, mosaic=False, read_noise_electrons=0.0, full_well_electrons=1e6)
    photo = photo_of(raw, Jpeg(white_balance="auto"))
    assert photo.facts["temperature_k"] == pytest.approx(4500.0, rel=0.03)
    np.testing.assert_array_equal(photo.picture[:5, :5], 255)
    np.testing.assert_allclose(photo.picture[5:].mean(axis=(0, 1)), 118.0, atol=2.0)


def test_a_photograph_is_checked_against_its_raw_image(tmp_path):
    folder, frame = tmp_path / "000000-a", FrameData(tmp_path, "000000-a")
    folder.mkdir()
    exposure = Exposure(jpeg=Jpeg(quality=80))
    raw = raw_of(np.linspace(500.0, 2000.0, 96)[:, None] * np.ones((64, 1, 3)), jpeg=exposure.jpeg)
    write_raw(folder, with_photo(folder, raw, exposure))
    assert list(light_checks.photo.findings(frame)) == []
    about = json.loads((folder / "raw.json").read_text())
    del about["photo"]["sharpening"]  # as data sets that were written before that key
    (folder / "raw.json").write_text(json.dumps(about))
    assert list(light_checks.photo.findings(frame)) == []
    with Image.open(folder / NAME) as image:
        changed = np.array(image)
    Image.fromarray(changed).save(folder / NAME, "JPEG", quality=95)  # another encoder
    assert list(light_checks.photo.findings(frame)) == []
    changed[10:20, 30:40] = 255
    Image.fromarray(changed).save(folder / NAME, "JPEG", quality=95)
    assert [one.problem for one in light_checks.photo.findings(frame)] == ["photo.jpg is not the raw image's picture"]


def test_sharpening_makes_edges_steeper_and_leaves_even_light():
    light = np.where(np.arange(96) < 48, 900.0, 1800.0)[None, :, None] * np.ones((64, 1, 3))
    raw = raw_of(light, mosaic=False, read_noise_electrons=0.0, full_well_electrons=1e8)
    plain, sharp = (
        photo_of(raw, Jpeg(white_balance="daylight", sharpening=share)).picture[32].astype(float) for share in (0, 1)
    )
    assert np.abs(sharp - plain)[[8, 24, 72, 88]].max() <= 1.0
    assert sharp[47].max() < plain[47].min() - 2.0
    assert sharp[48].min() > plain[48].max() + 2.0
