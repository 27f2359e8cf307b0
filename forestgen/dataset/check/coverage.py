"""Coverage ranks: shares of a pixel's samples, largest first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forestgen.dataset.check.finding import Finding
from forestgen.dataset.check.frame_data import EXR, FrameData
from forestgen.dataset.check.pixels import wrong_pixels

_SUM_TOLERANCE = 1e-6


def has_coverage(frame: FrameData) -> bool:
    return frame.has_part("coverage", "rank0.id", "rank0.coverage")


def coverage(frame: FrameData) -> Iterator[Finding]:
    """Each share lies in (0, 1], they fall, sum to 1 (up to 1 where ranks ran out), and rank 0 is the instance."""
    ids, share = frame.ranks
    total = share.sum(axis=-1, dtype=np.float64)
    outside = np.any(~((share >= 0) & (share <= 1)), axis=-1)
    yield from wrong_pixels(frame, EXR, outside, "a coverage lies outside 0 to 1", "0 to 1", share)
    rises = np.any(~(share[..., 1:] <= share[..., :-1]), axis=-1)
    yield from wrong_pixels(frame, EXR, rises, "coverages do not fall from rank to rank", "falling", share)
    yield from wrong_pixels(frame, EXR, ~(total <= 1 + _SUM_TOLERANCE), "coverages sum to more than 1", "1", total)
    open_rank = share[..., -1] == 0
    yield from wrong_pixels(
        frame,
        EXR,
        open_rank & ~(np.abs(total - 1) <= _SUM_TOLERANCE),
        "coverages do not sum to 1 though ranks are free",
        f"1 ± {_SUM_TOLERANCE:g}",
        total,
    )
    first = ids[..., 0]
    problem = "rank 0 is not the instance mask's plant"
    yield from wrong_pixels(frame, EXR, first != frame.instance, problem, frame.instance, first)
    nameless = np.any((share == 0) & (ids != 0), axis=-1)
    yield from wrong_pixels(frame, EXR, nameless, "a rank without coverage names a plant", "0", ids)
    yield from _ties_and_repeats(frame)


def _ties_and_repeats(frame: FrameData) -> Iterator[Finding]:
    """Equal coverages stand by rising id; no id stands twice."""
    ids, share = frame.ranks
    filled = share[..., 1:] > 0
    tied = filled & (share[..., 1:] == share[..., :-1])
    unsorted = np.any(tied & (ids[..., 1:] <= ids[..., :-1]), axis=-1)
    yield from wrong_pixels(frame, EXR, unsorted, "equal coverages are not in the order of ids", "rising ids", ids)
    repeated = np.zeros(frame.instance.shape, dtype=bool)
    for rank in range(1, ids.shape[-1]):
        again = (ids[..., :rank] == ids[..., rank : rank + 1]).any(axis=-1)
        repeated |= again & (share[..., rank] > 0)
    yield from wrong_pixels(frame, EXR, repeated, "an id has two ranks", "each id once", ids)
