"""Which frame follows which along a camera's path."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from forestgen.dataset.check.files import read_json
from forestgen.dataset.check.finding import UnreadableError
from forestgen.dataset.check.frame_data import CAMERA

UNKNOWN = "?"


def following_frames(root: Path, frames: Sequence[str]) -> dict[str, str]:
    """Frame -> the sequence's next, for frames whose camera.json names a sequence; by image, then by time.

    Where a camera.json of an image cannot be read, what follows the others that seem last is `UNKNOWN`, and so is what
    follows a frame whose neighbour by number is not there.
    """
    members: dict[tuple[str, str], list[tuple[float, str]]] = {}
    unsure: set[str] = set()
    for frame in frames:
        image = frame.partition("-")[0]
        try:
            sequence, time_s = _place(root, frame)
        except (UnreadableError, AttributeError, TypeError, ValueError):
            unsure.add(image)
            continue
        if sequence is not None:
            members.setdefault((image, sequence), []).append((time_s, frame))
    following = {frame: UNKNOWN for frame in frames if frame.partition("-")[0] in unsure}
    for way in members.values():
        pairs = pairwise(name for _, name in sorted(way))
        following |= {one: UNKNOWN if _is_gap(one, other) else other for one, other in pairs}
    return following


def _is_gap(one: str, other: str) -> bool:
    """Whether numbers are left out between two frames' names, NAME-0000, NAME-0001, ..."""
    numbers = [name.rpartition("-")[2] for name in (one, other)]
    return all(map(str.isdecimal, numbers)) and int(numbers[1]) != int(numbers[0]) + 1


def _place(root: Path, frame: str) -> tuple[str | None, float]:
    """The sequence and the time that camera.json tells; (None, 0) for a still camera."""
    camera: Any = read_json(root, f"{frame}/{CAMERA}")
    sequence = camera.get("sequence")
    return (None, 0.0) if sequence is None else (str(sequence), float(camera.get("time_s", 0.0)))
