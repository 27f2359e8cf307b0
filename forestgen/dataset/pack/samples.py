"""Frames on their way into a pack, one in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from forestgen.core.errors import DatasetError
from forestgen.core.randomness import child_rng
from forestgen.dataset.formats.depth_png import SCALE_NAME
from forestgen.dataset.formats.shards import json_text
from forestgen.dataset.pack.channels import CAMERA_FILE, Channel, measure_frame, read_channels, read_json
from forestgen.dataset.pack.source import Source, Split
from forestgen.dataset.safe_path import SafePath


@dataclass(frozen=True)
class Sample:
    """A frame."""

    name: str
    contents: Mapping[str, bytes]  # by channel
    row: Mapping[str, Any]  # of the index
    camera: Mapping[str, Any]  # camera.json
    depth_unit_m: float | None  # metres of a step of the channel depth; None where it is not packed


@dataclass(frozen=True)
class Shard:
    """A file of a pack."""

    name: str
    frames: int
    size_bytes: int


def in_order(split: Split, seed: int | None) -> Sequence[str]:
    """The split's frames in a random order of that seed, or by name where there is none.

    A shard is read from front to back: in order of names it would hold the cameras of one scene after another.
    """
    if seed is None:
        return split.frames
    order = child_rng(seed, "pack", split.name).permutation(len(split.frames))
    return [split.frames[number] for number in order.tolist()]


def measure(source: Source, channels: Sequence[Channel], advance: Callable[[int], None]) -> int:
    """Bytes of all frames' channels; a file that is missing raises `DatasetError`, before anything is written."""
    total = 0
    for split in source.splits:
        for frame in split.frames:
            total += measure_frame(split.folder / frame, channels)
            advance(1)
    return total


def read_samples(
    source: Source, split: Split, frames: Sequence[str], channels: Sequence[Channel], advance: Callable[[int], None]
) -> Iterator[Sample]:
    """The frames, in that order; what is missing or damaged raises `DatasetError`."""
    has_depth = any(channel.name == "depth" for channel in channels)
    for frame in frames:
        folder = split.folder / frame
        contents = read_channels(folder, channels)
        unit_m = _depth_unit_m(folder) if has_depth else None
        row, camera = source.row(frame), read_json(folder / CAMERA_FILE)
        try:
            json_text([row, camera])
        except (TypeError, ValueError) as error:  # a date, or a number that is none: a stranger's column
            got = f"{type(error).__name__}: {error}"[:200]
            raise DatasetError("the frame's row of the index is no JSON", where=str(folder), got=got) from error
        yield Sample(frame, contents, row, camera, unit_m)
        advance(1)


def _depth_unit_m(folder: SafePath) -> float:
    unit_m = read_json(folder / SCALE_NAME).get("unit_m")
    if isinstance(unit_m, bool) or not isinstance(unit_m, int | float):
        where = str(folder / SCALE_NAME)
        raise DatasetError("a file is not what its name says", where=where, expected="unit_m: metres")
    return float(unit_m)
