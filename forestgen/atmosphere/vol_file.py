"""Mitsuba's grid volume files, `.vol`, version 3: a header of 48 bytes and the cells.

| bytes | type | content |
|---|---|---|
| 0-3 | 3 letters, 1 byte | `VOL`, version 3 |
| 4-7 | int32 | encoding: 1, float32; 2 would be float16, 3 bytes |
| 8-19 | 3 int32 | cells along x, y, z |
| 20-23 | int32 | channels: 1 |
| 24-47 | 6 float32 | lower corner x, y, z, upper corner x, y, z |
| 48- | float32 | values, x fastest, then y, then z |

All little-endian. The corners are those of the box around the cells. Mitsuba fills its unit cube with the cells unless
`use_grid_bbox` is set, and then takes these corners.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from forestgen.atmosphere.field_checks import FieldError, check_room
from forestgen.atmosphere.grid import CloudGrid

_HEADER = struct.Struct("<3sBi3ii6f")
_ENCODINGS = {1: "float32", 2: "float16", 3: "bytes", 4: "directions"}


def write_vol(path: Path, grid: CloudGrid) -> None:
    """Write an extinction field. Albedo and phase function have no place in it."""
    depth, height, width = grid.extinction_per_m.shape
    header = _HEADER.pack(b"VOL", 3, 1, width, height, depth, 1, *grid.low_m, *grid.high_m)
    with path.open("wb") as file:
        file.write(header)
        file.write(np.ascontiguousarray(grid.extinction_per_m, dtype="<f4").data)


def read_vol(path: Path) -> CloudGrid:
    """An extinction field.

    Raises
    ------
    FieldError : it is no such file, or its size is not what its header says.
    ResourceError : it does not fit into memory.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size or head[:3] != b"VOL":
            raise FieldError(
                "the file", "a Mitsuba volume, which begins with VOL and has 48 bytes of header", _said(head)
            )
        _, version, encoding, *numbers = _HEADER.unpack(head)
        cells, channels, corners = tuple(numbers[:3]), numbers[3], numbers[4:]
        if version != 3:
            raise FieldError("the version", "3", str(version))
        if encoding != 1:
            raise FieldError("the numbers", "float32 (encoding 1)", f"{_ENCODINGS.get(encoding, '?')} ({encoding})")
        if min(cells) < 1 or channels != 1:
            raise FieldError("the header", "cells along x, y and z, one channel", f"{cells}, {channels} channels")
        expected = _HEADER.size + 4 * cells[0] * cells[1] * cells[2]
        if size != expected:
            raise FieldError("the file's size", f"{expected:,} bytes for {cells} cells", f"{size:,} bytes")
        check_room(expected, str(path))
        values = np.fromfile(file, dtype="<f4")
    low, high = (tuple(float(x) for x in corner) for corner in (corners[:3], corners[3:]))
    field = values.astype(np.float32, copy=False).reshape(cells[2], cells[1], cells[0])
    return CloudGrid(field, (low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _said(head: bytes) -> str:
    return f"{len(head)} bytes" if len(head) < _HEADER.size else f"a file that begins with {head[:4]!r}"
