"""The data set to pack: its splits, the frames that its index.parquet lists, and the channels that are packed of each.

A channel is a file of the frame's folder, byte for byte as it lies there, or an array of frame.exr as a .npy file.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from forestgen.core.errors import DatasetError, RecipeError
from forestgen.core.randomness import child_rng
from forestgen.dataset.exr_chunks import read_whole
from forestgen.dataset.formats.depth_png import SCALE_NAME
from forestgen.dataset.formats.format import json_text
from forestgen.dataset.index import INDEX_NAME, plain_rows, whole_index
from forestgen.dataset.png import LEGEND_NAME, read_legend
from forestgen.dataset.safe_path import SafePath, read_object, reading

_LAST_FILE = "dataset.json"  # that a run writes
_EXR_FILE, _CAMERA_FILE = "frame.exr", "camera.json"
# How a whole file of a kind begins and ends.
_ENDS = {
    "png": (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"),
    "json": (b"{", b"}\n"),
    "parquet": (b"PAR1", b"PAR1"),
    "exr": (b"\x76\x2f\x31\x01", b""),
}


@dataclass(frozen=True)
class Channel:
    """Something that each frame has."""

    name: str
    file: str  # of the frame's folder
    extension: str  # in a shard of WebDataset, behind the frame's name and a dot
    column: str  # in a Parquet file
    kind: Literal["picture", "objects", "bytes"] = "bytes"  # of the column
    part: str = ""  # of frame.exr, if it is an array
    layers: tuple[str, ...] = ()  # of that part


def _picture(name: str, column: str | None = None) -> Channel:
    return Channel(name, f"{name}.png", f"{name}.png", column or name, "picture")


def _array(name: str, part: str, *layers: str) -> Channel:
    return Channel(name, _EXR_FILE, f"{name}.npy", name, "bytes", part, layers)


_ALL = (
    _picture("preview", "image"),
    *map(_picture, ("semantic", "instance", "depth", "overlay", "raw")),
    Channel("annotations", "annotations.json", "annotations.json", "objects", "objects"),
    Channel("plants", "plants.parquet", "plants.parquet", "plants_parquet"),
    Channel("exr", _EXR_FILE, "exr", "exr"),
    _array("depth_m", "depth", "Z"),
    _array("normal", "normal", *"XYZ"),
    _array("albedo", "albedo", *"RGB"),
    _array("motion", "motion", "forward.u", "forward.v"),
    _array("radiance", "radiance", *"RGB"),
)
CHANNELS = {channel.name: channel for channel in _ALL}
_DEFAULT = ("preview", "semantic", "instance", "depth", "annotations")  # those of them that the data set has


@dataclass(frozen=True)
class Split:
    """A part of the data set."""

    name: str
    folder: SafePath
    frames: tuple[str, ...]  # names of the frames' folders, sorted


@dataclass(frozen=True)
class Source:
    """A data set that was found to be one."""

    root: Path
    splits: tuple[Split, ...]
    classes: Mapping[str, Any]  # classes.json, the same in all splits
    index: Any  # pyarrow.Table of index.parquet, a few hundred bytes a frame
    row_numbers: Mapping[str, int]  # frame -> row of the index

    @property
    def folders(self) -> list[SafePath]:
        """Of all frames."""
        return [split.folder / frame for split in self.splits for frame in split.frames]

    def pixels(self, folder: SafePath) -> int:
        """How many a frame has."""
        row = self.row_numbers[folder.name.rpartition("/")[2]]
        return int(self.index["width_px"][row].as_py() * self.index["height_px"][row].as_py())


@dataclass(frozen=True)
class Sample:
    """A frame."""

    name: str
    contents: Mapping[str, bytes]  # by channel
    row: Mapping[str, Any]  # of the index
    camera: Mapping[str, Any]  # camera.json
    depth_unit_m: float | None  # metres of a step of the channel depth; None where it is not packed


def open_source(root: Path, splits: Sequence[str] = ()) -> Source:
    """Look at a data set before it is packed.

    Parameters
    ----------
    root : its folder, which `Dataset` has checked.
    splits : those to pack, by default all.

    Raises
    ------
    DatasetError : a file of it is missing or damaged.
    RecipeError : the data set has no such split.
    """
    index = whole_index(root / INDEX_NAME)
    names = list(zip(index["split"].to_pylist(), index["frame"].to_pylist(), strict=True))
    listed = read_object(SafePath(root, _LAST_FILE)).get("splits")
    order = list(listed) if isinstance(listed, dict) else []  # the recipe's
    frames: dict[str, list[str]] = {}
    for split, frame in names:
        frames.setdefault(split, []).append(frame)
    for name in splits:
        if name not in frames:
            expected = "of " + ", ".join(sorted(frames))
            raise RecipeError("the data set has no such split", parameter="splits", expected=expected, got=name)
    chosen = sorted(set(splits) or frames, key=lambda name: (order.index(name) if name in order else len(order), name))
    found = tuple(Split(name, SafePath(root, name), tuple(sorted(frames[name]))) for name in chosen)
    if not found:
        raise DatasetError("the data set has no frame", where=str(root))
    numbers = {frame: number for number, (_, frame) in enumerate(names)}
    classes = read_legend(found[0].folder)
    for other in found[1:]:
        path = other.folder / LEGEND_NAME
        if read_object(path) != classes:
            texts = {"expected": f"the same as in {found[0].name}", "hint": "pack them one by one, with `splits`"}
            raise DatasetError("splits differ in the numbers of their classes", where=str(path), **texts)
    return Source(root, found, classes, index, numbers)


def choose_channels(folders: Sequence[SafePath], wanted: Sequence[str] | None) -> tuple[Channel, ...]:
    """The channels to pack, in their own order.

    Parameters
    ----------
    folders : of all frames; the first decides which channels there are to name.
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
    exr = _read_exr(folder / _EXR_FILE) if needs_exr and (folder / _EXR_FILE).is_file() else {}
    for name in wanted:
        channel = CHANNELS.get(name)
        # A file that the first frame alone lacks is missing; arrays are judged by the first frame alone.
        others = () if channel is None or channel.part else folders[1:]
        if channel is None or not (_has(folder, channel, exr) or any((one / channel.file).is_file() for one in others)):
            exr = exr or _read_exr(folder / _EXR_FILE)
            known = [one for one in CHANNELS if _has(folder, CHANNELS[one], exr)]
            hint = "take depth_m, or make the data set with dataset.formats: [depth_png]" if name == "depth" else None
            problem = "the data set has no such channel" if name in CHANNELS else "there is no such channel"
            expected = "of " + ", ".join(known)
            raise RecipeError(problem, parameter="channels", expected=expected, got=name, hint=hint)
    return tuple(channel for name, channel in CHANNELS.items() if name in wanted)


