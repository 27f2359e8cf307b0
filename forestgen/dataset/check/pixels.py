"""Findings of a picture: of each plant the first wrong pixel and how many there are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.finding import Finding, numbers
from forestgen.dataset.check.frame_data import FrameData


def wrong_pixels(
    frame: FrameData,
    file: str,
    wrong: NDArray[np.bool_],
    problem: str,
    expected: NDArray[Any] | str = "",
    got: NDArray[Any] | str = "",
) -> Iterator[Finding]:
    """A finding for each plant of the mask that has true pixels in `wrong` (H, W), with the values at the first."""
    for x, y, count in first_of_each(wrong, frame.instance):
        more = f" ({count:,} such pixels)" if count > 1 else ""
        yield frame.finding(
            file,
            problem + more,
            expected=expected if isinstance(expected, str) else numbers(expected[y, x]),
            got=got if isinstance(got, str) else numbers(got[y, x]),
            pixel=(x, y),
            plant_id=int(frame.instance[y, x]) or None,
        )


def first_of_each(wrong: NDArray[np.bool_], ids: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """x, y of the first true pixel of each id, and how many it has; row by row."""
    if not wrong.any():
        return []
    at = np.flatnonzero(wrong)
    _, first, counts = np.unique(ids.ravel()[at], return_index=True, return_counts=True)
    order = np.argsort(first)
    places = at[first[order]].tolist()
    return [
        (place % wrong.shape[1], place // wrong.shape[1], int(n))
        for place, n in zip(places, counts[order], strict=True)
    ]
