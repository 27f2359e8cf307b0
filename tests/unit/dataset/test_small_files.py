"""Thumbnails and checksums."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.manifest import file_sum, read_sums, write_sums
from forestgen.dataset.png import LONG_SIDE_PX, write_png, write_thumbnail
from support.error_messages import raises_error


def frame(folder, width, height):
    folder.mkdir()
    y, x = np.mgrid[:height, :width]
    picture = np.stack([255 * x / width, 255 * y / height, np.full(x.shape, 90)], axis=2).astype(np.uint8)
    write_png(folder / "preview.png", picture, {"view": "filmic"})
    return picture


@pytest.mark.parametrize("size", [(1024, 512), (300, 900), (640, 360)])
def test_a_thumbnail_is_the_preview_made_small(tmp_path, size):
    picture = frame(tmp_path / "f", *size)
    write_thumbnail(tmp_path / "f", tmp_path / "thumbnails" / "f.jpg")
    with Image.open(tmp_path / "thumbnails" / "f.jpg") as image:
        small = np.asarray(image).astype(float)
        assert (image.format, image.mode, max(image.size)) == ("JPEG", "RGB", LONG_SIDE_PX)
        assert image.size[0] / image.size[1] == pytest.approx(size[0] / size[1], rel=0.01)
    assert np.abs(small.mean(axis=(0, 1)) - picture.mean(axis=(0, 1))).max() < 3
    assert small[:, -1, 0].mean() > small[:, 0, 0].mean() + 200  # red grows to the right


def test_a_small_preview_is_not_enlarged_and_bytes_are_the_same(tmp_path):
    frame(tmp_path / "f", 32, 24)
    for name in ("one.jpg", "two.jpg"):
        write_thumbnail(tmp_path / "f", tmp_path / name)
    assert (tmp_path / "one.jpg").read_bytes() == (tmp_path / "two.jpg").read_bytes()
    with Image.open(tmp_path / "one.jpg") as image:
        assert image.size == (32, 24)


def test_a_preview_that_cannot_be_read(tmp_path):
    frame(tmp_path / "f", 64, 64)
    path = tmp_path / "f" / "preview.png"
    path.write_bytes(path.read_bytes()[:80])
    with raises_error(OutputError, place="preview.png"):
        write_thumbnail(tmp_path / "f", tmp_path / "t.jpg")
    path.unlink()
    with raises_error(OutputError, place="preview.png"):
        write_thumbnail(tmp_path / "f", tmp_path / "t.jpg")
    assert not (tmp_path / "t.jpg").exists()


def test_sums_come_back(tmp_path):
    (tmp_path / "a file.txt").write_bytes(b"abc")
    digest = file_sum(tmp_path / "a file.txt")
    assert digest == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-4
    pairs = [("a file.txt", digest), ("train/é.png", "0" * 64)]
    write_sums(tmp_path / "SHA256SUMS", pairs)
    assert list(read_sums(tmp_path / "SHA256SUMS")) == pairs


@pytest.mark.parametrize("line", [b"abc  file\n", b"0" * 64 + b" file\n", b"0" * 64 + b"  file", b"\n", b"\xff\n"])
def test_a_bad_line_is_named(tmp_path, line):
    (tmp_path / "S").write_bytes(b"1" * 64 + b"  good\n" + line)
    with raises_error(DatasetError):
        list(read_sums(tmp_path / "S"))
