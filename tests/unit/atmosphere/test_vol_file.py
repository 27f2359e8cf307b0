"""Mitsuba's volumes: headers and values that are refused. Round trips are in test_weather_files.py."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.atmosphere.weather_files import read_sky
from forestgen.core.errors import AssetError

HEADER = struct.Struct("<3sBi3ii6f")


def volume(**changes: Any) -> bytes:
    parts = {"letters": b"VOL", "version": 3, "encoding": 1, "cells": (2, 2, 2), "channels": 1, **changes}
    values = parts.get("values", np.ones(8, "<f4").tobytes())
    corners = parts.get("corners", (0, 0, 0, 1, 1, 1))
    head = HEADER.pack(
        parts["letters"], parts["version"], parts["encoding"], *parts["cells"], parts["channels"], *corners
    )
    return head + values


@pytest.mark.parametrize(
    ("data", "expected", "got"),
    [
        (b"", "begins with VOL and has 48 bytes of header", "0 bytes"),
        (volume()[:30], "begins with VOL", "30 bytes"),
        (volume(letters=b"PNG"), "begins with VOL", "b'PNG\\x03'"),
        (volume(version=2), "expected  3", "got       2"),
        (volume(encoding=2), "float32 (encoding 1)", "float16 (2)"),
        (volume(encoding=9), "float32 (encoding 1)", "? (9)"),
        (volume(channels=3), "one channel", "3 channels"),
        (volume(cells=(2, 0, 2)), "cells along x, y and z", "(2, 0, 2)"),
        (volume(cells=(2, -2, -2)), "cells along x, y and z", "(2, -2, -2)"),
        (volume(cells=(2, 2, 3)), "96 bytes for (2, 2, 3) cells", "80 bytes"),
        (volume(cells=(2**31 - 1,) * 3), "bytes for", "80 bytes"),
        (volume(values=np.full(8, np.nan, "<f4").tobytes()), "numbers everywhere", "nan at (0, 0, 0)"),
        (volume(values=np.array([1, 1, 1, 1, 1, np.inf, 1, 1], "<f4").tobytes()), "numbers everywhere", "(1, 0, 1)"),
        (volume(values=np.array([1, 1, -2, 1, 1, 1, 1, 1], "<f4").tobytes()), "nothing below 0", "-2 1/m at (0, 1, 0)"),
        (volume(corners=(0, 0, 0, 1, 1, 0)), "a lower corner below the upper one", "0 to 0 m"),
        (volume(corners=(0, np.nan, 0, 1, 1, 1)), "a lower corner below", "nan to 1 m"),
    ],
)
def test_a_bad_volume_is_refused(tmp_path: Path, data: bytes, expected: str, got: str) -> None:
    path = tmp_path / "sky.vol"
    path.write_bytes(data)
    with pytest.raises(AssetError) as caught:
        read_sky(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: the file cannot be used as weather: ")
    assert expected in said
    assert got in said


def test_a_good_volume_is_read(tmp_path: Path) -> None:
    (tmp_path / "sky.vol").write_bytes(volume(corners=(0, 1, 2, 4, 5, 8)))
    grid = read_sky(tmp_path / "sky.vol")
    assert (grid.low_m, grid.high_m, grid.cell_m) == ((0.0, 1.0, 2.0), (4.0, 5.0, 8.0), (2.0, 2.0, 3.0))
    assert (grid.extinction_per_m == 1.0).all()
