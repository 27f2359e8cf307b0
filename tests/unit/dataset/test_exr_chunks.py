"""An OpenEXR file that is not whole is refused before the library reads it, which would print and go on."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from dataset_shots import make_shot

from forestgen.dataset.check.files import UnreadableError, read_exr
from forestgen.dataset.exr import write_exr
from forestgen.dataset.exr_chunks import check_chunks


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("exr") / "frame.exr"
    write_exr(path, make_shot([1, 2, 70_000]).labelled, {})
    return path.read_bytes()


def refused(content: bytes) -> bool:
    try:
        check_chunks(content)
    except ValueError:
        return True
    return False


def test_whole_files_pass(content: bytes, tmp_path: Path) -> None:
    assert not refused(content)
    for compression in (OpenEXR.NO_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.ZIP_COMPRESSION):
        pixels = {
            "Y": np.random.default_rng(3).random((37, 5)).astype(np.float32),
            "half": np.ones((37, 5), np.float16),
        }
        header = {"compression": compression, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, pixels).write(str(tmp_path / "one.exr"))
        assert not refused((tmp_path / "one.exr").read_bytes())


def test_half_a_file_is_refused_and_the_library_prints_nothing(
    content: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for length in (0, 3, 7, 200, 5000, len(content) // 2, len(content) - 1):
        (tmp_path / "a.exr").write_bytes(content[:length])
        with pytest.raises(UnreadableError) as caught:
            read_exr(tmp_path, "a.exr")
        assert caught.value.finding.file == "a.exr"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(6))
def test_what_passes_is_read_in_full_and_in_silence(
    seed: int, content: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Wrong bits in headers, tables and pixels: the library raises, or reads all parts."""
    rng, parts = random.Random(seed), len(read(content, tmp_path))
    for _ in range(20):
        damaged = bytearray(content)
        for _ in range(rng.choice((1, 1, 3))):
            damaged[rng.randrange(rng.choice((12_000, len(content))))] ^= 1 << rng.randrange(8)
        try:
            assert len(read(bytes(damaged), tmp_path)) == parts
        except UnreadableError:
            continue
    assert capfd.readouterr() == ("", "")


def read(content: bytes, folder: Path) -> dict[str, object]:
    (folder / "a.exr").write_bytes(content)
    return dict(read_exr(folder, "a.exr")[0])


def test_a_picture_to_the_horizon_is_refused(content: bytes) -> None:

    window = struct.pack("<4i", 0, 0, 59, 39)
    assert window in content
    assert refused(content.replace(window, struct.pack("<4i", 0, 0, 2**30, 2**30)))
    assert refused(content.replace(window, struct.pack("<4i", 0, 0, 59, 2**14)))
