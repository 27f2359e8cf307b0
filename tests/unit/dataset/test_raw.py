from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from dataset_shots import HEIGHT, SETTINGS, WIDTH, make_camera, make_shot
from PIL import Image

from forestgen.core.spectrum import Band, Spectrum
from forestgen.dataset import raw
from forestgen.dataset.check import light
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.raw import d65, levels, mosaiced, raw_image, vignetting, write_raw
from forestgen.dataset.writer import frame_bytes, write_frame
from forestgen.recipe.exposure import Exposure
from forestgen.recipe.spectra import load_bands
from forestgen.render.frame import Radiance, SunAtLens
from forestgen.scene.colour import colour_science


def replace(one, **changes):
    """A copy of a dataclass, or of a section of a recipe."""
    return one.model_copy(update=changes) if isinstance(one, Exposure) else dataclasses.replace(one, **changes)


PLAIN = Exposure(f_number=4.0, shutter_s=0.01, iso=100.0, mosaic=False)
SIDE = 64


def changed(exposure, **keys):
    return exposure.model_copy(update=keys)


def flat(value, size=SIDE, **kept):
    """The same light in every pixel."""
    channels = len(kept.get("channels", "RGB"))
    mean = np.broadcast_to(np.asarray(value, np.float32), (size, size, channels)).copy()
    return Radiance(mean, np.zeros_like(mean), None, 1, **kept)


def square(size=SIDE, **kept):
    return replace(make_camera(size_px=(size, size)), **kept)


def at_saturation(exposure):
    """Luminance whose exposure on the sensor is 78 / ISO lux seconds: pi L t / (4 N²)."""
    return 78.0 / exposure.iso * 4 * exposure.f_number**2 / (np.pi * exposure.shutter_s)


def bell(name, centre, width, height=1.0):
    wavelength = np.arange(centre - 3 * width, centre + 3 * width + 1, 1.0)
    return Band(name, Spectrum(wavelength, height * np.exp(-0.5 * ((wavelength - centre) / width) ** 2)))


def bands(*made):
    return {"channels": tuple(band.name for band in made), "bands": made}


CAMERA_BANDS = bands(bell("R", 600, 25, 0.6), bell("G", 530, 35), bell("B", 465, 25, 0.8))
NIKON = bands(*load_bands("nikon_5100"))
DRONE = bands(bell("green", 560, 8), bell("red", 650, 8), bell("edge", 730, 5), bell("nir", 840, 13))


def linear(made, camera):
    """(H, W) by channel: radiance by the numbers of raw.json, NaN where a mosaic has another colour."""
    facts, shade = made.facts, vignetting(camera, made.facts["vignetting"])
    found = {}
    for index, name in enumerate(facts["channels"]):
        if facts["mosaic"] is None:
            numbers = made.planes[facts["files"][name]].astype(float)
        else:
            own = np.zeros((*shade.shape, 3))
            own[..., index] = 1
            numbers = np.where(mosaiced(own) > 0, made.planes["raw.png"], np.nan)
        found[name] = (numbers - facts["black_level"]) * facts["radiance_per_dn"][name] / shade
    return found


@pytest.mark.parametrize("mosaic", [True, False])
@pytest.mark.parametrize("vignette", [0.0, 1.0])
@pytest.mark.parametrize(
    ("value", "about"),
    [((900.0, 300.0, 60.0), {}), ((1e-1, 2e-1, 5e-2), NIKON), ((0.1, 0.05, 0.2, 0.3), DRONE)],
)
def test_the_mean_leads_back_to_the_radiance(value, about, vignette, mosaic):
    camera = square(256)
    exposure = changed(PLAIN, shutter_s=None, mosaic=mosaic, vignetting=vignette, compensation_ev=-1.0)
    made = raw_image(flat(value, 256, **about), camera, exposure, 3)
    assert (made.facts["mosaic"] is not None) == (mosaic and len(value) == 3)
    for name, truth in zip(made.facts["channels"], value, strict=True):
        back = linear(made, camera)[name]
        back = back[np.isfinite(back)]
        error = back.std() / np.sqrt(back.size)
        assert abs(back.mean() - truth) < 5 * error
        assert error < 0.003 * truth  # so the test can tell


