"""A column of the index as a part of the page: a histogram or a list of shares; a fact where all values are one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from forestgen.dataset.report.charts import Chart, histogram, shares, short
from forestgen.dataset.report.frames import Frames
from forestgen.dataset.report.layout import Fact, ShareList

_MOST_NAMES = 12  # in a list of shares
_UNITS = {"deg": "degrees", "m": "m", "px": "px", "s": "s", "mm": "mm", "yr": "years", "k": "K", "c": "°C"}


def numbers(
    frames: Frames,
    column: str,
    title: str,
    axis: str,
    *,
    unit: str = "",
    log: bool = False,
    factor: float = 1.0,
    note: str = "",
) -> Chart | Fact | None:
    """A histogram of a column's numbers, times `factor`.

    Parameters
    ----------
    axis : what stands below it.
    unit : of a lone value.
    """
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
