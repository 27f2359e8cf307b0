"""Charts as geometry, and what else the page is made of: sections of facts, figures and tables.

Charts are numbers that the templates draw as SVG, in the viewBox of `WIDTH` x `HEIGHT` units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

WIDTH, HEIGHT = 320.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 42.0, 312.0, 10.0, 132.0  # of the plot, in the viewBox
_MOST_BINS = 24
_LEAST = 1e-30  # what is nearer to 0 is 0
_BINS_A_DECADE = (20, 10, 5, 4, 3, 2, 1)
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_ROW, _ROWS_TOP = 34.0, 22.0  # of ranges: height of a row, and what is above the first, in the viewBox
SUN_SIZE = 320.0
SUN_CENTRE, SUN_RADIUS = SUN_SIZE / 2, 122.0
_AZIMUTH_STEP_DEG, _ELEVATION_STEP_DEG = 15, 10
_MOST_DOTS = 300  # single suns are drawn up to so many


class Tick(NamedTuple):
    """A mark of an axis."""

    at: float  # in the viewBox
    text: str


class Bar(NamedTuple):
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


@dataclass(frozen=True)
class Axis:
    """A horizontal axis over the plot's width."""

    low: float
    high: float
    log: bool

    def at(self, value: float) -> float:
        """Where a value lies, in the viewBox."""
        scale = math.log if self.log else float
        first, last = scale(self.low), scale(self.high)
        return _round(LEFT + (RIGHT - LEFT) * (scale(value) - first) / (last - first))

    @property
    def ticks(self) -> tuple[Tick, ...]:
        values = (_log_ticks if self.log else _even_ticks)(self.low, self.high)
        return tuple(Tick(self.at(value), text) for text, value in {short(value): value for value in values}.items())


def histogram(
    values: ArrayLike, title: str, x_title: str, *, log: bool = False, y_title: str = "frames", note: str = ""
) -> Chart | None:
    """A histogram of numbers, None if nothing is known; NaN, and on a log axis what is not positive, is unknown."""
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
    counts: ArrayLike, edges: ArrayLike, title: str, x_title: str, *,
    summary: str, log: bool = False, y_title: str = "frames", note: str = "",
) -> Chart:  # fmt: skip
    """A histogram that is counted already: (N,) counts between (N + 1,) edges."""
    heights, ends = np.asarray(counts, dtype=np.float64), np.asarray(edges, dtype=np.float64)
    y_ticks, top = _y_ticks(float(heights.max(initial=0.0)))
    axis = Axis(float(ends[0]), float(ends[-1]), log)
    drawn = []
    for low, high, height in zip(ends[:-1], ends[1:], heights, strict=True):
        tall, x = _round((BOTTOM - TOP) * height / top), axis.at(low)
        if height:
            text = f"{short(low)} to {short(high)}: {height:,.0f}"
            drawn.append(Bar(x, _round(BOTTOM - tall), _round(axis.at(high) - x), tall, text))
    return Chart(title, summary, x_title, y_title, axis.ticks, y_ticks, tuple(drawn), note)


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


def percent(share: float) -> str:
    """A share of 1 for people; what is more than nothing never reads 0%."""
    if 0 < share < 0.0001:
        return "<0.01%"
    if 0.9995 <= share < 1:
        return ">99.9%"
    return f"{100 * share:.3g}%" if share >= 0.001 or share == 0 else f"{100 * share:.2f}%"


def _round(value: float) -> float:
    return round(float(value), 1)


class Share(NamedTuple):
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
    texts = [f"{percent(number / whole if whole else 0.0)} · {number:,.0f}" for number in numbers]
    lengths = [number / most if most else 0.0 for number in numbers]
    return tuple(map(Share, names, texts, lengths, colours or [""] * len(names)))


class Range(NamedTuple):
    """A row of ranges: five quantiles, in the viewBox."""

    name: str
    text: str
    y: float
    spots: tuple[float, ...]


@dataclass(frozen=True)
class Ranges:
    """Ranges side by side on one logarithmic axis: what most frames have, and what few have."""

    title: str
    summary: str
    x_title: str
    x_ticks: tuple[Tick, ...]
    rows: tuple[Range, ...]
    height: float
    note: str = "Thick: the middle half of the frames; thin: nine in ten; the line and the number: the median."


def ranges(values: Mapping[str, NDArray[np.float64]], title: str, x_title: str, unit: str) -> Ranges | None:
    """Quantiles of positive numbers (N,), a row a name; NaN and others are unknown. None if nothing is known of any."""
    known = {name: column[np.isfinite(column) & (column > 0)] for name, column in values.items()}
    found = {name: np.quantile(column, _QUANTILES) for name, column in known.items() if len(column)}
    if not found:
        return None
    edges = _log_edges(np.concatenate(list(found.values())))
    axis = Axis(float(edges[0]), float(edges[-1]), log=True)
    rows = tuple(
        Range(name, f"{q[2]:.3g} {unit}", _ROWS_TOP + _ROW * k, tuple(axis.at(one) for one in q))
        for k, (name, q) in enumerate(found.items())
    )
    texts = [f"{name}: {short(q[0])} to {short(q[4])} {unit}, median {short(q[2])}" for name, q in found.items()]
    summary = f"{title}. {'; '.join(texts)}"
    return Ranges(title, summary, x_title, axis.ticks, rows, _ROWS_TOP + _ROW * len(rows))


