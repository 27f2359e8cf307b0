"""Every format that a density may come in, written by a library and read again."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from forestgen.core.cache import BoundedCache
from forestgen.core.errors import AssetError, ResourceError
from forestgen.core.raster import kind_of, read_raster
from forestgen.core.spectrum import LUMINANCE
from support.error_messages import raises_error

RNG = np.random.default_rng(5)
GREY8 = RNG.integers(0, 256, (7, 5), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (7, 5), dtype=np.uint16)
RGB = RNG.integers(0, 256, (7, 5, 3), dtype=np.uint8)
OPACITY = RNG.integers(0, 256, (7, 5), dtype=np.uint8)
REAL = RNG.random((7, 5)).astype(np.float32) * 900
MIXED = RGB.astype(np.float64) @ LUMINANCE / 255


def plain(path):
    picture = read_raster(path)
    assert not picture.values.flags.writeable
    return picture.values.astype(np.float64) / picture.white


def exr(path, channels, **header):
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, channels).write(
        str(path)
    )
    return path


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.dat"])
@pytest.mark.parametrize(("stored", "white"), [(GREY8, 255), (GREY16, 65535)])
def test_grey_keeps_its_full_depth(tmp_path, name, stored, white):
    path = tmp_path / name
    Image.fromarray(stored).save(path, format="TIFF" if name == "a.tif" else "PNG")  # no matter how it is named
    assert kind_of(path) == ("tif" if name == "a.tif" else "png")
    assert np.array_equal(read_raster(path).values, stored)
    assert read_raster(path).white == white


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate"])
@pytest.mark.parametrize(("stored", "white"), [
    (np.array([[0, 7, 2**31 - 1]], np.int32), 2**31 - 1),
    (REAL, 1),
])  # fmt: skip
def test_wide_tiffs(tmp_path, stored, white, compression):
    path = tmp_path / "a.tif"
    Image.fromarray(stored).save(path, compression=compression)
    assert np.array_equal(read_raster(path).values, stored)
    assert read_raster(path).white == white


def tiff(path, stored, sample_format, photometric=1):
    """A little-endian TIFF of one strip, as Pillow does not write it."""
    bits = stored.dtype.itemsize * 8
    tags = [
        (256, 3, stored.shape[1]), (257, 3, stored.shape[0]), (258, 3, bits), (259, 3, 1), (262, 3, photometric),
        (273, 4, 8), (277, 3, 1), (278, 3, stored.shape[0]), (279, 4, stored.nbytes), (339, 3, sample_format),
    ]  # fmt: skip
    entries = b"".join(struct.pack("<HHII", number, kind, 1, value) for number, kind, value in tags)
    data = stored.tobytes()
    directory = struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0)
    path.write_bytes(struct.pack("<2sHI", b"II", 42, 8 + len(data)) + data + directory)
    return path


@pytest.mark.parametrize(("stored", "sample_format", "white"), [
    (np.array([[0, 1, 2**31, 2**32 - 1]], np.uint32), 1, 2**32 - 1),
    (np.array([[0, 1, 2**15, 2**16 - 1]], np.uint16), 1, 2**16 - 1),
    (np.array([[0, 5, 2**15 - 1]], np.int16), 2, 2**15 - 1),
    (np.array([[-3, 5, 2**15 - 1]], np.int16), 2, 2**15 - 1),
    (np.array([[-3, 5, 2**31 - 1]], np.int32), 2, 2**31 - 1),
    (np.array([[0, 0.25, 1e3]], np.float32), 3, 1),
])  # fmt: skip
def test_signed_and_unsigned_tiffs(tmp_path, stored, sample_format, white):
    picture = read_raster(tiff(tmp_path / "a.tif", stored, sample_format))
    assert np.array_equal(picture.values.astype(np.float64), stored.astype(np.float64))
    assert picture.white == white


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_tiff_whose_white_is_0_is_turned_round(tmp_path, kind):
    most = np.iinfo(kind).max
    stored = np.array([[0, 1, most]], kind)
    assert plain(tiff(tmp_path / "a.tif", stored, 1, photometric=0)).tolist() == [[1.0, (most - 1) / most, 0.0]]


def test_black_and_white(tmp_path):
    Image.fromarray(GREY8 > 99).save(tmp_path / "a.png")
    assert np.array_equal(plain(tmp_path / "a.png"), GREY8 > 99)


def test_colour_is_its_luminance(tmp_path):
    for name in ("a.png", "a.tif"):
        Image.fromarray(RGB).save(tmp_path / name)
        assert plain(tmp_path / name) == pytest.approx(MIXED, abs=1e-7)
    grey = np.repeat(GREY8[..., None], 3, axis=2)
    Image.fromarray(grey).save(tmp_path / "b.png")
    assert plain(tmp_path / "b.png") == pytest.approx(GREY8 / 255, abs=1e-7)


def test_a_palette_is_its_colours(tmp_path):
    image = Image.fromarray((GREY8 % 4).astype(np.uint8))
    colours = np.array([[0, 0, 0], [255, 0, 0], [9, 99, 200], [255, 255, 255]], np.uint8)
    image.putpalette(colours.tobytes())
    image.save(tmp_path / "a.png")
    assert plain(tmp_path / "a.png") == pytest.approx((colours @ LUMINANCE / 255)[GREY8 % 4], abs=1e-7)
    image.save(tmp_path / "b.png", transparency=3)
    assert plain(tmp_path / "b.png")[GREY8 % 4 == 3].tolist() == [0.0] * int((GREY8 % 4 == 3).sum())


def test_what_is_transparent_is_black_by_its_degree(tmp_path):
    Image.fromarray(np.dstack([RGB, OPACITY])).save(tmp_path / "a.png")
    assert plain(tmp_path / "a.png") == pytest.approx(MIXED * OPACITY / 255, abs=1e-7)
    Image.fromarray(np.dstack([GREY8, OPACITY])).save(tmp_path / "b.png")
    assert plain(tmp_path / "b.png") == pytest.approx(GREY8 / 255 * OPACITY / 255, abs=1e-7)
    for stored in (GREY8, GREY16):
        Image.fromarray(stored).save(tmp_path / "c.png", transparency=int(stored[2, 3]))
        expected = np.where(stored == stored[2, 3], 0, stored / np.iinfo(stored.dtype).max)
        assert plain(tmp_path / "c.png") == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("name", ["Y", "Z", "density"])
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_an_exr_of_one_channel_keeps_its_values(tmp_path, name, kind):
    stored = REAL.astype(kind)
    path = exr(tmp_path / "a.exr", {name: stored})
    assert kind_of(path) == "exr"
    assert np.array_equal(plain(path), stored)


def test_an_exr_of_several_channels(tmp_path):
    colours = {name: REAL * factor for name, factor in zip("RGB", (1, 2, 3), strict=True)}
    mixed = REAL * (np.arange(1, 4) @ LUMINANCE)
    assert plain(exr(tmp_path / "a.exr", {**colours, "A": REAL})) == pytest.approx(mixed, rel=1e-6)
    assert np.array_equal(plain(exr(tmp_path / "b.exr", {**colours, "Y": REAL})), REAL)


@pytest.mark.parametrize("stored", [
    np.eye(3), np.eye(3, dtype=bool), np.eye(3, dtype=np.int64) * 900, REAL, REAL.astype(">f8"), REAL.astype("f2"),
    np.asfortranarray(REAL), GREY16,
], ids=lambda one: one.dtype.str)  # fmt: skip
def test_an_array_keeps_its_values(tmp_path, stored):
    np.save(tmp_path / "a.npy", stored)
    assert np.array_equal(plain(tmp_path / "a.npy"), stored)


def png_header(width, height):
    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    size = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(b"\0")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("width", "height"), [
    (16_385, 3), (3, 16_385), (10_001, 10_000),
    (30_000, 30_000), (2**31 - 1, 2**31 - 1)
])  # fmt: skip
def test_a_picture_is_refused_by_its_size_before_its_pixels_are_read(tmp_path, width, height):
    (tmp_path / "a.png").write_bytes(png_header(width, height))
    with raises_error(AssetError):
        read_raster(tmp_path / "a.png")


def test_an_array_is_refused_by_its_size_before_its_values_are_read(tmp_path):
    np.save(tmp_path / "a.npy", REAL)
    content = (tmp_path / "a.npy").read_bytes().replace(b"(7, 5), }    ", b"(70000, 5), }")
    (tmp_path / "a.npy").write_bytes(content)
    with raises_error(AssetError):
        read_raster(tmp_path / "a.npy")


def test_little_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("forestgen.core.processes.free_bytes", lambda: 100)
    for path in (tmp_path / "a.png", tmp_path / "a.tif"):
        Image.fromarray(GREY8).save(path)
        with raises_error(ResourceError):
            read_raster(path)


def bad_files(folder):
    """Names of bad files."""
    Image.fromarray(GREY8).save(folder / "jpeg.png", format="JPEG")
    second = [Image.fromarray(GREY8[::-1])]
    Image.fromarray(GREY8).save(folder / "frames.png", save_all=True, append_images=second)
    Image.fromarray(GREY8).save(folder / "pages.tif", save_all=True, append_images=second)
    Image.fromarray(np.zeros((3, 4, 4), np.uint8), "CMYK").save(folder / "ink.tif")
    (folder / "text.png").write_text("hello")
    (folder / "nothing.png").touch()
    exr(folder / "two.exr", {"U": REAL, "V": REAL})
    exr(folder / "whole.exr", {"Y": GREY8.astype(np.uint32)})
    header = {"type": OpenEXR.scanlineimage}
    parts = [OpenEXR.Part(dict(header), {"Y": REAL}, name) for name in "ab"]
    OpenEXR.File(parts).write(str(folder / "parts.exr"))
    np.save(folder / "objects.npy", np.array([[1, None]], object))
    np.save(folder / "complex.npy", np.ones((2, 2), complex))
    np.save(folder / "cube.npy", np.ones((2, 2, 2)))
    np.save(folder / "texts.npy", np.array([["a"]]))
    np.save(folder / "hollow.npy", np.ones((0, 3)))
    return sorted(path.name for path in folder.iterdir())


def test_what_is_no_picture_of_one_number_a_pixel(tmp_path):
    for name in bad_files(tmp_path):
        with raises_error(AssetError) as caught:
            read_raster(tmp_path / name)
        assert caught.value.expected


def test_a_file_cut_off_anywhere(tmp_path):
    stored = RNG.integers(0, 65536, (40, 30), dtype=np.uint16)
    Image.fromarray(stored).save(tmp_path / "a.png")
    Image.fromarray(stored).save(tmp_path / "a.tif", compression="tiff_lzw")
    exr(tmp_path / "a.exr", {"Y": stored.astype(np.float32)})
    np.save(tmp_path / "a.npy", stored)
    for name in ("a.png", "a.tif", "a.exr", "a.npy"):
        whole = (tmp_path / name).read_bytes()
        for share in (0.02, 0.1, 0.5, 0.9):
            (tmp_path / f"cut-{name}").write_bytes(whole[: int(len(whole) * share)])
            with pytest.raises(AssetError):
                read_raster(tmp_path / f"cut-{name}")


def test_noise_in_a_file_is_a_message_or_another_picture(tmp_path):
    """Nothing else than an `AssetError` comes out of a damaged file."""
    Image.fromarray(GREY16).save(tmp_path / "a.png")
    Image.fromarray(GREY16).save(tmp_path / "a.tif")
    np.save(tmp_path / "a.npy", GREY16)
    exr(tmp_path / "a.exr", {"Y": REAL})
    refused = 0
    for name in ("a.png", "a.tif", "a.npy", "a.exr"):
        whole = (tmp_path / name).read_bytes()
        for _ in range(60):
            noisy = bytearray(whole)
            for at in RNG.integers(8, len(whole), 4):
                noisy[at] = RNG.integers(256)
            (tmp_path / f"noisy-{name}").write_bytes(noisy)
            try:
                assert read_raster(tmp_path / f"noisy-{name}").values.ndim == 2
            except AssetError:
                refused += 1
    assert refused > 60


def test_a_cache_keeps_what_was_asked_for_last_within_its_room():
    made = []

    def value(key, size):
        def make():
            made.append(key)
            return b"x" * size

        return make

    cache: BoundedCache[bytes] = BoundedCache(10, len)
    for key, size in (("a", 4), ("b", 4), ("a", 4), ("c", 4), ("b", 4), ("big", 11), ("a", 1)):
        assert len(cache.get(key, value(key, size))) == size
    assert made == ["a", "b", "c", "b", "big", "a"]
    assert len(cache) == 1
