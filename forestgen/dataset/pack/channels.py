"""What of a frame can be packed.

A channel is a file of the frame's folder, byte for byte as it lies there, or an array of frame.exr as a .npy file.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from forestgen.core.errors import DatasetError, RecipeError
from forestgen.dataset.exr import read_exr
from forestgen.dataset.exr_chunks import check_chunks
from forestgen.dataset.safe_path import SafePath, load_json, unreadable

Kind = Literal["picture", "objects", "bytes"]
EXR_FILE, CAMERA_FILE = "frame.exr", "camera.json"
REMEDY = "forestgen verify finds what is damaged, the command that made the data set makes it again with `resume=True`"


@dataclass(frozen=True)
class Channel:
    """Something that each frame has."""

    name: str
    file: str  # of the frame's folder
    extension: str  # in a shard of WebDataset, behind the frame's name and a dot
    column: str  # in a Parquet file
    kind: Kind = "bytes"  # of the column
    part: str = ""  # of frame.exr, if it is an array
    layers: tuple[str, ...] = ()  # of that part


def _picture(name: str, column: str | None = None) -> Channel:
    return Channel(name, f"{name}.png", f"{name}.png", column or name, "picture")


def _array(name: str, part: str, *layers: str) -> Channel:
    return Channel(name, EXR_FILE, f"{name}.npy", name, "bytes", part, layers)


_ALL = (
    _picture("preview", "image"),
    _picture("semantic"),
    _picture("instance"),
    _picture("depth"),
    _picture("overlay"),
    _picture("raw"),
    Channel("annotations", "annotations.json", "annotations.json", "objects", "objects"),
    Channel("plants", "plants.parquet", "plants.parquet", "plants_parquet"),
    Channel("exr", EXR_FILE, "exr", "exr"),
    _array("depth_m", "depth", "Z"),
    _array("normal", "normal", "X", "Y", "Z"),
    _array("albedo", "albedo", "R", "G", "B"),
    _array("motion", "motion", "forward.u", "forward.v"),
    _array("radiance", "radiance", "R", "G", "B"),
)
CHANNELS = {channel.name: channel for channel in _ALL}
_DEFAULT = ("preview", "semantic", "instance", "depth", "annotations")  # those of them that the data set has


def choose_channels(folders: Sequence[SafePath], wanted: Sequence[str] | None) -> tuple[Channel, ...]:
    """The channels to pack, in their own order.

    Parameters
    ----------
    folders : of all frames; the first tells which channels there are to name.
    wanted : names; None: those of the usual ones that any frame has.

    Raises
    ------
    RecipeError : no channel has such a name, or the data set lacks it.
    """
    if wanted is None:
        usual = [CHANNELS[name] for name in _DEFAULT]
        return tuple(one for one in usual if any((folder / one.file).is_file() for folder in folders))
    if not wanted:
        raise RecipeError("no channel is named", parameter="channels", expected=", ".join(CHANNELS))
    folder = folders[0]
    # A part of frame.exr is looked for only where an array is asked for: to read the file takes a while.
    needs_exr = any(name not in CHANNELS or CHANNELS[name].part for name in wanted)
    exr = read_exr_file(folder / EXR_FILE) if needs_exr and (folder / EXR_FILE).is_file() else {}
    for name in wanted:
        if name not in CHANNELS or not (_has(folder, CHANNELS[name], exr) or _any_has(folders[1:], CHANNELS[name])):
            exr = exr or read_exr_file(folder / EXR_FILE)
            raise _no_such_channel(name, [one for one in CHANNELS if _has(folder, CHANNELS[one], exr)])
    return tuple(channel for name, channel in CHANNELS.items() if name in wanted)


def _has(folder: SafePath, channel: Channel, exr: Mapping[str, Mapping[str, Any]]) -> bool:
    there = (folder / channel.file).is_file()
    return there and (not channel.part or all(one in exr.get(channel.part, {}) for one in channel.layers))


def _any_has(folders: Sequence[SafePath], channel: Channel) -> bool:
    """Whether another frame has the file, so that the first one lacks it. Arrays are judged by the first alone."""
    return not channel.part and any((folder / channel.file).is_file() for folder in folders)


def _no_such_channel(name: str, known: Sequence[str]) -> RecipeError:
    hint = "take depth_m, or make the data set with dataset.formats: [depth_png]" if name == "depth" else None
    problem = "the data set has no such channel" if name in CHANNELS else "there is no such channel"
    return RecipeError(problem, parameter="channels", expected="of " + ", ".join(known), got=name, hint=hint)


def measure_frame(folder: SafePath, channels: Sequence[Channel]) -> int:
    """Bytes that a frame's channels take; a file that is missing raises `DatasetError`."""
    total = 0
    for channel in channels:
        total += _array_bytes(folder, channel) if channel.part else _size(folder / channel.file)
    return total


