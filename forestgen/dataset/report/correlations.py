"""Which draws go together, and with which of the frames' measures: a hint at shortcuts that a model may take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.report.frames import Frames

MEASURES = ("plants_in_view", "depth_median_m", "sky_share", "sunlit_share", "instance_pixels_median")
LEAST = 0.3  # rank correlation worth a word
_LEAST_IMAGES = 20
_ERRORS = 4.0  # standard errors of a correlation of independent values, 1 / sqrt(n - 1)
_MOST_COLUMNS, _MOST_PAIRS = 60, 12


@dataclass(frozen=True)
class Hint:
    """A pair of columns."""

    first: str
    second: str
    rank: float  # Spearman's correlation, -1 to 1


def hints(frames: Frames, drawn: Sequence[str]) -> list[Hint]:
    """The strongest correlations of the drawn columns with each other and with `MEASURES`, the strongest first.

    Every image counts once, by its first frame; an unknown value counts as the median.
    """
    _, first = np.unique(frames.numbers("image"), return_index=True)
    least = max(LEAST, _ERRORS / math.sqrt(max(len(first) - 1, 1)))
    if len(first) < _LEAST_IMAGES:
        return []
    ranks = {}
    for name in [*drawn[:_MOST_COLUMNS], *MEASURES]:
        column = frames.numbers(name)[first]
        known = column[np.isfinite(column)]
        if len(known) > len(column) / 2 and known.min() < known.max():
            ranks[name] = _standard_ranks(np.where(np.isfinite(column), column, np.median(known)))
    found = [
        Hint(a, b, float(ranks[a] @ ranks[b]))
        for a, b in combinations(ranks, 2)
        if not (a in MEASURES and b in MEASURES)
    ]
    strong = [one for one in found if abs(one.rank) >= least]
    return sorted(strong, key=lambda one: (-round(abs(one.rank), 3), one.first, one.second))[:_MOST_PAIRS]


def _standard_ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks, ties sharing their mean, of mean 0 and length 1, so that a product of two is their correlation."""
    _, place, ties = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(ties)  # rank of the last one of each group of equals
    ranks = (last - (ties - 1) / 2)[place]
    ranks = ranks - ranks.mean()
    return np.asarray(ranks / np.linalg.norm(ranks), dtype=np.float64)
