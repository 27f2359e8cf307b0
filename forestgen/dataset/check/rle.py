"""COCO's compressed run-length code, read from its definition, and checked before any library decodes it.

A code's characters carry 5 bits each, low first, from 48 on; bit 5 says that more follow, and the last one's bit 4 is
the sign. Numbers are lengths of runs of zeros and ones in turn, down the columns; from the fourth on they are told as
the difference to the number two before.

References
----------
maskApi.c of the COCO API: rleToString, rleFrString.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def run_lengths(code: Any, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(R,) lengths of runs of zeros and ones in turn.

    Raises
    ------
    ValueError
        When the code is none, or its runs do not fill an image of width and height `size_px`.
    """
    width, height = size_px
    if not isinstance(code, dict) or list(code.get("size", ())) != [height, width]:
        raise ValueError(f"the code's size is not [{height}, {width}]")
    text = code.get("counts")
    if not isinstance(text, str) or not text or not text.isascii():
        raise ValueError("the code's counts are no text")
    values = np.frombuffer(text.encode("ascii"), dtype=np.uint8).astype(np.int64) - 48
    if values.min() < 0 or values.max() > 63 or values[-1] & 0x20:
        raise ValueError("the code's counts are cut short or no code")
    last = np.flatnonzero((values & 0x20) == 0)
    first = np.concatenate([[0], last[:-1] + 1])
    place = np.arange(len(values)) - np.repeat(first, last - first + 1)
    if place.max() > 8:
        raise ValueError("a run of the code is longer than any image")
    number = np.add.reduceat((values & 0x1F) << (5 * place), first)
    negative = (values[last] & 0x10) != 0
    number -= np.where(negative, np.int64(1) << (5 * (place[last] + 1)), 0)
    counts = number.copy()
    counts[1::2] = np.cumsum(number[1::2])
    counts[2::2] = np.cumsum(number[2::2])
    if (counts < 0).any() or counts.sum() != width * height:
        raise ValueError("the code's runs do not fill the image")
    return counts


@dataclass(frozen=True)
class RunMask:
    """A decoded mask, held as its runs: an image of each would take most of the time."""

    begin: NDArray[np.int64]  # (R,) first pixel of each run of ones, counted down the columns
    end: NDArray[np.int64]  # (R,) one past its last
    size_px: tuple[int, int]
    library_area: int  # pixels and box x, y, width, height as pycocotools has them, which trainers use
    library_box: list[int]

    @property
    def area(self) -> int:
        return int((self.end - self.begin).sum())

    def window(self, x: int, y: int, w: int, h: int) -> NDArray[np.bool_]:
        """(h, w) part of the mask."""
        height = self.size_px[1]
        low, high = x * height, (x + w) * height
        begin, end = np.clip(self.begin, low, high) - low, np.clip(self.end, low, high) - low
        there = end > begin
        turns = np.zeros(w * height + 1, dtype=np.int8)
        turns[begin[there]] += 1
        turns[end[there]] -= 1
        inside = np.cumsum(turns[:-1], dtype=np.int8).reshape(w, height) > 0
        return np.asarray(inside.T[y : y + h])


def decode(code: Any, size_px: tuple[int, int]) -> RunMask:
    """Read a code of an image of width and height `size_px`; what is none raises `ValueError`."""
    import warnings

    from pycocotools import mask

    edges = np.concatenate([[0], np.cumsum(run_lengths(code, size_px))])
    filled = edges[1:-1:2] < edges[2::2]
    plain = {"size": code["size"], "counts": code["counts"].encode("ascii")}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its arrays are of NumPy 1's protocol
        area, box = int(mask.area(plain)), mask.toBbox(plain).astype(np.int64).tolist()
    return RunMask(edges[1:-1:2][filled], edges[2::2][filled], size_px, area, box)