def _array_bytes(folder: SafePath, channel: Channel) -> int:
    _size(folder / channel.file)
    size_px = read_json(folder / CAMERA_FILE).get("size_px")
    if not isinstance(size_px, list) or len(size_px) != 2 or not all(type(side) is int for side in size_px):
        raise DatasetError("the camera has no size", where=str(folder / CAMERA_FILE), expected="size_px: [W, H]")
    return 128 + 4 * int(size_px[0]) * int(size_px[1]) * len(channel.layers)  # a header, and floats


def _size(path: SafePath) -> int:
    try:
        return path.size_bytes()
    except OSError as error:
        raise unreadable(path, error, REMEDY) from error


def read_channels(folder: SafePath, channels: Sequence[Channel]) -> dict[str, bytes]:
    """Channel -> bytes, of a frame.

    Raises
    ------
    DatasetError : a file is missing or cut short.
    """
    exr = read_exr_file(folder / EXR_FILE) if any(channel.part for channel in channels) else {}
    return {
        channel.name: _npy(folder, channel, exr) if channel.part else _whole(folder / channel.file)
        for channel in channels
    }


def _npy(folder: SafePath, channel: Channel, exr: Mapping[str, Mapping[str, Any]]) -> bytes:
    """(H, W) or (H, W, C) float32 of frame.exr."""
    part = exr.get(channel.part, {})
    if not all(layer in part for layer in channel.layers):
        raise DatasetError(
            f"a frame lacks the channel {channel.name}",
            where=str(folder / channel.file),
            hint="frames differ in what they hold: leave the channel out",
        )
    layers = [part[layer] for layer in channel.layers]
    buffer = io.BytesIO()
    np.save(buffer, layers[0] if len(layers) == 1 else np.stack(layers, axis=-1))
    return buffer.getvalue()


# How a whole file of a kind begins and ends.
_ENDS = {
    ".png": (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"),
    ".json": (b"{", b"}\n"),
    ".parquet": (b"PAR1", b"PAR1"),
    ".exr": (b"\x76\x2f\x31\x01", b""),
}


def _whole(path: SafePath) -> bytes:
    content = read_file(path)
    head, tail = _ENDS[f".{path.name.rpartition('.')[2]}"]
    if not (content.startswith(head) and content.endswith(tail)):
        raise DatasetError("a file is cut short or damaged", where=str(path), hint=REMEDY)
    return content


def read_exr_file(path: SafePath) -> dict[str, dict[str, Any]]:
    """`read_exr`, with its failures as `DatasetError`."""
    _size(path)
    try:
        with path.open() as stream:
            count = check_chunks(stream)
        parts = read_exr(path.located())
        if len(parts) != count:
            raise ValueError(f"{len(parts)} of {count} parts can be read")
        return parts
    except Exception as error:  # the library raises whatever its C++ threw
        raise DatasetError("a file is cut short or damaged", where=str(path), hint=REMEDY) from error


def read_file(path: SafePath) -> bytes:
    """A file's bytes; failures are `DatasetError`."""
    try:
        return path.read()
    except OSError as error:
        raise unreadable(path, error, REMEDY) from error


def read_json(path: SafePath) -> dict[str, Any]:
    """An object of JSON; what is none raises `DatasetError`."""
    try:
        content = load_json(read_file(path))
    except ValueError as error:
        raise DatasetError("a file is cut short or damaged", where=str(path), hint=REMEDY) from error
    if not isinstance(content, dict):
        raise DatasetError("a file is not what its name says", where=str(path), expected="a JSON object")
    return content
