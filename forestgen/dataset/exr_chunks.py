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
from dataclasses import dataclass
from typing import IO, Any

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


@dataclass(frozen=True)
class _Part:
    """What a header says of its part's blocks."""

    lines: int  # of a block
    first: int  # line
    height: int
    line_bytes: int  # unpacked

    @property
    def blocks(self) -> int:
        return -(-self.height // self.lines)

    def block_bytes(self, number: int) -> int:
        return min(self.lines, self.height - number * self.lines) * self.line_bytes


def check_chunks(stream: IO[bytes], *, unpack: bool = True) -> int:
    """Number of parts of a file that the library would read in full.

    Parameters
    ----------
    unpack : unpack every block too, which takes as long as to read the file; without it a changed bit may be missed.

    Raises
    ------
    ValueError : the file is cut short, damaged, of another kind than forestgen writes, or larger than the free memory.
    """
    magic, version = _unpack(stream, "<4sI")
    if magic != _MAGIC or version & ~(_LONG_NAMES | _MULTIPART) != _VERSION:
        raise ValueError("this is no OpenEXR file of scan lines")
    several = bool(version & _MULTIPART)
    parts = _parts(stream, several)
    need = sum(part.height * part.line_bytes for part in parts)
    if need > _SHARE_OF_MEMORY * free_bytes():
        raise ValueError(f"its pixels take more than the free memory: {need / 1e6:,.0f} MB")
    tables = [_unpack(stream, f"<{part.blocks}Q") for part in parts]
    for number, (part, offsets) in enumerate(zip(parts, tables, strict=True)):
        for block, offset in enumerate(offsets):
            _check_block(stream, offset, part, block, number if several else None, unpack)
    return len(parts)


def read_whole(path: SafePath, *, unpack: bool = True) -> tuple[dict[str, dict[str, NDArray[Any]]], dict[str, Any]]:
    """Part -> channel -> (H, W) array in the type it was stored in, and the first part's header, of a checked file.

    Raises what `check_chunks` and `SafePath.open` raise, and what the library's C++ throws.
    """
    import OpenEXR

    with path.open() as stream:
        count = check_chunks(stream, unpack=unpack)
    parts = OpenEXR.File(str(path.located()), separate_channels=True).parts
    if len(parts) != count:
        raise ValueError(f"{len(parts)} of {count} parts can be read")
    pixels = {part.name(): {name: np.asarray(one.pixels) for name, one in part.channels.items()} for part in parts}
    return pixels, dict(parts[0].header)


def _parts(stream: IO[bytes], several: bool) -> list[_Part]:
    parts: list[_Part] = []
    while (header := _header(stream)) or not parts:
        if len(parts) == _MOST_PARTS:
            raise ValueError(f"more than {_MOST_PARTS} parts")
        parts.append(_part(header))
        if not several:
            break
    return parts


def _header(stream: IO[bytes]) -> dict[bytes, bytes]:
    """Attributes of a part; empty after the last one."""
    found = {}
    while name := _name(stream):
        kind = _name(stream)
        (size,) = _unpack(stream, "<i")
        found[name] = _read(stream, size)
        if kind != _KINDS.get(name, kind):  # the library would not know it, and take another value
            raise ValueError("its header is damaged")
    return found


def _part(header: dict[bytes, bytes]) -> _Part:
    try:
        left, top, right, bottom = struct.unpack("<4i", header[b"dataWindow"])
        lines = _LINES[header[b"compression"][0]]
        sample_bytes = _pixel_bytes(header[b"channels"])
    except (KeyError, IndexError, struct.error) as error:
        raise ValueError("its header is damaged, or of another compression than forestgen's") from error
    width, height = right - left + 1, bottom - top + 1
    count = struct.pack("<i", min(max(0, -(-height // lines)), 2**31 - 1))
    if header.get(b"chunkCount", count) != count:
        raise ValueError("its header is damaged")
    if header.get(b"type", b"scanlineimage").rstrip(b"\0") != b"scanlineimage":
        raise ValueError("a part does not consist of scan lines")
    if not (0 < width <= _MOST_SIDE_PX and 0 < height <= _MOST_SIDE_PX):
        raise ValueError(f"{width:,} x {height:,} pixels, at most {_MOST_SIDE_PX:,} a side")
    return _Part(lines, top, height, width * sample_bytes)


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


def _check_block(stream: IO[bytes], offset: int, part: _Part, block: int, number: int | None, unpack: bool) -> None:
    """One block of lines: it is where the table says, of this part and line, and can be unpacked."""
    stream.seek(min(offset, 2**62))
    leader = _unpack(stream, "<ii" if number is None else "<iii")
    size, whole = leader[-1], part.block_bytes(block)
    if leader[:-1] != (*(() if number is None else (number,)), part.first + block * part.lines) or size > whole:
        raise ValueError("a block of lines is damaged")
    content = _read(stream, size)
    if not unpack or size == whole:  # not compressed: it would not have become shorter
        return
    unpacker = zlib.decompressobj()
    try:
        is_whole = len(unpacker.decompress(content, whole + 1)) == whole and unpacker.eof
    except zlib.error:
        is_whole = False
    if not is_whole:
        raise ValueError("a block of lines cannot be unpacked")


def _name(stream: IO[bytes]) -> bytes:
    found = bytearray()
    while (one := _read(stream, 1)) != b"\0":
        found += one
        if len(found) > _MOST_NAME:
            raise ValueError("its header is damaged")
    return bytes(found)


def _unpack(stream: IO[bytes], form: str) -> tuple[Any, ...]:
    return struct.unpack(form, _read(stream, struct.calcsize(form)))


def _read(stream: IO[bytes], size: int) -> bytes:
    content = stream.read(size) if size >= 0 else b""
    if len(content) != size:
        raise ValueError("the file is cut short")
    return content