class Wedge(NamedTuple):
    """A cell of the sky."""

    path: str
    strength: float  # share of the fullest cell's count, 0 to 1
    title: str


@dataclass(frozen=True)
class Polar:
    """Where the sun stood, by cells of the sky: north up, east right, the zenith in the middle, the horizon outside."""

    title: str
    summary: str
    wedges: tuple[Wedge, ...]
    dots: tuple[tuple[float, float], ...]  # x, y of each sun
    rings: tuple[tuple[float, str], ...]  # radius and the elevation there
    note: str = ""


def sun_plot(azimuth_deg: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> Polar | None:
    """Suns (N,) above the horizon, counted by cell; NaN where a frame has none. None if no sun is known."""
    known = np.isfinite(azimuth_deg) & np.isfinite(elevation_deg)
    if not known.any():
        return None
    azimuth, elevation = azimuth_deg[known] % 360.0, elevation_deg[known]
    up = elevation >= 0
    edges = np.arange(0, 91, _ELEVATION_STEP_DEG), np.arange(0, 361, _AZIMUTH_STEP_DEG)
    counts = np.histogram2d(elevation[up], azimuth[up], edges)[0].astype(np.int64)
    wedges = tuple(_wedge(i, j, counts) for i, j in np.argwhere(counts))
    dots = tuple(map(_spot, azimuth[up], elevation[up])) if up.sum() <= _MOST_DOTS else ()
    rings = tuple((_radius(degrees), f"{degrees}°") for degrees in (0, 30, 60))
    below = int((~up).sum())
    summary = (
        f"The sun's place in the sky in {int(up.sum()):,} frames: elevations from {elevation.min():.0f} to "
        f"{elevation.max():.0f} degrees, {len(wedges)} of {counts.size} cells of the sky have one"
    )
    cells = f"Cells of {_AZIMUTH_STEP_DEG}° of azimuth by {_ELEVATION_STEP_DEG}° of elevation"
    note = f"{f'{below:,} below the horizon, not shown. ' if below else ''}{cells}; the stronger, the more frames."
    return Polar("Where the sun stands", summary, wedges, dots, rings, note)


def _radius(elevation_deg: float) -> float:
    return SUN_RADIUS * (90.0 - elevation_deg) / 90.0


def _spot(azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
    """x and y of a direction; x grows eastward, y downward."""
    angle, radius = math.radians(azimuth_deg), _radius(elevation_deg)
    return round(SUN_CENTRE + radius * math.sin(angle), 1), round(SUN_CENTRE - radius * math.cos(angle), 1)


def _wedge(row: int, column: int, counts: NDArray[np.int64]) -> Wedge:
    low, high = row * _ELEVATION_STEP_DEG, (row + 1) * _ELEVATION_STEP_DEG
    left, right = column * _AZIMUTH_STEP_DEG, (column + 1) * _AZIMUTH_STEP_DEG
    (a, b), (c, d), (e, f), (g, h) = _spot(left, low), _spot(right, low), _spot(right, high), _spot(left, high)
    outer, inner = round(_radius(low), 1), round(_radius(high), 1)
    path = f"M{a} {b}A{outer} {outer} 0 0 1 {c} {d}L{e} {f}A{inner} {inner} 0 0 0 {g} {h}Z"
    count = int(counts[row, column])
    title = f"azimuth {left}° to {right}°, elevation {low}° to {high}°: {count:,}"
    return Wedge(path, round(count / int(counts.max()), 3), title)


@dataclass(frozen=True)
class Fact:
    """A number with its name."""

    value: str
    name: str


@dataclass(frozen=True)
class ShareList:
    """Shares of a whole as a list of bars."""

    title: str
    rows: tuple[Share, ...]
    note: str = ""


class Cell(NamedTuple):
    """A table's cell: text, and a bar of `share` of the column's width if that is given."""

    text: str
    share: float | None = None
    warn: bool = False
    soft: str = ""  # more text, smaller


class Row(NamedTuple):
    """A table's row."""

    name: str
    cells: Sequence[Cell]
    colour: str = ""  # of its name's swatch and its bars; "" for none


class Table(NamedTuple):
    """A table whose rows have names."""

    title: str
    heads: tuple[str, ...]  # of the name, then of each cell
    rows: Sequence[Row]
    note: str = ""
    words: bool = False  # whether cells are sentences rather than numbers


Figure = Chart | ShareList | Polar | Ranges
Part = Figure | Fact


@dataclass(frozen=True)
class Section:
    """A part of the page under one heading."""

    id: str  # in links
    title: str
    absent: str  # what to say where there is nothing to show
    lead: str = ""
    parts: Sequence[Part | None] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()  # warnings

    @property
    def facts(self) -> list[Fact]:
        return [one for one in self.parts if isinstance(one, Fact)]

    @property
    def figures(self) -> list[Figure]:
        return [one for one in self.parts if one is not None and not isinstance(one, Fact)]

    @property
    def empty(self) -> bool:
        return not (self.facts or self.figures or self.tables)


def listed(words: Sequence[str], most: int = 8) -> str:
    """Words as a list in a sentence, the last ones counted rather than named if they are many."""
    if len(words) > most:
        return f"{', '.join(words[: most - 1])} and {len(words) - most + 1:,} more"
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
