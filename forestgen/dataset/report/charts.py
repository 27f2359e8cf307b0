"""Charts as geometry: numbers that the page's templates draw as SVG, in the viewBox of `WIDTH` x `HEIGHT` units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

WIDTH, HEIGHT = 320.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 42.0, 312.0, 10.0, 132.0  # of the plot, in the viewBox
_MOST_BINS = 24
_LEAST = 1e-30  # what is nearer to 0 is 0
_BINS_A_DECADE = (20, 10, 5, 4, 3, 2, 1)


@dataclass(frozen=True)
class Tick:
    """A mark of an axis."""

    at: float  # in the viewBox
    text: str


@dataclass(frozen=True)
class Bar:
    """A bar of a histogram, in the viewBox."""

    x: float
    y: float
    width: float
    height: float
    title: str  # what it counts


@dataclass(frozen=True)
class Chart:
    """A histogram."""

    title: str
    summary: str  # for those who cannot see it
    x_title: str
    y_title: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    bars: tuple[Bar, ...]
    note: str = ""  # below the chart, such as what the recipe asked for


def histogram(
    values: ArrayLike,
    title: str,
    x_title: str,
    *,
    log: bool = False,
    y_title: str = "frames",
    note: str = "",
) -> Chart | None:
    """A histogram of numbers; NaN counts as unknown, and on a log axis so does what is not positive.

    Returns
    -------
    Chart : None if nothing is known.
    """
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[np.isfinite(known)]
    known = np.where(np.abs(known) < _LEAST, 0.0, known)
    if log:
        known = known[known > 0]
    if not len(known):
        return None
    edges = _log_edges(known) if log else _even_edges(known)
    counts, _ = np.histogram(known, edges)
    quantiles = ", ".join(short(one) for one in np.quantile(known, (0.0, 0.5, 1.0)))
    summary = f"{title}: histogram of {len(known):,} values; least, median and most: {quantiles}"
    return bars(counts, edges, title, x_title, log=log, y_title=y_title, note=note, summary=summary)


def bars(
    counts: ArrayLike,
    edges: ArrayLike,
    title: str,
    x_title: str,
    *,
    summary: str,
    log: bool = False,
    y_title: str = "frames",
    note: str = "",
) -> Chart:
    """A histogram that is counted already: (N,) counts between (N + 1,) edges."""
    heights, ends = np.asarray(counts, dtype=np.float64), np.asarray(edges, dtype=np.float64)
    y_ticks, top = _y_ticks(float(heights.max(initial=0.0)))
    axis = _axis(float(ends[0]), float(ends[-1]), log=log)
    drawn = []
    for low, high, height in zip(ends[:-1], ends[1:], heights, strict=True):
        tall, x = _round((BOTTOM - TOP) * height / top), axis.at(low)
        text = f"{short(low)} to {short(high)}: {height:,.0f}"
        if height:
            drawn.append(Bar(x, _round(BOTTOM - tall), _round(axis.at(high) - x), tall, text))
    return Chart(title, summary, x_title, y_title, axis.ticks, y_ticks, tuple(drawn), note)


@dataclass(frozen=True)
class Axis:
    """A horizontal axis over the plot's width."""

    low: float
    high: float
    log: bool
    ticks: tuple[Tick, ...] = ()

    def at(self, value: float) -> float:
        """Where a value lies, in the viewBox."""
        scale = math.log if self.log else float
        first, last = scale(self.low), scale(self.high)
        return _round(LEFT + (RIGHT - LEFT) * (scale(value) - first) / (last - first))


def _axis(low: float, high: float, *, log: bool) -> Axis:
    bare = Axis(low, high, log)
    texts = {short(value): value for value in (_log_ticks(low, high) if log else _even_ticks(low, high))}
    return replace(bare, ticks=tuple(Tick(bare.at(value), text) for text, value in texts.items()))


def log_axis(values: NDArray[np.float64]) -> Axis:
    """A logarithmic axis around positive values."""
    edges = _log_edges(values)
    return _axis(float(edges[0]), float(edges[-1]), log=True)


