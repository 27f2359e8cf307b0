"""Whether an OpenEXR file is whole, before the library reads it.

Of a file that is cut short or damaged the library prints a line for each part, leaves the parts out, and goes on. So
the file's structure is followed first, and each block of lines is unpacked once. Files are those that forestgen writes:
parts of scan lines, not compressed or by zlib.

References
----------
openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.processes import free_bytes
from forestgen.dataset.safe_path import SafePath

_MAGIC, _VERSION = b"\x76\x2f\x31\x01", 2
_LONG_NAMES, _MULTIPART = 0x400, 0x1000
_LINES = {0: 1, 2: 1, 3: 16}  # of a block, by compression: none, zlib by line, zlib by 16 lines
_SAMPLE_BYTES = {0: 4, 1: 2, 2: 4}  # by a channel's type: uint, half, float
_KINDS = {
    b"channels": b"chlist", b"chunkCount": b"int", b"compression": b"compression", b"dataWindow": b"box2i",
    b"displayWindow": b"box2i", b"lineOrder": b"lineOrder", b"name": b"string", b"type": b"string",
}  # fmt: skip
_MOST_PARTS, _MOST_NAME, _MOST_SIDE_PX = 200, 255, 16_384
_SHARE_OF_MEMORY = 0.8


class _Part(NamedTuple):
    """What a header says of its part's blocks."""

    lines: int  # of a block
    first: int  # line
    height: int
    line_bytes: int  # unpacked


def check_chunks(content: bytes, *, unpack: bool = True) -> int:
    """Number of parts of a file that the library would read in full.

    `unpack` every block too, which takes as long as to read the file; without it a changed bit may be missed. A file
    that is cut short, damaged, of another kind than forestgen writes, or larger than the free memory, is a ValueError.
    """
    try:
        magic, version = struct.unpack_from("<4sI", content)
        if magic != _MAGIC or version & ~(_LONG_NAMES | _MULTIPART) != _VERSION:
            raise ValueError("this is no OpenEXR file of scan lines")
        several = bool(version & _MULTIPART)
        parts, at = _parts(content, 8, several)
        need = sum(part.height * part.line_bytes for part in parts)
        if need > _SHARE_OF_MEMORY * free_bytes():
            raise ValueError(f"its pixels take more than the free memory: {need / 1e6:,.0f} MB")
        for number, part in enumerate(parts):
            offsets = struct.unpack_from(f"<{-(-part.height // part.lines)}Q", content, at)
            at += 8 * len(offsets)
            for block, offset in enumerate(offsets):
                _check_block(content, min(offset, len(content)), part, block, (number,) if several else (), unpack)
        return len(parts)
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError("the file is cut short, damaged, or of another kind than forestgen's") from error


def read_whole(path: SafePath, *, unpack: bool = True) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]]:
    """Part -> channel -> (H, W) array in the type it was stored in, and the first part's header, of a checked file.

    Raises what `check_chunks` and `SafePath.read` raise, and what the library's C++ throws.
    """
    import OpenEXR

    count = check_chunks(path.read(), unpack=unpack)
    parts = OpenEXR.File(str(path.located()), separate_channels=True).parts
    if len(parts) != count:
        raise ValueError(f"{len(parts)} of {count} parts can be read")
    pixels = {part.name(): {name: np.asarray(one.pixels) for name, one in part.channels.items()} for part in parts}
    return pixels, dict(parts[0].header)


def _parts(content: bytes, at: int, several: bool) -> tuple[list[_Part], int]:
    """What the headers say, and where they end."""
    parts: list[_Part] = []
    while content[at] or not parts:
        if len(parts) == _MOST_PARTS:
            raise ValueError(f"more than {_MOST_PARTS} parts")
        header = {}
        while content[at]:
            name, at = _name(content, at)
            kind, at = _name(content, at)
            (size,) = struct.unpack_from("<i", content, at)
            header[name] = content[at + 4 : at + 4 + size]
            at += 4 + size
            if len(header[name]) != size or kind != _KINDS.get(name, kind):  # else the library takes another value
                raise ValueError("its header is damaged")
        at += 1
        parts.append(_part(header))
        if not several:
            return parts, at
    return parts, at + 1


def _name(content: bytes, at: int) -> tuple[bytes, int]:
    end = content.find(b"\0", at, at + _MOST_NAME + 1)
    if end < 0:
        raise ValueError("its header is damaged")
    return content[at:end], end + 1


def _part(header: dict[bytes, bytes]) -> _Part:
    left, top, right, bottom = struct.unpack("<4i", header[b"dataWindow"])
    lines = _LINES[header[b"compression"][0]]
    width, height = right - left + 1, bottom - top + 1
    count = struct.pack("<i", min(max(0, -(-height // lines)), 2**31 - 1))
    if header.get(b"chunkCount", count) != count:
        raise ValueError("its header is damaged")
    if header.get(b"type", b"scanlineimage").rstrip(b"\0") != b"scanlineimage":
        raise ValueError("a part does not consist of scan lines")
    if not (0 < width <= _MOST_SIDE_PX and 0 < height <= _MOST_SIDE_PX):
        raise ValueError(f"{width:,} x {height:,} pixels, at most {_MOST_SIDE_PX:,} a side")
    return _Part(lines, top, height, width * _pixel_bytes(header[b"channels"]))


def _pixel_bytes(channels: bytes) -> int:
    """Bytes of a pixel, by a list of channels."""
    total = at = 0
    while channels[at]:
        at = channels.index(b"\0", at) + 1
        kind, _, across, down = struct.unpack_from("<iIii", channels, at)
        if (across, down) != (1, 1):
            raise ValueError("a channel has not a value for each pixel")
        total += _SAMPLE_BYTES[kind]
        at += 16
    return total


def _check_block(content: bytes, at: int, part: _Part, block: int, number: tuple[int, ...], unpack: bool) -> None:
    """One block of lines: it is where the table says, of this part and line, and can be unpacked."""
    *leader, size = struct.unpack_from("<ii" if not number else "<iii", content, at)
    whole = min(part.lines, part.height - block * part.lines) * part.line_bytes
    begin = at + 4 * (len(leader) + 1)
    packed = content[begin : begin + max(0, size)]
    if leader != [*number, part.first + block * part.lines] or size > whole or len(packed) != size:
        raise ValueError("a block of lines is cut short or damaged")
    if not unpack or size == whole:  # not compressed: it would not have become shorter
        return
    unpacker = zlib.decompressobj()
    try:
        is_whole = len(unpacker.decompress(packed, whole + 1)) == whole and unpacker.eof
    except zlib.error:
        is_whole = False
    if not is_whole:
        raise ValueError("a block of lines cannot be unpacked")