def test_photon_transfer_curve():
    """Variance over mean has the slope 1 / gain, and begins at the read noise."""
    exposure = changed(PLAIN, bits=16, read_noise_electrons=5.0, iso=400.0)
    black, _, gain = levels(exposure)
    assert gain == pytest.approx(30_000 / 4 / (65_535 - black))
    mean, variance, count = [], [], 3 * SIDE**2
    for share in (0.0, 0.02, 0.1, 0.3, 0.6, 0.9):
        made = raw_image(flat(share * at_saturation(exposure)), square(), exposure, int(1000 * share))
        numbers = np.stack(list(made.planes.values())).astype(float) - black
        mean.append(numbers.mean())
        variance.append(numbers.var(ddof=1))
    expected = np.array(mean) / gain + (5.0 / gain) ** 2 + 1 / 12
    error = np.array(variance) * np.sqrt(2 / (count - 1))
    assert np.abs((np.array(variance) - expected) / error).max() < 4.5
    slope = np.polyfit(mean, variance, 1, w=1 / error)[0]
    assert slope == pytest.approx(1 / gain, rel=0.03)


@pytest.mark.parametrize("iso", [100.0, 200.0, 6400.0])
def test_saturation_is_at_78_by_iso(iso):
    """ISO 12232; and it fills the well at the base iso, half of it at twice that."""
    exposure = changed(PLAIN, iso=iso, read_noise_electrons=0.0)
    black, white, gain = levels(exposure)
    assert gain * (white - black) == pytest.approx(30_000 * 100 / iso)
    below = raw_image(flat(0.8 * at_saturation(exposure)), square(), exposure, 0).planes["raw-R.png"]
    above = raw_image(flat(1.4 * at_saturation(exposure)), square(), exposure, 0).planes["raw-R.png"]
    assert (below.astype(float) - black).mean() == pytest.approx(0.8 * (white - black), rel=0.01)
    assert above.min() == white


def test_the_sun_is_white_and_the_dark_is_black():
    light = flat(1.0)
    light.mean[0, 0] = 1.6e9
    light.mean[0, 1] = np.inf
    light.mean[1] = -3.0
    exposure = changed(PLAIN, read_noise_electrons=2.0)
    black, white, gain = levels(exposure)
    numbers = raw_image(light, square(), exposure, 0).planes["raw-G.png"].astype(float)
    assert (numbers[0, :2] == white).all()
    assert abs(numbers[1].mean() - black) < 5 * np.sqrt((2 / gain) ** 2 + 1 / 12) / np.sqrt(SIDE)


def test_sunny_sixteen():
    """At f/16 and 1/ISO s, a grey card in full sun (80 to 110 klx) is within a stop of the metered 10 / ISO lux s."""
    for illuminance in (80e3, 110e3):
        luminance = 0.18 * illuminance / np.pi
        for iso in (100.0, 400.0):
            noiseless = {"mosaic": False, "read_noise_electrons": 0.0}
            exposure = Exposure(f_number=16.0, shutter_s=1 / iso, iso=iso, base_iso=iso, **noiseless)
            made = raw_image(flat(luminance), square(), exposure, 0)
            black, white, _ = levels(exposure)
            share = (made.planes["raw-G.png"].astype(float).mean() - black) / (white - black)
            assert abs(np.log2(share / (10 / 78))) < 1
    # The rule is EV 15, rounded.
    assert Exposure(ev=15.0, f_number=16.0, iso=100.0).shutter_for_s(0.0) == pytest.approx(1 / 128)
    assert Exposure(ev=15.0, f_number=16.0, iso=400.0).shutter_for_s(0.0) == pytest.approx(1 / 512)


@pytest.mark.parametrize("compensation", [0.0, 1.0])
@pytest.mark.parametrize("about", [{}, CAMERA_BANDS, NIKON, DRONE])
def test_a_metered_picture_is_at_an_eighth_of_saturation(compensation, about):
    """H = (pi/4) 12.5 / ISO of 78 / ISO, whatever the aperture and the light; the sun's disc does not count."""
    white = [band.mean(d65()) for band in about.get("bands", ())] or [1.0] * 3
    light = flat(np.array(white) * 4321.0, 256, **about)
    light.mean[10:15, 20:25] *= 1e5
    for f_number, iso in ((2.8, 100.0), (11.0, 800.0)):
        exposure = Exposure(f_number=f_number, iso=iso, mosaic=False, compensation_ev=compensation)
        made = raw_image(light, square(256), exposure, 1)
        level = (made.facts["white_level"] - made.facts["black_level"]) * np.pi / 4 * 12.5 / 78 * 2**compensation
        for name, factor in made.facts["white_balance"].items():
            numbers = np.median(made.planes[f"raw-{name}.png"].astype(float)) - made.facts["black_level"]
            assert numbers * factor == pytest.approx(level, rel=0.01)


