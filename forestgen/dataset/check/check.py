"""What a check is, and how it reports wrong pixels and wrong rows of plants.parquet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, numbers
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.merged import Merged


class Wrong(NamedTuple):
    """Pixels of a frame or rows of its plants.parquet that are wrong: the values are reported where `at` is true."""

    at: Any  # bool: (H, W) pixels, or (N,) rows
    problem: str  # one sentence
    expected: NDArray[Any] | str = ""  # (H, W, ...) or (N, ...), or a text for all
    got: NDArray[Any] | str = ""
    file: str = ""  # of the frame's folder; "": the check's

    def texts(self, place: Any) -> tuple[str, str]:
        """What was expected and found at an index of `at`."""
        expected, got = (one if isinstance(one, str) else numbers(one[place]) for one in (self.expected, self.got))
        return expected, got


@dataclass(frozen=True)
class FrameCheck:
    """An invariant of one image."""

    name: str
    holds: str  # what is true if it passes, for people
    file: str  # that it is about, inside the frame's folder or, if `shared`, in the data set's
    applies: Callable[[FrameData], bool]  # whether the files that it reads are there
    find: Callable[[FrameData], Iterator[Finding | Wrong]]
    shared: bool = False

    def findings(self, frame: FrameData) -> Iterator[Finding]:
        """One for each wrong row; of wrong pixels one for each plant of the mask, at the first of them."""
        for one in self.find(frame):
            if isinstance(one, Finding):
                yield one
                continue
            file = one.file or self.file
            if one.at.ndim == 1:
                for row in np.flatnonzero(one.at).tolist():
                    expected, got = one.texts(row)
                    plant = int(frame.plants["plant_id"][row])
                    yield frame.finding(file, one.problem, expected=expected, got=got, plant_id=plant)
                continue
            for x, y, count in first_of_each(one.at, frame.instance):
                more = f" ({count:,} such pixels)" if count > 1 else ""
                expected, got = one.texts((y, x))
                plant_id = int(frame.instance[y, x]) or None
                about = {"expected": expected, "got": got, "pixel": (x, y), "plant_id": plant_id}
                yield frame.finding(file, one.problem + more, **about)


@dataclass(frozen=True)
class DatasetCheck:
    """An invariant of the files over all images."""

    name: str
    holds: str
    file: str
    applies: Callable[[Merged], bool]
    find: Callable[[Merged], Iterator[Finding]]


def frame_check(
    name: str,
    holds: str,
    file: str,
    *,
    files: Sequence[str] = (),
    exr: Sequence[str] = (),
    columns: Sequence[str] = (),
    share: str = "",
    when: Callable[[FrameData], bool] | None = None,
    shared: bool = False,
) -> Callable[[Callable[[FrameData], Iterator[Finding | Wrong]]], FrameCheck]:
    """Turn a function into a `FrameCheck` of frames that have all it needs.

    Parameters
    ----------
    files : of the frame's folder.
    exr : parts of frame.exr with their channels, such as "depth Z".
    columns : of plants.parquet.
    share : a format, whose merged files hold something of the frame.
    when : a further condition.
    """

    def applies(frame: FrameData) -> bool:
        return (
            (not share or share in frame.task.shared)
            and all(map(frame.has, files))
            and all(frame.has_part(*one.split()) for one in exr)
            and all(map(frame.known, columns))
            and (when is None or when(frame))
        )

    return lambda find: FrameCheck(name, holds, file, applies, find, shared)


def dataset_check(
    name: str, holds: str, file: str, when: Callable[[Merged], bool] | None = None
) -> Callable[[Callable[[Merged], Iterator[Finding]]], DatasetCheck]:
    """Turn a function into a `DatasetCheck` of data sets that have `file`, or for which `when` is true."""
    return lambda find: DatasetCheck(name, holds, file, when or (lambda merged: merged.has(file)), find)


def first_of_each(wrong: NDArray[np.bool_], ids: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """x, y of the first true pixel of each id, and how many it has; row by row."""
    at = np.flatnonzero(wrong)
    _, first, counts = np.unique(ids.ravel()[at], return_index=True, return_counts=True)
    order = np.argsort(first)
    y, x = np.divmod(at[first[order]], wrong.shape[1])
    return list(zip(x.tolist(), y.tolist(), counts[order].tolist(), strict=True))
