from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from PIL import Image

from forestgen.core.errors import OutputError
from forestgen.dataset import png
from forestgen.dataset.tonemap import MIDDLE_GREY, tone_map
from support.error_messages import raises_error


def test_instance_round_trip_at_the_limit(tmp_path):
    ids = np.array([[0, 1, 255, 256], [65535, 65536, 2**24 - 2, 2**24 - 1]], np.uint32)
    png.write_instance(tmp_path / "i.png", ids)
    np.testing.assert_array_equal(png.instance_of((tmp_path / "i.png").read_bytes(), (4, 2)), ids)
    with Image.open(tmp_path / "i.png") as image:
        rgb = np.asarray(image).astype(int)
    np.testing.assert_array_equal(rgb @ [1, 256, 65536], ids)  # COCO panoptic's rgb2id


def test_an_id_beyond_24_bits_fails_loudly(tmp_path):
    with raises_error(OutputError, place="i.png"):
        png.write_instance(tmp_path / "i.png", np.array([[2**24]], np.uint32))
    assert not (tmp_path / "i.png").exists()


def test_semantic_is_a_palette_image(tmp_path):
    classes = np.arange(256, dtype=np.uint8).reshape(16, 16)
    png.write_semantic(tmp_path / "s.png", classes, [str(i) for i in range(256)])
    with Image.open(tmp_path / "s.png") as image:
        assert image.mode == "P"
        np.testing.assert_array_equal(np.asarray(image), classes)
        np.testing.assert_array_equal(np.asarray(image.convert("RGB")).reshape(-1, 3), png.class_palette(256))
        assert {key: json.loads(value) for key, value in image.text.items()} == {
            "classes": {str(i): str(i) for i in range(256)}
        }


@pytest.mark.parametrize("classes", [2, 3, 4, 5, 16, 17, 256])
def test_semantic_has_8_bits_a_pixel(tmp_path, classes):
    semantic = np.random.default_rng(classes).integers(0, classes, (13, 7)).astype(np.uint8)
    png.write_semantic(tmp_path / "s.png", semantic, [f"class {i}" for i in range(classes)])
    content = (tmp_path / "s.png").read_bytes()
    assert content[12:16] == b"IHDR"
    assert struct.unpack(">IIBB", content[16:26]) == (7, 13, 8, 3)  # width, height, bits, palette
    with Image.open(tmp_path / "s.png") as image:
        np.testing.assert_array_equal(np.asarray(image), semantic)
        palette = np.array(image.getpalette()).reshape(-1, 3)
    np.testing.assert_array_equal(palette[:classes], png.class_palette(classes))
    assert not palette[classes:].any()


def test_class_colours_do_not_depend_on_their_number():
    np.testing.assert_array_equal(png.class_palette(5), png.class_palette(40)[:5])
    assert len(np.unique(png.class_palette(42), axis=0)) == 42


def test_plant_colours_are_stable_and_distinct():
    ids = np.arange(1, 401, dtype=np.uint32)
    colours = png.plant_colours(ids)
    np.testing.assert_array_equal(colours[::-1], png.plant_colours(ids[::-1]))
    assert len(np.unique(colours, axis=0)) > 390
    steps = np.abs(np.diff(colours.astype(int), axis=0)).sum(axis=1)
    assert steps.min() > 60  # neighbouring ids differ clearly


def test_overlay_tints_plants_and_leaves_the_rest():
    preview = np.full((8, 10, 3), 90, np.uint8)
    instance = np.zeros((8, 10), np.uint32)
    instance[2:7, 3:8] = 2**31 + 3
    picture = png.overlay(preview, instance)
    assert (picture[instance == 0] == 90).all()
    colour = png.plant_colours(np.array([2**31 + 3], np.uint32))[0]
    inside = picture[4, 5]
    np.testing.assert_allclose(inside, 90 * 0.58 + colour * 0.42, atol=1)
    border = (picture[2:7, 3:8] == colour).all(axis=-1)
    expected = np.ones((5, 5), bool)
    expected[1:-1, 1:-1] = False
    np.testing.assert_array_equal(border, expected)


def test_png_bytes_repeat(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    for name in "ab":
        png.write_png(tmp_path / name, picture)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert b"tIME" not in (tmp_path / "a").read_bytes()


def forest_light():
    rng = np.random.default_rng(3)
    light = np.empty((60, 80, 3), np.float32)
    light[:25] = np.array([3.0, 4.5, 7.0]) * np.linspace(0.8, 1.6, 25)[:, None, None]
    light[25:] = np.array([0.3, 0.5, 0.1]) * rng.lognormal(0, 0.8, (35, 80, 1))
    return light


def test_tone_keeps_the_sky_and_the_order_of_light():
    light = forest_light()
    picture = tone_map(light)
    assert (picture == 255).mean() < 0.02
    assert (picture[25:].max(axis=-1) < 10).mean() < 0.2
    grey = np.sort(np.repeat(light[..., :1], 3, axis=-1).reshape(1, -1, 3), axis=1)
    assert (np.diff(tone_map(grey).astype(int), axis=1) >= 0).all()


def test_tone_does_not_depend_on_the_unit_of_light():
    light = forest_light()
    step = np.abs(tone_map(light).astype(int) - tone_map(light * np.float32(1000)).astype(int))
    assert step.max() <= 1


def test_middle_grey_maps_to_itself():
    flat = tone_map(np.full((4, 4, 3), 123.0, np.float32))
    srgb = 1.055 * MIDDLE_GREY ** (1 / 2.4) - 0.055
    assert np.abs(flat / 255.0 - srgb).max() < 1.0 / 255.0


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_odd_light_gives_a_picture(value):
    light = np.full((4, 4, 3), value, np.float32)
    assert tone_map(light).shape == (4, 4, 3)
    mixed = forest_light()
    mixed[0, 0] = value
    step = np.abs(tone_map(mixed)[1:].astype(int) - tone_map(forest_light())[1:].astype(int))
    assert step.max() <= 2  # one odd pixel does not spoil the others


@pytest.mark.parametrize("light", [[1, 100], [1e-44, 1], [1e-44, 1e-44], [0, 1e30]])
def test_few_levels_of_light_give_a_picture(light):
    picture = tone_map(np.array(light, np.float32).reshape(1, 2, 1).repeat(3, axis=2))
    assert picture[0, 0].max() <= picture[0, 1].min()


def test_the_suns_disc_does_not_darken_the_picture():
    light = forest_light()
    without = tone_map(light).astype(int)
    light[2:4, 2:4] = 1e5
    assert np.abs(tone_map(light).astype(int) - without)[25:].max() <= 4
