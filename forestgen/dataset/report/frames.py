"""The columns of an index: what is missing is unknown, not an error. Charts, lists and correlations of columns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from forestgen.dataset.index import open_table
from forestgen.dataset.report.charts import Chart, Fact, ShareList, histogram, shares, short

_NEEDED = ("frame", "split", "image")
_NUMERIC = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean)
_MOST_NAMES = 12  # in a list of shares
_UNITS = {"deg": "degrees", "m": "m", "px": "px", "s": "s", "mm": "mm", "yr": "years", "k": "K", "c": "°C"}
_MEASURES = ("plants_in_view", "depth_median_m", "sky_share", "sunlit_share", "instance_pixels_median")
_LEAST_RANK = 0.3  # rank correlation that is reported
_LEAST_IMAGES = 20
_ERRORS = 4.0  # standard errors of a correlation of independent values, 1 / sqrt(n - 1)
_MOST_COLUMNS, _MOST_PAIRS = 60, 12


class Frames:
    """The rows of a data set's index, a frame each, read by column."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def __len__(self) -> int:
        return int(self._table.num_rows)

    @property
    def names(self) -> list[str]:
        """Of the columns."""
        return [str(name) for name in self._table.column_names]

    def is_number(self, name: str) -> bool:
        """Whether a column holds numbers, or true and false."""
        return name in self.names and any(test(self._table.column(name).type) for test in _NUMERIC)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """(N,) of a column; NaN where a frame has none."""
        if not self.is_number(name):
            return np.full(len(self), np.nan)
        column = self._table.column(name).cast(pa.float64(), safe=False).combine_chunks()
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)

    def texts(self, name: str) -> list[str]:
        """(N,) of a column; "" where a frame has none."""
        return ["" if one is None else str(one) for one in self.values(name)]

    def values(self, name: str) -> list[Any]:
        """(N,) of a column as Python has them; None where a frame has none."""
        return list(self._table.column(name).to_pylist()) if name in self.names else [None] * len(self)

    def counts(self, name: str) -> list[dict[str, int] | None]:
        """(N,) of a column of maps: name -> count."""
        return [
            None if one is None else {key: int(value) for key, value in dict(one).items() if value is not None}
            for one in self.values(name)
        ]

    @cached_property
    def split(self) -> list[str]:
        """(N,) of each frame."""
        return self.texts("split")

    @property
    def images(self) -> int:
        """How many different images the frames are of."""
        return len(set(self.values("image")))


def read_frames(path: Path) -> Frames:
    """Read an index; one that cannot be read, or is none of ours, raises `DatasetError`."""
    return Frames(open_table(path, _NEEDED))


def no_frames() -> Frames:
    """Of a run that has not ended."""
    return Frames(pa.table({name: pa.array([], pa.string()) for name in _NEEDED}))


def numbers(
    frames: Frames, column: str, title: str, axis: str, *,
    unit: str = "", log: bool = False, factor: float = 1.0, note: str = "",
) -> Chart | Fact | None:  # fmt: skip
    """A histogram of a column's numbers, times `factor`, above the text `axis`; a lone value, in `unit`, as a fact."""
    values = factor * frames.numbers(column)
    known = np.unique(values[np.isfinite(values)])
    if len(known) == 1:
        return Fact(f"{short(known[0])}{'' if unit in ('', '%', '°') else ' '}{unit}", title)
    return histogram(values, title, axis, log=log, note=note)


def names(frames: Frames, column: str, title: str, note: str = "") -> ShareList | Fact | None:
    """How many frames have which text."""
    return named([one for one in frames.texts(column) if one], title, note)


def named(values: Sequence[str], title: str, note: str = "") -> ShareList | Fact | None:
    """How often each text occurs; the rarest ones in one row."""
    counts = sorted(Counter(values).items(), key=lambda one: (-one[1], one[0]))
    if len(counts) < 2:
        return Fact(counts[0][0], title) if counts else None
    if len(counts) > _MOST_NAMES:
        rest = counts[_MOST_NAMES - 1 :]
        counts = [*counts[: _MOST_NAMES - 1], (f"{len(rest):,} others", sum(count for _, count in rest))]
    texts, frequencies = zip(*counts, strict=True)
    return ShareList(title, shares(texts, frequencies), note or "share of the frames · frames")


def unit_of(key: str) -> str:
    """The unit that a recipe's key ends with, or "" if it names none: position_m.0 is in metres."""
    words = [part for part in key.split(".") if not part.isdecimal()]
    return _UNITS.get(words[-1].rpartition("_")[2], "") if words and "_" in words[-1] else ""


class Correlation(NamedTuple):
    """A pair of columns: a hint at a shortcut that a model may take."""

    first: str
    second: str
    rank: float  # Spearman's correlation, -1 to 1


def correlations(frames: Frames, drawn: Sequence[str]) -> list[Correlation]:
    """The strongest correlations of drawn columns with each other and with the frames' measures, the strongest first.

    Every image counts once, by its first frame; an unknown value counts as the median.
    """
    _, first = np.unique(frames.numbers("image"), return_index=True)
    least = max(_LEAST_RANK, _ERRORS / math.sqrt(max(len(first) - 1, 1)))
    if len(first) < _LEAST_IMAGES:
        return []
    ranks = {}
    for name in [*drawn[:_MOST_COLUMNS], *_MEASURES]:
        column = frames.numbers(name)[first]
        known = column[np.isfinite(column)]
        if len(known) > len(column) / 2 and known.min() < known.max():
            ranks[name] = standard_ranks(np.where(np.isfinite(column), column, np.median(known)))
    pairs = [(a, b) for a, b in combinations(ranks, 2) if not (a in _MEASURES and b in _MEASURES)]
    found = [Correlation(a, b, float(ranks[a] @ ranks[b])) for a, b in pairs]
    strong = [one for one in found if abs(one.rank) >= least]
    return sorted(strong, key=lambda one: (-round(abs(one.rank), 3), one.first, one.second))[:_MOST_PAIRS]


def standard_ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks, ties sharing their mean, of mean 0 and length 1, so that a product of two is their correlation."""
    from scipy.stats import rankdata

    ranks = rankdata(values)
    ranks = ranks - ranks.mean()
    return np.asarray(ranks / np.linalg.norm(ranks), dtype=np.float64)