def test_a_camera_sees_white_in_its_own_colours():
    """Electrons are in proportion to the integral of response times light; the strongest is the luminance's."""
    exposure = changed(PLAIN, read_noise_electrons=0.0)
    level = 0.5 * at_saturation(exposure)
    own = CAMERA_BANDS["bands"]
    light = flat([band.mean(d65()) * level for band in own], 256, **CAMERA_BANDS)
    made = raw_image(light, square(256), exposure, 0)
    share = (
        np.array([made.planes[f"raw-{name}.png"].astype(float).mean() for name in "RGB"]) - made.facts["black_level"]
    )
    share /= made.facts["white_level"] - made.facts["black_level"]
    integral = []
    for band in own:
        fine = np.linspace(350, 750, 40001)
        inside = np.interp(fine, band.response.wavelength_nm, band.response.value, left=0, right=0)
        integral.append(np.trapezoid(inside * d65().at(fine), fine))
    np.testing.assert_allclose(share, 0.5 * np.array(integral) / max(integral), rtol=2e-3)


def test_d65_is_of_one_candela_and_of_its_colour():
    colour = colour_science()

    sd = colour.SpectralDistribution(dict(zip(d65().wavelength_nm, d65().value, strict=True)))
    with colour.utilities.suppress_warnings(colour_usage_warnings=True):
        xyz = colour.sd_to_XYZ(sd.align(colour.SPECTRAL_SHAPE_DEFAULT), method="Integration", k=683.002)
    assert xyz[1] == pytest.approx(1.0, rel=2e-3)
    np.testing.assert_allclose(colour.XYZ_to_xy(xyz), (0.3127, 0.3290), atol=2e-4)
    assert (np.diff(d65().value[d65().wavelength_nm > 790]) < 0).all()  # near infrared falls, as daylight's does


@pytest.mark.parametrize("strength", [1.0, 0.4])
def test_vignetting_by_the_pixels_angle(strength):
    camera = make_camera()
    focal = WIDTH / 2 / np.tan(np.radians(camera.hfov_deg) / 2)
    found = vignetting(camera, strength)
    assert found.shape == (HEIGHT, WIDTH)
    for y, x in ((0, 0), (19, 30), (39, 59), (7, 44)):
        angle = np.arctan(np.hypot(x + 0.5 - WIDTH / 2, y + 0.5 - HEIGHT / 2) / focal)
        assert found[y, x] == pytest.approx(1 - strength * (1 - np.cos(angle) ** 4), rel=1e-12)
    assert (vignetting(replace(camera, projection="fisheye"), strength) == 1).all()


def test_the_mosaic_is_rggb():
    colours = np.broadcast_to([1.0, 2.0, 3.0], (5, 6, 3))
    assert mosaiced(colours)[:3, :3].tolist() == [[1, 2, 1], [2, 3, 2], [1, 2, 1]]


def test_noise_belongs_to_the_image_and_the_camera():
    light = flat(500.0)
    first = raw_image(light, square(), PLAIN, 7)
    for other, same in (
        (raw_image(light, square(), PLAIN, 7), True),
        (raw_image(light, square(), PLAIN, 8), False),
        (raw_image(light, square(name="b"), PLAIN, 7), False),
    ):
        assert np.array_equal(first.planes["raw-R.png"], other.planes["raw-R.png"]) == same


def test_the_denoised_light_is_taken_where_there_is_one():
    light = flat(100.0)
    assert raw_image(light, square(), PLAIN, 0).facts["of"] == "radiance"
    clean = replace(light, denoised=light.mean * 2)
    made = raw_image(clean, square(), PLAIN, 0)
    assert made.facts["of"] == "radiance.denoised"
    assert linear(made, square())["G"].mean() == pytest.approx(200.0, rel=0.01)


def test_files_are_of_sixteen_bits(tmp_path):
    made = raw_image(flat(500.0), square(), changed(PLAIN, mosaic=True, bits=16), 0)
    write_raw(tmp_path, made)
    with Image.open(tmp_path / "raw.png") as image:
        assert image.mode == "I;16"
        np.testing.assert_array_equal(np.asarray(image), made.planes["raw.png"])
    assert json.loads((tmp_path / "raw.json").read_text()) == json.loads(json.dumps(made.facts))


def photographed(folder, exposure, about=None, sun=None, **kept):
    """A frame's folder with a raw image, as the check reads it."""
    shot = make_shot(range(1, 9), **kept)
    camera = replace(shot.frame.camera, exposure=exposure)
    radiance = replace(shot.frame.radiance, sun=sun)
    if about is not None:
        values = {"mean": radiance.mean, "variance": radiance.variance, "denoised": radiance.denoised}
        wide = {key: np.repeat(value, 2, axis=-1)[..., : len(about["bands"])] for key, value in values.items()}
        radiance = replace(radiance, **wide, **about)
    frame = replace(shot.frame, camera=camera, radiance=radiance)
    write_frame(folder / "000000-a", replace(shot.labelled, frame=frame), "", {"image_seed": "5"}, SETTINGS)
    return FrameData(folder, "000000-a")