def _has(folder: SafePath, channel: Channel, exr: Mapping[str, Mapping[str, Any]]) -> bool:
    there = (folder / channel.file).is_file()
    return there and (not channel.part or all(one in exr.get(channel.part, {}) for one in channel.layers))


def measure_frame(folder: SafePath, channels: Sequence[Channel], pixels: int) -> int:
    """Bytes that a frame's channels take; a file that is missing raises `DatasetError`."""
    total = 0
    for channel in channels:
        with reading(folder / channel.file) as path:
            size_bytes = path.size_bytes()
        total += 128 + 4 * pixels * len(channel.layers) if channel.part else size_bytes
    return total


def in_order(split: Split, seed: int | None) -> Sequence[str]:
    """The split's frames in a random order of that seed, or by name where there is none.

    A shard is read from front to back: in order of names it would hold the cameras of one scene after another.
    """
    if seed is None:
        return split.frames
    order = child_rng(seed, "pack", split.name).permutation(len(split.frames))
    return [split.frames[number] for number in order.tolist()]


def read_samples(
    source: Source, split: Split, frames: Sequence[str], channels: Sequence[Channel], advance: Callable[[int], None]
) -> Iterator[Sample]:
    """The frames, in that order, one in memory at a time; what is missing or damaged raises `DatasetError`."""
    for frame in frames:
        folder = split.folder / frame
        exr = _read_exr(folder / _EXR_FILE) if any(channel.part for channel in channels) else {}
        contents = {one.name: _npy(folder, one, exr) if one.part else _whole(folder / one.file) for one in channels}
        unit_m = _depth_unit_m(folder) if "depth" in contents else None
        row = plain_rows(source.index.slice(source.row_numbers[frame], 1), source.root / INDEX_NAME)[0]
        camera = read_object(folder / _CAMERA_FILE)
        try:
            json_text([row, camera])
        except (TypeError, ValueError) as error:  # a date, or a number that is none: a stranger's column
            got = f"{type(error).__name__}: {error}"[:200]
            raise DatasetError("the frame's row of the index is no JSON", where=str(folder), got=got) from error
        yield Sample(frame, contents, row, camera, unit_m)
        advance(1)


def _depth_unit_m(folder: SafePath) -> float:
    unit_m = read_object(folder / SCALE_NAME).get("unit_m")
    if not isinstance(unit_m, float):
        where = str(folder / SCALE_NAME)
        raise DatasetError("a file is not what its name says", where=where, expected="unit_m: metres")
    return unit_m


def _npy(folder: SafePath, channel: Channel, exr: Mapping[str, Mapping[str, Any]]) -> bytes:
    """(H, W) or (H, W, C) float32 of frame.exr."""
    part = exr.get(channel.part, {})
    if not all(layer in part for layer in channel.layers):
        hint = "frames differ in what they hold: leave the channel out"
        raise DatasetError(f"a frame lacks the channel {channel.name}", where=str(folder / channel.file), hint=hint)
    layers = [part[layer] for layer in channel.layers]
    buffer = io.BytesIO()
    np.save(buffer, layers[0] if len(layers) == 1 else np.stack(layers, axis=-1))
    return buffer.getvalue()


def _whole(path: SafePath) -> bytes:
    with reading(path):
        content = path.read()
        head, tail = _ENDS[path.name.rpartition(".")[2]]
        if not (content.startswith(head) and content.endswith(tail)):
            raise ValueError("it is cut short or damaged")
        return content


def _read_exr(path: SafePath) -> dict[str, dict[str, Any]]:
    with reading(path):
        return read_whole(path)[0]
