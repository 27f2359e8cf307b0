"""An offence of a picture: the first wrong pixel and how many there are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.offence import Offence, first_pixel, numbers


def wrong_pixels(
    frame: FrameData,
    file: str,
    wrong: NDArray[np.bool_],
    problem: str,
    expected: NDArray[Any] | str = "",
    got: NDArray[Any] | str = "",
) -> Iterator[Offence]:
    """One offence for all true pixels of `wrong` (H, W), with the values at the first; none where all are false."""
    at = first_pixel(wrong)
    if at is None:
        return
    x, y = at
    count = int(wrong.sum())
    more = f" ({count:,} such pixels)" if count > 1 else ""
    plant = int(frame.instance[y, x])
    yield frame.offence(
        file,
        problem + more,
        expected=expected if isinstance(expected, str) else numbers(expected[y, x]),
        got=got if isinstance(got, str) else numbers(got[y, x]),
        pixel=at,
        plant_id=plant or None,
    )