EXPOSED = changed(PLAIN, shutter_s=None, vignetting=0.7)


@pytest.mark.parametrize("denoised", [True, False])
@pytest.mark.parametrize("exposure", [EXPOSED, changed(EXPOSED, mosaic=True), changed(EXPOSED, iso=25_600.0, bits=8)])
def test_what_is_written_passes_the_check(tmp_path, exposure, denoised):
    frame = photographed(tmp_path, exposure, denoised=denoised)
    assert light.raw.applies(frame)
    assert list(light.raw.findings(frame)) == []
    assert list(light.header.findings(frame)) == []


@pytest.mark.parametrize("about", [DRONE, {"channels": ("G", "R", "B"), "bands": CAMERA_BANDS["bands"]}])
def test_bands_pass_the_check(tmp_path, about):
    frame = photographed(tmp_path, EXPOSED, about)
    assert len(list((frame.root / frame.name).glob("raw-*.png"))) == len(about["bands"])
    assert list(light.raw.findings(frame)) == []
    assert list(light.header.findings(frame)) == []


def test_an_image_with_ghosts_of_the_sun_passes_the_check(tmp_path):
    sun = SunAtLens((0.1, -0.2, 0.9), (9e5, 8e5, 7e5))
    frame = photographed(tmp_path, changed(EXPOSED, ghosts="coated"), sun=sun)
    assert list(light.raw.findings(frame)) == []
    facts = json.loads((frame.root / frame.name / "raw.json").read_text())
    facts["ghosts"] = None
    (frame.root / frame.name / "raw.json").write_text(json.dumps(facts))
    assert list(light.raw.findings(frame)) != []


def test_the_estimate_of_disk_space_holds(tmp_path):
    frame = photographed(tmp_path, EXPOSED, DRONE)
    size = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert size < frame_bytes(frame.size_px, 8, SETTINGS.formats, channels=4) - (1 << 17)


def test_rows_at_a_time_change_nothing(monkeypatch):
    light = flat(300.0)
    light.mean[::3] *= 2
    exposure = changed(PLAIN, shutter_s=None, vignetting=1.0, mosaic=True)
    first = raw_image(light, square(), exposure, 7)
    monkeypatch.setattr(raw, "_ROWS", 10)
    again = raw_image(light, square(), exposure, 7)
    np.testing.assert_array_equal(first.planes["raw.png"], again.planes["raw.png"])


def test_another_view_than_the_headers(tmp_path):
    frame = photographed(tmp_path, EXPOSED)
    with Image.open(frame.root / frame.name / "preview.png") as image:
        image.load()
        Image.fromarray(np.asarray(image)).save(frame.root / frame.name / "preview.png")
    assert [finding.problem for finding in light.header.findings(frame)] == ["the view is not frame.exr's"]


def damaged(frame, what):
    path = frame.root / frame.name / "raw.png"
    with Image.open(path) as image:
        numbers = np.array(image)
    facts = json.loads((frame.root / frame.name / "raw.json").read_text())
    if what == "a pixel":
        numbers[3, 5] += 6000
    elif what == "shifted":
        numbers = np.roll(numbers, 1, axis=1)
    elif what == "cropped":
        numbers = numbers[:-1]
    elif what == "beyond white":
        numbers[1, 2] = 40_000
    elif what == "brighter by 2%":
        facts["radiance_per_dn"] = {name: value * 1.02 for name, value in facts["radiance_per_dn"].items()}
    else:
        facts["white_level"] = facts["black_level"]
    Image.fromarray(numbers).save(path)
    (frame.root / frame.name / "raw.json").write_text(json.dumps(facts))


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("a pixel", "not the radiance's"),
        ("shifted", "not the radiance's"),
        ("cropped", "another size"),
        ("beyond white", "brighter than white_level"),
        ("brighter by 2%", "mean is not"),
        ("levels", "contradict"),
    ],
)
def test_the_check_finds_what_is_wrong(tmp_path, what, words):
    frame = photographed(tmp_path, changed(EXPOSED, mosaic=True))
    damaged(frame, what)
    found = [finding.problem for finding in light.raw.findings(frame)]
    assert any(words in problem for problem in found), found
