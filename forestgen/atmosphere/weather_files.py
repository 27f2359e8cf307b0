"""Weather and cloud fields as files: what a simulation resumes from, and what other programs read and write.

| file | holds | of |
|---|---|---|
| `.nc` | NetCDF-4 with CF's names and units, compressed (`netcdf_file`) | a snapshot, or an extinction field |
| `.vol` | Mitsuba's grid volume, see below | an extinction field |
| `.vdb` | OpenVDB, written only, see below | an extinction field |
| `.csv` | a table of heights, read only (`sounding`) | a sounding |

A snapshot comes back to the last bit, so a simulation that resumes goes on as if it had not stopped. A `.vol` and a
`.vdb` hold no albedo and no phase function, and the corners of a `.vol` are rounded to float32.

Files are written beside their place and then renamed: a file of this name is always whole. The same values make the
same bytes, and none is in half precision. What is read is checked: sizes that agree and fit into memory, numbers in
their range.

A `.vol` is a header of 48 bytes and the cells, all little-endian:

| bytes | type | content |
|---|---|---|
| 0-3 | 3 letters, 1 byte | `VOL`, version 3 |
| 4-7 | int32 | encoding: 1, float32; 2 would be float16, 3 bytes |
| 8-19 | 3 int32 | cells along x, y, z |
| 20-23 | int32 | channels: 1 |
| 24-47 | 6 float32 | lower corner x, y, z, upper corner x, y, z |
| 48- | float32 | values, x fastest, then y, then z |

The corners are those of the box around the cells, which Mitsuba takes if `use_grid_bbox` is set; else it fills its unit
cube.

A `.vdb`, for Blender, Houdini and others, holds the extinction as a fog volume named `density`. PyPI has no wheel of
OpenVDB for today's Pythons, and `tinyvdb` 0.9.0 loses leaves of nodes with more than 64. So this is a writer only, of
format 224: a tree of 8, 16 and 32 children a side (`Tree_float_5_4_3`), each node's values deflated. Leaves of 8 x 8 x
8 cells without any extinction are left out. Values are the extinction in 1/m, exact; z is up; scale and translation put
the voxels' centres where the cells' centres are in the world. OpenVDB 12.0, the one inside Blender 5.0, reads every
value, activity and place right.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid, FieldError, Weather, check_clouds, check_room, check_weather
from forestgen.atmosphere.netcdf_file import droplet_radius_of, netcdf_size, read_netcdf, write_netcdf
from forestgen.atmosphere.sounding import MOST_BYTES, Sounding, sounding_of_table
from forestgen.core.errors import AssetError, ForestgenError, OutputError

_MAGIC, _FORMAT, _LIBRARY = 0x56444220, 224, (10, 0)
_ZIP = 1
_ALL_VALUES = b"\x06"  # each node stores all its values, none is left to a mask
_UUID = b"00000000-0000-0000-0000-000000000000"  # the same field makes the same bytes
_HEADER = struct.Struct("<3sBi3ii6f")
_ENCODINGS = {1: "float32", 2: "float16", 3: "bytes", 4: "directions"}
_Voxel = tuple[int, int, int]
T = TypeVar("T")


def write_vdb(path: Path, grid: CloudGrid) -> None:
    """Write an extinction field."""
    leaves = _leaves(np.ascontiguousarray(grid.extinction_per_m.transpose(2, 1, 0)))
    with path.open("wb") as file:
        file.write(struct.pack("<qIII?", _MAGIC, _FORMAT, *_LIBRARY, True) + _UUID)
        file.write(struct.pack("<II", 0, 1))  # no metadata of the file; one grid
        file.write(_text("density") + _text("Tree_float_5_4_3") + _text(""))
        offsets = file.tell()
        file.write(bytes(24))
        begin = file.tell()
        file.write(struct.pack("<I", _ZIP) + _metadata() + _transform(grid))
        blocks = _write_tree(file, leaves)
        end = file.tell()
        file.seek(offsets)
        file.write(struct.pack("<qqq", begin, blocks, end))


def _leaves(field: NDArray[np.float32]) -> dict[_Voxel, NDArray[np.float32]]:
    """Blocks of 8 x 8 x 8 (x, y, z) voxels that hold anything, by their first voxel."""
    counts = [-(-n // 8) for n in field.shape]
    padded = np.zeros([8 * n for n in counts], np.float32)
    padded[: field.shape[0], : field.shape[1], : field.shape[2]] = field
    blocks = padded.reshape(counts[0], 8, counts[1], 8, counts[2], 8).transpose(0, 2, 4, 1, 3, 5)
    some = np.argwhere(blocks.any(axis=(3, 4, 5)))
    return {(8 * int(i), 8 * int(j), 8 * int(k)): np.ascontiguousarray(blocks[i, j, k]) for i, j, k in some}


def _write_tree(file: BinaryIO, leaves: dict[_Voxel, NDArray[np.float32]]) -> int:
    """Topology, then the leaves' values; where in the file the latter begin."""
    # Outer node, inner node and leaf, by their first voxels: x slowest, z fastest.
    rows = sorted((_first(leaf, 4096), _first(leaf, 128), leaf) for leaf in leaves)
    roots = len({outer for outer, _, _ in rows})
    file.write(struct.pack("<IfII", 1, 0.0, 0, roots))  # one buffer a leaf; background; tiles; children
    for outer, below in groupby(rows, key=itemgetter(0)):
        inners = [[leaf for _, _, leaf in own] for _, own in groupby(below, key=itemgetter(1))]
        file.write(struct.pack("<3i", *outer))
        _write_node(file, [own[0] for own in inners], 128, 32)
        for own in inners:
            _write_node(file, own, 8, 16)
            for leaf in own:
                file.write(_mask(leaves[leaf] != 0.0))
    begin = file.tell()
    for _, _, leaf in rows:
        file.write(_mask(leaves[leaf] != 0.0) + _ALL_VALUES + _deflated(leaves[leaf]))
    return begin


