"""OpenVDB files, `.vdb`: extinction as a fog volume named `density`, written by hand, for Blender, Houdini and others.

PyPI has no wheel of OpenVDB itself: there is no `openvdb`, and `pyopenvdb` has none for today's Pythons. `tinyvdb`
0.9.0, which has, loses leaves of nodes with more than 64. So this is a writer only, of format 224: a tree of 8, 16 and
32 children a side (`Tree_float_5_4_3`), each node's values deflated. Leaves of 8 x 8 x 8 cells without any extinction
are left out. Values are the extinction in 1/m, exact; z is up; scale and translation put the voxels' centres where the
cells' centres are in the world. OpenVDB 12.0, the one inside Blender 5.0, reads every value, activity and place right.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid

_MAGIC, _FORMAT, _LIBRARY = 0x56444220, 224, (10, 0)
_ZIP = 1
_ALL_VALUES = b"\x06"  # each node stores all its values, none is left to a mask
_UUID = b"00000000-0000-0000-0000-000000000000"  # the same field makes the same bytes
_SIDES = (8, 16, 32)  # of a leaf in voxels, of an inner node in leaves, of an outer one in inner nodes


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


def _leaves(field: NDArray[np.float32]) -> dict[tuple[int, int, int], NDArray[np.float32]]:
    """Blocks of 8 x 8 x 8 (x, y, z) voxels that hold anything, by their first voxel."""
    counts = [-(-n // 8) for n in field.shape]
    padded = np.zeros([8 * n for n in counts], np.float32)
    padded[: field.shape[0], : field.shape[1], : field.shape[2]] = field
    blocks = padded.reshape(counts[0], 8, counts[1], 8, counts[2], 8).transpose(0, 2, 4, 1, 3, 5)
    some = np.argwhere(blocks.any(axis=(3, 4, 5)))
    return {(8 * int(i), 8 * int(j), 8 * int(k)): np.ascontiguousarray(blocks[i, j, k]) for i, j, k in some}


def _write_tree(file: BinaryIO, leaves: dict[tuple[int, int, int], NDArray[np.float32]]) -> int:
    """Topology, then the leaves' values; where in the file the latter begin."""
    outer: dict[tuple[int, int, int], dict[tuple[int, int, int], list[tuple[int, int, int]]]] = {}
    for leaf in leaves:
        inner = _first(leaf, 128)
        outer.setdefault(_first(leaf, 4096), {}).setdefault(inner, []).append(leaf)
    file.write(struct.pack("<IfII", 1, 0.0, 0, len(outer)))  # one buffer a leaf; background; tiles; children
    order = []
    for origin in sorted(outer):
        file.write(struct.pack("<3i", *origin))
        inners = _in_order(list(outer[origin]), 128, 5)
        _write_node(file, [place for place, _ in inners], 32)
        for _, inner in inners:
            below = _in_order(outer[origin][inner], 8, 4)
            _write_node(file, [place for place, _ in below], 16)
            for _, leaf in below:
                file.write(_mask(leaves[leaf] != 0.0))
                order.append(leaf)
    begin = file.tell()
    for leaf in order:
        file.write(_mask(leaves[leaf] != 0.0) + _ALL_VALUES + _deflated(leaves[leaf]))
    return begin


def _write_node(file: BinaryIO, places: list[int], side: int) -> None:
    """Masks of children and of active tiles, of which there are none; and the tiles' values, all 0."""
    children = np.zeros(side**3, bool)
    children[places] = True
    file.write(_mask(children) + bytes(side**3 // 8))
    file.write(_ALL_VALUES + _deflated(np.zeros(side**3, np.float32)))


def _in_order(origins: list[tuple[int, int, int]], size: int, log_side: int) -> list[tuple[int, tuple[int, int, int]]]:
    """Children by their place in the parent: x slowest, z fastest."""
    side = 1 << log_side

    def place(origin: tuple[int, int, int]) -> int:
        x, y, z = ((value // size) % side for value in origin)
        return (x * side + y) * side + z

    return sorted((place(origin), origin) for origin in origins)


def _first(voxel: tuple[int, int, int], size: int) -> tuple[int, int, int]:
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
