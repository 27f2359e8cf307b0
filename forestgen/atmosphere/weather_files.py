"""Weather and cloud fields as files: what a simulation resumes from, and what other programs read and write.

| file | holds | of |
|---|---|---|
| `.nc` | NetCDF-4 with CF's names and units, compressed (`netcdf_file`) | a snapshot, or an extinction field |
| `.vol` | Mitsuba's grid volume, see below | an extinction field |
| `.vdb` | OpenVDB, written only (`vdb_file`, which says why) | an extinction field |
| `.csv` | a table of heights, read only (`sounding`) | a sounding |

A snapshot comes back to the last bit, so a simulation that resumes goes on as if it had not stopped. A `.vol` and a
`.vdb` hold no albedo and no phase function, and the corners of a `.vol` are rounded to float32.

Files are written beside their place and then renamed: a file of this name is always whole. The same values make the
same bytes. Nothing is stored or read in half precision. What is read is checked: sizes that agree and fit into memory,
numbers that are numbers and in their range.

A `.vol` is a header of 48 bytes and the cells, all little-endian:

| bytes | type | content |
|---|---|---|
| 0-3 | 3 letters, 1 byte | `VOL`, version 3 |
| 4-7 | int32 | encoding: 1, float32; 2 would be float16, 3 bytes |
| 8-19 | 3 int32 | cells along x, y, z |
| 20-23 | int32 | channels: 1 |
| 24-47 | 6 float32 | lower corner x, y, z, upper corner x, y, z |
| 48- | float32 | values, x fastest, then y, then z |

The corners are those of the box around the cells. Mitsuba fills its unit cube with the cells unless `use_grid_bbox` is
set, and then takes these corners.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from forestgen.atmosphere.grid import CloudGrid, FieldError, Weather, check_clouds, check_room, check_weather
from forestgen.atmosphere.netcdf_file import droplet_radius_of, netcdf_size, read_netcdf, write_netcdf
from forestgen.atmosphere.sounding import MOST_BYTES, Sounding, sounding_of_table
from forestgen.atmosphere.vdb_file import write_vdb
from forestgen.core.errors import AssetError, ForestgenError, OutputError

_HEADER = struct.Struct("<3sBi3ii6f")
_ENCODINGS = {1: "float32", 2: "float16", 3: "bytes", 4: "directions"}
T = TypeVar("T")


def write_vol(path: Path, grid: CloudGrid) -> None:
    """Write an extinction field. Albedo and phase function have no place in it."""
    depth, height, width = grid.extinction_per_m.shape
    header = _HEADER.pack(b"VOL", 3, 1, width, height, depth, 1, *grid.low_m, *grid.high_m)
    with path.open("wb") as file:
        file.write(header)
        file.write(np.ascontiguousarray(grid.extinction_per_m, dtype="<f4").data)


def read_vol(path: Path) -> CloudGrid:
    """An extinction field. `FieldError`: no such file, or not of the size in its header; `ResourceError`: no memory."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size or head[:3] != b"VOL":
            expected = "a Mitsuba volume, which begins with VOL and has 48 bytes of header"
            begins = f"a file that begins with {head[:4]!r}"
            raise FieldError("the file", expected, begins if len(head) == _HEADER.size else f"{len(head)} bytes")
        _, version, encoding, *numbers = _HEADER.unpack(head)
        cells, channels, corners = tuple(numbers[:3]), numbers[3], numbers[4:]
        if version != 3:
            raise FieldError("the version", "3", str(version))
        if encoding != 1:
            raise FieldError("the numbers", "float32 (encoding 1)", f"{_ENCODINGS.get(encoding, '?')} ({encoding})")
        if min(cells) < 1 or channels != 1:
            raise FieldError("the header", "cells along x, y and z, one channel", f"{cells}, {channels} channels")
        expected_bytes = _HEADER.size + 4 * math.prod(cells)
        if size != expected_bytes:
            raise FieldError("the file's size", f"{expected_bytes:,} bytes for {cells} cells", f"{size:,} bytes")
        check_room(expected_bytes, str(path))
        field = np.fromfile(file, dtype="<f4").astype(np.float32, copy=False).reshape(cells[::-1])
    return CloudGrid(field, (corners[0], corners[1], corners[2]), (corners[3], corners[4], corners[5]))


