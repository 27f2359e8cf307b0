from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from dataset_shots import SETTINGS, make_shot
from numpy.typing import NDArray
from PIL import Image

from forestgen.core.spectrum import Band, Spectrum
from forestgen.dataset.exr import read_exr_attributes
from forestgen.dataset.tonemap import MIDDLE_GREY, _dim, preview_of, tone_map
from forestgen.dataset.writer import write_frame
from forestgen.recipe.dataset import Dataset, View
from forestgen.render.frame import Radiance
from forestgen.scene.colour import colour_science

VIEWS = get_args(View)
GREYS = np.geomspace(1e-4, 0.999, 400).astype(np.float32)


def greys(values=GREYS):
    return np.repeat(np.asarray(values, np.float32)[None, :, None], 3, axis=-1)


def srgb(linear):
    """IEC 61966-2-1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_of_srgb(code):
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def acescct(linear):
    """Academy S-2016-001, section 4.4."""
    return np.where(
        linear <= 0.0078125, 10.5402377416545 * linear + 0.0729055341958355, (np.log2(linear) + 9.72) / 17.52
    )


@pytest.mark.parametrize(("view", "formula"), [("srgb", srgb), ("acescct", acescct)])
def test_encodings_are_the_published_ones(view, formula):
    picture = tone_map(greys(), exposure=1.0, view=view)
    assert np.abs(picture - formula(GREYS.astype(float))[None, :, None] * 255).max() < 0.51 + (view == "srgb") * 0.5


def test_the_srgb_table_is_colour_sciences():
    colour = colour_science()

    grid = (np.arange(4096) / 4095) ** 2
    encoded = colour.cctf_encoding(grid, function="sRGB")
    found = tone_map(greys(grid), exposure=1.0, view="srgb")[0, :, 0]
    np.testing.assert_array_equal(found, np.floor(encoded * 255 + 0.5))


def test_acescct_knows_its_primaries():
    """The red of Rec. 709 in AP1, adapted from D65 to ACES' white by Bradford: TB-2014-004's primaries."""

    def to_xyz(primaries, white):
        columns = np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in primaries]).T
        x, y = white
        return columns * np.linalg.solve(columns, [x / y, 1.0, (1 - x - y) / y])

    rec709 = to_xyz([(0.64, 0.33), (0.3, 0.6), (0.15, 0.06)], (0.3127, 0.3290))
    ap1 = to_xyz([(0.713, 0.293), (0.165, 0.830), (0.128, 0.044)], (0.32168, 0.33767))
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    scale = (bradford @ ap1.sum(axis=1)) / (bradford @ rec709.sum(axis=1))
    adapt = np.linalg.inv(bradford) @ np.diag(scale) @ bradford
    for colour in np.eye(3):
        expected = acescct(np.linalg.inv(ap1) @ adapt @ rec709 @ colour) * 255
        found = tone_map(np.broadcast_to(colour, (1, 1, 3)).astype(np.float32), exposure=1.0, view="acescct")
        assert np.abs(found[0, 0] - expected).max() < 0.6


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, 1e30])
def test_every_view_stands_odd_light(view, value):
    light = greys(GREYS * 5000)
    light[0, 7] = value
    picture = tone_map(light, view=view).astype(int)
    assert (np.diff(np.delete(picture, 7, axis=1), axis=1) >= 0).all()
    assert picture[0, 7, 0] == (255 if value > 1e4 else tone_map(np.zeros((1, 1, 3), np.float32), view=view)[0, 0, 0])


@pytest.mark.parametrize("view", VIEWS)
def test_middle_grey_is_each_views_own(view):
    """In cd/m² too: the picture meters itself."""
    expected = {"filmic": srgb(np.array(MIDDLE_GREY)), "srgb": srgb(np.array(MIDDLE_GREY)), "acescct": 0.4135884}[view]
    assert np.abs(tone_map(np.full((4, 4, 3), 5700.0, np.float32), view=view) / 255 - expected).max() < 0.6 / 255


def test_srgb_pictures_lead_back_to_the_light():
    rng = np.random.default_rng(1)
    light = rng.lognormal(7, 0.7, (40, 50, 3)).astype(np.float32)
    made = preview_of(Radiance(light, light, None, 4), "srgb")
    back = linear_of_srgb(made.picture / 255) / float(made.texts["exposure"])
    half = linear_of_srgb((made.picture + 0.5) / 255) / float(made.texts["exposure"]) - back
    seen = made.picture < 255
    assert 0.8 < seen.mean() < 1.0
    assert (np.abs(back - light)[seen] <= 1.6 * half[seen] + 1e-4 * light[seen]).all()


def test_the_view_is_told_in_all_files(tmp_path):
    shot = make_shot(range(1, 9))
    write_frame(tmp_path, shot.labelled, "", {}, replace(SETTINGS, view="srgb"))
    with Image.open(tmp_path / "preview.png") as image:
        assert image.info["view"] == "srgb"
        assert image.info["colours"] == "linear Rec. 709"
        np.testing.assert_array_equal(np.asarray(image), preview_of(shot.frame.radiance, "srgb").picture)
    assert read_exr_attributes(tmp_path / "frame.exr")["forestgen/view"] == "srgb"
    with pytest.raises(ValueError, match="'filmic', 'srgb' or 'acescct'"):
        Dataset(view="agx")


def band(name, centre, width=15.0):
    wavelength = np.arange(centre - 2 * width, centre + 2 * width + 1)
    return Band(name, Spectrum(wavelength, np.exp(-0.5 * ((wavelength - centre) / width) ** 2)))


SENTINEL = [
    *(band("B01", 443), band("B02", 492), band("B03", 560), band("B04", 665), band("B05", 704), band("B06", 740)),
    *(band("B07", 783), band("B08", 833), band("B8A", 865), band("B11", 1610), band("B12", 2190)),
]


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (SENTINEL, "true colour: B04, B03, B02 as red, green, blue"),
        ([band("G", 530, 35), band("B", 465, 25), band("R", 600, 25)], "true colour: R, G, B as red, green, blue"),
        ([band("g", 560), band("r", 650), band("edge", 730), band("nir", 840)], "false colour infrared: nir, r, g as"),
        ([band("a", 900), band("b", 1600), band("c", 1200)], "false colour: b, c, a as"),
        ([band("pan", 560), band("nir", 840)], "grey: pan, pan, pan as"),
        ([band("nir", 840)], "grey: nir, nir, nir as"),
    ],
)
def test_bands_become_pictures(made, expected):
    rng = np.random.default_rng(2)
    light = rng.lognormal(0, 1, (6, 5, len(made))).astype(np.float32)
    names = [one.name for one in made]
    radiance = Radiance(light, light, None, 4, tuple(names), tuple(made))
    preview = preview_of(radiance)
    assert preview.texts["colours"].startswith(expected)
    shown = [names.index(name) for name in expected.partition(": ")[2].partition(" as")[0].split(", ")]
    np.testing.assert_array_equal(preview.picture, tone_map(light[..., shown]))


def lit(key: float, spread: float = 0.5) -> NDArray[np.float32]:
    return np.random.default_rng(1).lognormal(np.log(key), spread, (32, 32, 1)).astype(np.float32).repeat(3, axis=2)


def test_pictures_of_the_night_are_darker_than_those_of_the_day() -> None:
    assert [_dim(key) for key in (1e-4, 0.5, 1.0, 10.0)] == pytest.approx([0.3, 0.3, 0.43, 1.0], abs=0.005)
    pictures = [
        preview_of(Radiance(light, light, None, 4)).picture for light in map(lit, (1e-4, 0.005, 0.5, 10.0, 5e3))
    ]
    means = [float(picture.mean()) for picture in pictures]
    assert 40.0 < means[2] < 0.7 * means[3]
    assert means[0] == pytest.approx(means[1], abs=4.0)  # readable
    assert means[3] == pytest.approx(means[4], abs=2.0)
    blue = [float(picture[..., 2].mean() / picture[..., 0].mean()) for picture in pictures]
    assert blue == sorted(blue, reverse=True)
    assert blue[0] > 1.3
    assert blue[-1] == pytest.approx(1.0, abs=0.01)


def test_highlights_are_held_by_a_stop_at_most() -> None:
    for spread, stops in ((0.3, 0.0), (3.0, 1.0)):
        light = lit(5000.0, spread)
        low, high = np.percentile(light, [5.0, 95.0])
        key = np.exp(np.log(light.clip(low, high)).mean())
        found = float(preview_of(Radiance(light, light, None, 4)).texts["exposure"])
        assert found == pytest.approx(MIDDLE_GREY / key * 2.0**-stops, rel=1e-3)


def test_bright_colours_become_pale_and_keep_their_hue() -> None:
    """By the hexagon's hue in ProPhoto RGB, as colour-science has it."""
    colour = colour_science()
    leaf = np.array([0.63, 1.0, 0.05], np.float32)
    light = (np.geomspace(0.02, 2.0, 30)[None, :, None] * leaf).astype(np.float32)
    shown = linear_of_srgb(tone_map(light, exposure=1.0) / 255)
    hue, saturation, _ = colour.RGB_to_HSV(colour.RGB_to_RGB(shown, "ITU-R BT.709", "ProPhoto RGB", "Bradford"))[0].T
    bright = shown[0].max(axis=1) > 0.1
    assert np.ptp(hue[bright]) < 0.02
    assert (np.diff(saturation[bright]) < 0.005).all()
    assert saturation[-1] < 0.7 * saturation[bright][0]


def test_bright_browns_turn_pale_not_pink() -> None:
    """Dry leaves of beech (linear Rec. 709, under D65) keep their hue as of OKLab; brighter ones turn to yellow."""
    colour = colour_science()
    leaf = np.array([0.225, 0.145, 0.080])
    light = (0.18 / (leaf @ [0.2126, 0.7152, 0.0722]) * leaf * 2.0 ** np.arange(5)[:, None])[None].astype(np.float32)
    shown = linear_of_srgb(tone_map(light, exposure=1.0) / 255)
    a, b = colour.XYZ_to_Oklab(colour.RGB_to_XYZ(np.append(shown[0], [leaf], axis=0), "ITU-R BT.709"))[:, 1:].T
    hue = np.degrees(np.arctan2(b, a))
    assert np.abs(hue[:4] - hue[-1]).max() < 3.0
    assert hue[4] > hue[-1]
