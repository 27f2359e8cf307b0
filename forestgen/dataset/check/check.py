"""What a check is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.merged import Merged


@dataclass(frozen=True)
class FrameCheck:
    """An invariant of one image."""

    name: str
    holds: str  # what is true if it passes, for people
    file: str  # that it is about, inside the frame's folder or, if `shared`, in the data set's
    applies: Callable[[FrameData], bool]  # whether the files that it reads are there
    find: Callable[[FrameData], Iterator[Finding]]
    shared: bool = False


@dataclass(frozen=True)
class DatasetCheck:
    """An invariant of the files over all images."""

    name: str
    holds: str
    file: str
    applies: Callable[[Merged], bool]
    find: Callable[[Merged], Iterator[Finding]]


def always(_: object) -> bool:
    """Of checks whose files are in every data set."""
    return True
