"""Ranges side by side on one logarithmic axis: what most frames have, and what few have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.report.charts import Tick, log_axis, short

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
ROW, TOP = 34.0, 22.0  # height of a row, and what is above the first, in the viewBox


@dataclass(frozen=True)
class Range:
    """A row: five quantiles, in the viewBox."""

    name: str
    text: str
    y: float
    spots: tuple[float, ...]


@dataclass(frozen=True)
class Ranges:
    """The chart."""

    title: str
    summary: str
    x_title: str
    x_ticks: tuple[Tick, ...]
    rows: tuple[Range, ...]
    height: float
    note: str = ""


def ranges(values: Mapping[str, NDArray[np.float64]], title: str, x_title: str, unit: str) -> Ranges | None:
    """Quantiles of several quantities, each a row.

    Parameters
    ----------
    values : name -> (N,) positive numbers; NaN and what is not positive count as unknown.
    unit : of the numbers beside the rows.

    Returns
    -------
    Ranges : None if nothing is known of any.
    """
    known = {name: column[np.isfinite(column) & (column > 0)] for name, column in values.items()}
    found = {name: np.quantile(column, _QUANTILES) for name, column in known.items() if len(column)}
    if not found:
        return None
    axis = log_axis(np.concatenate(list(found.values())))
    rows = tuple(
        Range(name, f"{q[2]:.3g} {unit}", TOP + ROW * k, tuple(axis.at(one) for one in q))
        for k, (name, q) in enumerate(found.items())
    )
    told = "; ".join(
        f"{name}: {short(q[0])} to {short(q[4])} {unit}, median {short(q[2])}" for name, q in found.items()
    )
    note = "Thick: the middle half of the frames; thin: nine in ten; the line and the number: the median."
    return Ranges(title, f"{title}. {told}", x_title, axis.ticks, rows, TOP + ROW * len(rows), note)