def _even_edges(known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of equal bins at round numbers, around all values."""
    low, high = float(known.min()), float(known.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):  # no bins lie between numbers so near to each other
        step = 1.0 if low == round(low) and abs(low) < 1e9 else nice_step(abs(low), 10)
        return np.array([low - step / 2, low + step / 2])
    whole = bool((known == np.round(known)).all())
    step = nice_step(high - low, _MOST_BINS)
    if whole and step <= 1.0:
        return np.arange(low - 0.5, high + 1.0, 1.0, dtype=np.float64)
    first = math.floor(low / step)
    last = max(math.floor(high / step * (1 + 1e-12)) + 1, first + 1)
    if math.isclose(high / step, last - 1) and last - 1 > first:
        last -= 1  # the greatest value lies on an edge, which belongs to the last bin
    return np.asarray(np.arange(first, last + 1) * step, dtype=np.float64)


def _log_edges(known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges at equal ratios, some of them powers of ten, around all values."""
    decades = math.log10(float(known.max()) / float(known.min()))
    parts = next((one for one in _BINS_A_DECADE if decades * one <= _MOST_BINS), 1)
    first = math.floor(math.log10(float(known.min())) * parts + 1e-9)
    last = max(math.ceil(math.log10(float(known.max())) * parts - 1e-9), first + 1)
    edges = 10.0 ** (np.arange(first, last + 1) / parts)
    edges[0], edges[-1] = min(edges[0], float(known.min())), max(edges[-1], float(known.max()))
    return np.asarray(edges, dtype=np.float64)


def nice_step(span: float, most: int) -> float:
    """The least of 1, 2, 5 times a power of ten that divides `span` into at most `most` parts."""
    least = span / most
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1 - 1e-9))


def _even_ticks(low: float, high: float) -> list[float]:
    step = nice_step(high - low, 5)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    found = [k * step for k in range(first, last + 1)]
    return found if len(found) > 1 or high - low < 1e-12 else [(low + high) / 2]


def _log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten, not too many of them; over less than two decades 1, 2 and 5 times these."""
    first, last = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    every = max(1, math.ceil((last - first) / 5))
    factors = (1.0, 2.0, 5.0) if high / low < 100 else (1.0,)
    found = [f * 10.0**k for k in range(first, last + 1, every) for f in factors]
    inside = [one for one in found if low * (1 - 1e-9) <= one <= high * (1 + 1e-9)]
    return inside or [math.sqrt(low) * math.sqrt(high)]


def _y_ticks(most: float) -> tuple[tuple[Tick, ...], float]:
    """Ticks from 0, and the value at the plot's top."""
    if most <= 0:
        return (Tick(BOTTOM, "0"),), 1.0
    step = nice_step(most, 3)
    if most == round(most):
        step = max(step, 1.0)
    count = math.ceil(most / step - 1e-9)
    ticks = [Tick(_round(BOTTOM - (BOTTOM - TOP) * k / count), short(k * step)) for k in range(count + 1)]
    return tuple(ticks), count * step


def short(value: float) -> str:
    """A number of few digits."""
    value = float(value)
    if value == 0 or 0.001 <= abs(value) < 10_000:
        return f"{value:.4g}"
    if 10_000 <= abs(value) < 1e12:
        for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
            if abs(value) >= size:
                return f"{value / size:.3g}{letter}"
    return f"{value:.2g}"


def _round(value: float) -> float:
    return round(float(value), 1)


@dataclass(frozen=True)
class Share:
    """A row of a list of shares."""

    name: str
    text: str  # the number, for people
    share: float  # of the longest bar, 0 to 1
    colour: str = ""  # "" for the page's own


def shares(
    names: Sequence[str], counts: ArrayLike, colours: Sequence[str] = (), of: float | None = None
) -> tuple[Share, ...]:
    """Rows of counts with their share of all, or of `of`; none left out."""
    numbers = np.asarray(counts, dtype=np.float64)
    whole, most = float(numbers.sum()) if of is None else of, float(numbers.max(initial=0.0))
    return tuple(
        Share(
            name,
            f"{percent(number / whole if whole else 0.0)} · {number:,.0f}",
            number / most if most else 0.0,
            colours[k] if colours else "",
        )
        for k, (name, number) in enumerate(zip(names, numbers, strict=True))
    )


def percent(share: float) -> str:
    """A share of 1 for people; what is more than nothing never reads 0%."""
    if 0 < share < 0.0001:
        return "<0.01%"
    if 0.9995 <= share < 1:
        return ">99.9%"
    return f"{100 * share:.3g}%" if share >= 0.001 or share == 0 else f"{100 * share:.2f}%"
