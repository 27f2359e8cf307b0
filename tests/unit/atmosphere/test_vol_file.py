"""Mitsuba's volumes: headers and values that are refused. Round trips are in test_weather_files.py."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.atmosphere.weather_files import read_sky
from forestgen.core.errors import AssetError
from support.error_messages import raises_error

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
    "data",
    [
        b"",
        volume()[:30],
        volume(letters=b"PNG"),
        volume(version=2),
        volume(encoding=2),
        volume(encoding=9),
        volume(channels=3),
        volume(cells=(2, 0, 2)),
        volume(cells=(2, -2, -2)),
        volume(cells=(2, 2, 3)),
        volume(cells=(2**31 - 1,) * 3),
        volume(values=np.full(8, np.nan, "<f4").tobytes()),
        volume(values=np.array([1, 1, 1, 1, 1, np.inf, 1, 1], "<f4").tobytes()),
        volume(values=np.array([1, 1, -2, 1, 1, 1, 1, 1], "<f4").tobytes()),
        volume(corners=(0, 0, 0, 1, 1, 0)),
        volume(corners=(0, np.nan, 0, 1, 1, 1)),
    ],
)
def test_a_bad_volume_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "sky.vol"
    path.write_bytes(data)
    with raises_error(AssetError, place="sky.vol"):
        read_sky(path)


def test_a_good_volume_is_read(tmp_path: Path) -> None:
    (tmp_path / "sky.vol").write_bytes(volume(corners=(0, 1, 2, 4, 5, 8)))
    grid = read_sky(tmp_path / "sky.vol")
    assert (grid.low_m, grid.high_m, grid.cell_m) == ((0.0, 1.0, 2.0), (4.0, 5.0, 8.0), (2.0, 2.0, 3.0))
    assert (grid.extinction_per_m == 1.0).all()