def _write_node(file: BinaryIO, voxels: list[_Voxel], size: int, side: int) -> None:
    """Masks of children, which hold these voxels, and of active tiles, of which there are none; their values, all 0."""
    children = np.zeros((side,) * 3, bool)
    children[tuple((np.array(voxels) // size % side).T)] = True
    file.write(_mask(children) + bytes(side**3 // 8))
    file.write(_ALL_VALUES + _deflated(np.zeros(side**3, np.float32)))


def _first(voxel: _Voxel, size: int) -> _Voxel:
    x, y, z = (value // size * size for value in voxel)
    return x, y, z


def _mask(bits: NDArray[np.bool_]) -> bytes:
    return np.packbits(bits.reshape(-1), bitorder="little").tobytes()


def _deflated(values: NDArray[np.float32]) -> bytes:
    plain = values.astype("<f4").tobytes()
    packed = zlib.compress(plain)
    if len(packed) < len(plain):
        return struct.pack("<q", len(packed)) + packed
    return struct.pack("<q", -len(plain)) + plain


def _metadata() -> bytes:
    entries = [
        ("class", "string", b"fog volume"),
        ("is_saved_as_half_float", "bool", b"\x00"),
        ("name", "string", b"density"),
    ]
    said = [_text(name) + _text(kind) + struct.pack("<I", len(value)) + value for name, kind, value in entries]
    return struct.pack("<I", len(said)) + b"".join(said)


def _transform(grid: CloudGrid) -> bytes:
    """Voxel (0, 0, 0) is the centre of the first cell."""
    scale = np.array(grid.cell_m, "<f8")
    centre = np.array(grid.low_m, "<f8") + scale / 2
    name = "UniformScaleTranslateMap" if len(set(grid.cell_m)) == 1 else "ScaleTranslateMap"
    rows = [centre, scale, scale, 1 / scale, 1 / scale**2, 1 / (2 * scale)]
    return _text(name) + b"".join(row.astype("<f8").tobytes() for row in rows)


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode("ascii")


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
_WRITERS: dict[str, Callable[[Path, CloudGrid], None]] = {".nc": write_netcdf, ".vol": write_vol, ".vdb": write_vdb}


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
    """Write an extinction field in the suffix' format. `OutputError`: another suffix, no field, no writing."""
    with _explained(path, OutputError, "the clouds cannot be written"):
        write = _by_suffix(path, _WRITERS)
        check_clouds(grid)
        _write(path, write, grid)


def read_sky(path: Path) -> Weather | CloudGrid:
    """A snapshot or an extinction field. `AssetError`: no such file, or neither; `ResourceError`: no memory."""
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
    """Cells of a file's field and width of a periodic snapshot, m, by its head; None: it cannot be read."""
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