_READERS: dict[str, Callable[[Path], Weather | CloudGrid]] = {".nc": read_netcdf, ".vol": read_vol}
_WRITERS: dict[str, Callable[[Path, CloudGrid], None]] = {
    ".nc": write_netcdf,
    ".vol": write_vol,
    ".vdb": write_vdb,
}


def read_sounding(path: Path, *, ground_pressure_pa: float = 101_325.0) -> Sounding:
    """Air at rest, of a table. `AssetError`: no such file, or impossible air; with line and column."""
    with _explained(path, AssetError, "the file cannot be used as a sounding"), path.open("rb") as file:
        return sounding_of_table(file.read(MOST_BYTES + 1), ground_pressure_pa)


def write_weather(path: Path, weather: Weather, *, droplet_radius_um: float | None = None) -> None:
    """Write a snapshot as NetCDF-4, with the effective radius of its droplets if it is known.

    Raises `OutputError` if the name does not end in .nc, the snapshot is none, or the file cannot be written.
    """
    with _explained(path, OutputError, "the snapshot cannot be written"):
        if path.suffix.lower() != ".nc":
            raise FieldError("the name", "one that ends in .nc: a snapshot is a NetCDF file", path.name)
        check_weather(weather)
        _write(path, partial(write_netcdf, droplet_radius_um=droplet_radius_um), weather)


def write_clouds(path: Path, grid: CloudGrid) -> None:
    """Write an extinction field, in the format of the name's suffix.

    Raises `OutputError` if the suffix is another, the field is none, or the file cannot be written.
    """
    with _explained(path, OutputError, "the clouds cannot be written"):
        write = _by_suffix(path, _WRITERS)
        check_clouds(grid)
        _write(path, write, grid)


def read_sky(path: Path) -> Weather | CloudGrid:
    """Whatever a file holds: a snapshot or an extinction field.

    Raises `AssetError` if there is no such file or its content is neither, `ResourceError` if memory is too small.
    """
    with _explained(path, AssetError, "the file cannot be used as weather"):
        read = _by_suffix(path, _READERS)
        if not path.is_file():
            raise FieldError("the file", "an existing file", "a folder" if path.is_dir() else "none")
        content = read(path)
        if isinstance(content, Weather):
            check_weather(content)
        else:
            check_clouds(content)
    return content


def size_of(path: Path) -> tuple[int, float | None] | None:
    """Cells of a file's field, and how wide a state of the air that is periodic is, m; None: it cannot be read.

    Nothing but the head of the file is read.
    """
    try:
        if path.suffix.lower() == ".nc":
            return netcdf_size(path)
        return (path.stat().st_size // 4, None) if path.is_file() else None
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return None


def read_droplet_radius_um(path: Path) -> float | None:
    """Effective radius of a snapshot's droplets; None if the file does not say. `AssetError`: no number above 0."""
    with _explained(path, AssetError, "the file cannot be used as weather"):
        return droplet_radius_of(path)


def _by_suffix(path: Path, table: Mapping[str, T]) -> T:
    if path.suffix.lower() not in table:
        raise FieldError("the name", f"one that ends in {', '.join(table)}", path.name)
    return table[path.suffix.lower()]


def _write(path: Path, write: Callable[[Path, T], None], content: T) -> None:
    """Write beside the place, then rename."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(beside, content)
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


@contextmanager
def _explained(path: Path, error: type[ForestgenError], problem: str) -> Iterator[None]:
    """Name the file in errors."""
    try:
        yield
    except FieldError as cause:
        raise error(f"{problem}: {cause.what}", where=str(path), expected=cause.expected, got=cause.got) from cause
    except (OSError, ValueError) as cause:  # ValueError: a name that no file system takes
        reason = cause.strerror if isinstance(cause, OSError) and cause.strerror else str(cause).splitlines()[0]
        raise error(problem, where=str(path), got=reason) from cause
