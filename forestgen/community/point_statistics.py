"""The points of a file, and how they lie: all indices and functions of their pattern, with their errors.

A file is a CSV table with columns x and y in metres, and `#` comments, one of which may state the window::

    # trees of plot 7, window 0 50 0 20
    x,y
    3.5,7.25

Where marks are asked for, a header may name a column species and a column radius_m beside x and y, in any order.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from forestgen.community import point_patterns as patterns
from forestgen.community.point_patterns import Estimate, Window
from forestgen.community.population import Floats
from forestgen.core.arguments import shown
from forestgen.core.errors import AssetError, RecipeError, ResourceError
from forestgen.core.figures import count, table_lines
from forestgen.core.randomness import child_rng

MOST_POINTS = 5_000_000
_LONGEST_LINE = 10_000
_EXPECTED = "two columns, x,y, in metres"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WINDOW = re.compile(rf"\bwindow\b\s*[:=]?\s*((?:{_NUMBER}[\s,;]+)*{_NUMBER})(?=[\s,;.]|$)", re.IGNORECASE)
_DEFAULT_RADII = 10
_NEIGHBOURS, _DEFAULT_PAIRS = 100, 50_000_000  # within the greatest default radius, at most
_MOST_RADII = 1000
_Z = 1.96  # of a normal distribution, 95% lies within so many standard errors
_MOST_PAIRS = 2_000_000_000  # some minutes


@dataclass(frozen=True)
class PointTable:
    """A file's points, and the window in which they were observed."""

    points_m: Floats  # (N, 2), N >= 2, all in the window
    window: Window
    notes: tuple[str, ...]  # what the reader had to assume
    species: tuple[str, ...] | None = None  # (N,) names; None: the file has no such column
    radius_m: Floats | None = None  # (N,) metres, above 0; None: the file has no such column
    duplicates: int = 0  # points at the place of an earlier one


def read_points(
    path: Path,
    window: tuple[float, float, float, float] | None = None,
    *,
    marks: bool = False,
    allow_duplicates: bool = False,
) -> PointTable:
    """Read a point pattern.

    Parameters
    ----------
    window : x0, x1, y0, y1; by default that of a comment in the file, else the points' bounding box.
    marks : whether the columns species and radius_m are welcome.
    allow_duplicates : whether points may share a place; a note says how many do.

    Raises
    ------
    AssetError : no such file, not a table of points, points outside the window, fewer than two, two at one place.
    RecipeError : `window` is none.
    ResourceError : too many points.
    """
    given = _given_window(window) if window is not None else None
    try:
        with path.open("rb") as file:
            points, rows, comments, cells = _parse(path, file, marks)
    except OSError as error:
        raise AssetError(
            "the points cannot be read", where=str(path), expected="a CSV file", got=error.strerror or str(error)
        ) from error
    if len(points) < 2:
        got = count(len(points), "point")
        raise AssetError("too few points for statistics", where=str(path), expected="2 points at least", got=got)
    notes = []
    chosen = given or _stated_window(comments)
    if chosen is None:
        chosen = _bounding_box(path, points)
        notes.append(
            f"the window is the points' bounding box, {chosen}: too tight, and all values lean towards regular; "
            "state the true one by `window` or in a comment of the file"
        )
    _check_inside(path, points, rows, chosen)
    duplicates = _count_duplicates(path, points, rows, allow_duplicates)
    if duplicates:
        lie = "lies" if duplicates == 1 else "lie"
        notes.append(
            f"{duplicates:,} of {len(points):,} points {lie} at the place of an earlier one: each counts as a point, "
            "0 m from the other; where they are copies or rounded positions, all values lean towards clustered"
        )
    radius = np.array([float(one) for one in cells["radius_m"]]) if "radius_m" in cells else None
    species = tuple(cells["species"]) if "species" in cells else None
    return PointTable(points, chosen, tuple(notes), species, radius, duplicates)


def _given_window(window: tuple[float, float, float, float]) -> Window:
    try:
        return Window(*(float(one) for one in window))
    except (ValueError, TypeError, OverflowError) as error:
        numbers = window if isinstance(window, list | tuple) else [window]
        expected = "x0 x1 y0 y1 in metres, with x0 < x1 and y0 < y1, 1e-6 to 1e9 m wide and high"
        got = " ".join(f"{one:g}" if isinstance(one, float) else shown(one) for one in numbers)
        raise RecipeError("this is no window", parameter="window", expected=expected, got=got) from error


def _parse(
    path: Path, file: BinaryIO, marks: bool
) -> tuple[Floats, NDArray[np.int64], list[str], dict[str, list[str]]]:
    """Points, their lines' numbers, the comments that may state a window, and the columns of marks."""
    values, rows, comments = array("d"), array("q"), list[str]()
    columns: list[str] = []  # by the header, if there is one
    marked: dict[str, list[str]] = {}
    for number, line in _lines(path, file):
        if line.startswith("#"):
            if "window" in line.lower():
                comments.append(line)
            continue
        cells = [one.strip().strip('"') for one in line.split(",")]
        names = [one.lower() for one in cells]
        if not columns and not rows and _is_header(names, marks):
            columns, marked = names, {name: [] for name in names if name not in ("x", "y")}
            continue
        if len(cells) != len(columns or "xy"):
            raise _wrong_number(f"{path}:{number}", line, cells, columns, marks)
        values.extend(_point(f"{path}:{number}", line, dict(zip(columns or "xy", cells, strict=True)), marked))
        rows.append(number)
        if len(rows) > MOST_POINTS:
            expected, hint = f"at most {MOST_POINTS:,}", "take a part of the window"
            raise ResourceError("too many points", where=str(path), expected=expected, hint=hint)
    return np.array(values).reshape(-1, 2), np.array(rows, dtype=np.int64), comments, marked


def _is_header(names: list[str], marks: bool) -> bool:
    if not marks:
        return names == ["x", "y"]
    return {"x", "y"} <= set(names) <= {"x", "y", "species", "radius_m"} and len(set(names)) == len(names)


def _wrong_number(where: str, line: str, cells: list[str], columns: list[str], marks: bool) -> AssetError:
    """The error of a row with more or fewer columns than expected."""
    expected = f"the header's columns, {','.join(columns)}" if len(columns) > 2 else _EXPECTED
    hint = "separate the columns by commas" if len(cells) == 1 else "keep x and y only, with points for decimals"
    if marks and not columns and len(cells) > 2:
        hint = "name the columns in the first line: x,y,species or x,y,species,radius_m; no other is known"
    got = f"{count(len(cells), 'column')}: {_short(line)}"
    return AssetError("this is no point", where=where, expected=expected, got=got, hint=hint)


def _point(where: str, line: str, row: Mapping[str, str], marked: Mapping[str, list[str]]) -> tuple[float, float]:
    """A row's x and y; its marks go to their columns."""
    for name, values in marked.items():
        radius = _number(row[name]) if name == "radius_m" else None
        if name == "radius_m" and not (radius is not None and 0 < radius <= 1000):
            expected = "metres, above 0 and up to 1000"
            raise AssetError("this is no radius", where=where, expected=expected, got=_short(row[name]))
        if not row[name]:
            expected = f"the header's columns, {','.join(row)}"
            raise AssetError("a plant without a species", where=where, expected=expected, got=_short(line))
        values.append(row[name])
    x, y = _number(row["x"]), _number(row["y"])
    if x is None or y is None:
        expected = f"two numbers: {_EXPECTED}"
        raise AssetError("this is no point", where=where, expected=expected, got=_short(line))
    if not (abs(x) < 1e15 and abs(y) < 1e15):
        expected, hint = "finite coordinates in metres", "leave out plants without a position"
        raise AssetError("this is no point", where=where, expected=expected, got=_short(line), hint=hint)
    return x, y


def _number(text: str) -> float | None:
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None


def _lines(path: Path, file: BinaryIO) -> Iterator[tuple[int, str]]:
    """Numbers and texts of the lines that hold something. No line is read that could not be one of a table."""
    number, got = 0, ""
    while raw := file.readline(_LONGEST_LINE + 1):
        number += 1
        if b"\0" in raw or len(raw) > _LONGEST_LINE:
            got = "bytes that are no text" if b"\0" in raw else "a line of more than 10,000 bytes"
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError as error:
            got = got or f"the byte 0x{raw[error.start]:02x}, which is not UTF-8"
        if got:
            raise AssetError("not a text file", where=f"{path}:{number}", expected=f"a CSV file: {_EXPECTED}", got=got)
        if text:
            yield number, text


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _stated_window(comments: list[str]) -> Window | None:
    """The window of the comments, if one states it and no other contradicts."""
    found = set()
    for comment in comments:
        for match in _WINDOW.finditer(comment):
            numbers = [float(one) for one in re.findall(_NUMBER, match.group(1))]
            if len(numbers) != 4:
                return None
            try:
                found.add(Window(*numbers))
            except ValueError:
                return None
    return found.pop() if len(found) == 1 else None


def _bounding_box(path: Path, points: Floats) -> Window:
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    try:
        return Window(float(x0), float(x1), float(y0), float(y1))
    except ValueError as error:
        line = x0 == x1 or y0 == y1
        raise AssetError(
            "the points lie on one line, and their bounding box has no area" if line else f"no stand's points: {error}",
            where=str(path),
            got=f"x from {x0:g} to {x1:g}, y from {y0:g} to {y1:g}",
            hint="state the `window` x0 x1 y0 y1",
        ) from error


def _check_inside(path: Path, points: Floats, rows: NDArray[np.int64], window: Window) -> None:
    outside = np.flatnonzero(window.outside(points))
    if not len(outside):
        return
    first = outside[0]
    more = f", and {len(outside) - 1:,} more" if len(outside) > 1 else ""
    problem, got = "a point lies outside the window", f"({points[first, 0]:g}, {points[first, 1]:g}){more}"
    hint = "widen the window, or leave these points out: statistics of a window need all its points and no other"
    raise AssetError(problem, where=f"{path}:{rows[first]}", expected=f"x and y in {window}", got=got, hint=hint)


def _count_duplicates(path: Path, points: Floats, rows: NDArray[np.int64], allowed: bool) -> int:
    """How many points lie at the place of an earlier one; `AssetError` for the first where they are not allowed."""
    order = np.lexsort((rows, points[:, 1], points[:, 0]))
    same = np.flatnonzero(np.all(points[order[1:]] == points[order[:-1]], axis=1))
    if len(same) and not allowed:
        one, two = order[same[0]], order[same[0] + 1]
        more = f", and {len(same) - 1:,} more" if len(same) > 1 else ""
        expected = "points that differ: no two plants stand at one place"
        got = f"({points[one, 0]:g}, {points[one, 1]:g}), as in line {rows[one]}{more}"
        hint = "remove the copies; of rounded positions, take more digits"
        raise AssetError("a point occurs twice", where=f"{path}:{rows[two]}", expected=expected, got=got, hint=hint)
    return len(same)


@dataclass(frozen=True, repr=False)
class PointStatistics:
    """How the points of a pattern lie."""

    n: int
    window: Window
    density: float  # 1/m²
    hopkins: Estimate
    hopkins_skellam: Estimate
    clark_evans: Estimate
    clark_evans_donnelly: Estimate
    radii_m: Floats
    k_isotropic_m2: Floats
    k_translation_m2: Floats
    duplicates: int = 0  # points at the place of an earlier one
    notes: tuple[str, ...] = ()  # on the file, for people

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON; None for what cannot be known."""
        return {
            "n": self.n,
            "duplicates": self.duplicates,
            "density": self.density,
            "hopkins": _finite(self.hopkins.value),
            "hopkins_error": _finite(self.hopkins.error),
            "hopkins_skellam": _finite(self.hopkins_skellam.value),
            "hopkins_skellam_error": _finite(self.hopkins_skellam.error),
            "clark_evans": self.clark_evans.value,
            "clark_evans_donnelly": self.clark_evans_donnelly.value,
            "radii": self.radii_m.tolist(),
            "ripley_k_isotropic": self.k_isotropic_m2.tolist(),
            "ripley_k_translation": self.k_translation_m2.tolist(),
            "window": [self.window.x0, self.window.x1, self.window.y0, self.window.y1],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        return f"<PointStatistics: {count(self.n, 'point')} in {self.window}>"

    def lines(self) -> Iterator[str]:
        """For people: the indices, then Ripley's functions."""
        yield f"{count(self.n, 'point')} in {self.window}"
        yield f"density {self.density:.6g} per m²"
        yield ""
        yield from table_lines([("index", "value", "error", "pattern"), *self._indices()])
        yield "errors are standard errors; Hopkins is above 1 for clusters, the others below 1"
        yield ""
        rows = [("r (m)", "K isotropic", "K translation", "π r² (m²)", "L - r (m)", "pattern")]
        bound_m = patterns.ripley_bound(self.n, self.window)
        functions = zip(self.radii_m, self.k_isotropic_m2, self.k_translation_m2, strict=True)
        for r, isotropic, translation in functions:
            excess_m = float(patterns.besag_l(isotropic)) - float(r)
            numbers = (f"{one:.6g}" for one in (r, isotropic, translation, math.pi * r * r))
            rows.append((*numbers, f"{excess_m:+.4g}", _word(excess_m, bound_m / _Z)))  # type: ignore[arg-type]
        yield from table_lines(rows)
        for note in self.notes:
            yield f"note: {note}"

    def _indices(self) -> Iterator[tuple[str, str, str, str]]:
        """Name, value, standard error and meaning. An index below 1 is clustered for all but Hopkins' own."""
        named = (
            ("Hopkins", self.hopkins, 1),
            ("Hopkins-Skellam", self.hopkins_skellam, -1),
            ("Clark-Evans, naive", self.clark_evans, -1),
            ("Clark-Evans, Donnelly", self.clark_evans_donnelly, -1),
        )
        for name, (value, error), sign in named:
            shown = f"± {error:.3f}" if math.isfinite(error) else ""
            yield name, f"{value:.4f}", shown, _word(sign * (value - 1), error)


def _word(difference: float, error: float) -> str:
    """What a difference from the random pattern means; one that chance makes in 19 of 20 patterns means none."""
    if not math.isfinite(error):
        return "unclear"
    if abs(difference) <= _Z * error:
        return "random"
    return "clustered" if difference > 0 else "regular"


def measure_file(
    path: Path, window: tuple[float, float, float, float] | None, radii_m: Sequence[float | str]
) -> PointStatistics:
    """Statistics of a file's points; the same points give the same numbers.

    Raises
    ------
    RecipeError : the file holds no points, or a radius is too large for the window.
    ResourceError : too many pairs of points lie within the greatest radius.
    """
    table = read_points(path, window, allow_duplicates=True)
    points_m, window_m, radii = table.points_m, table.window, _radii(radii_m, table)
    pairs = patterns.count_pairs(points_m, most_m := float(radii.max()))
    if pairs > _MOST_PAIRS:
        problem, expected = "too many pairs of points lie within the greatest radius", f"at most {_MOST_PAIRS:,}"
        got = f"{pairs:,} within {most_m:g} m"
        raise ResourceError(problem, parameter="radii", expected=expected, got=got, hint="lower the greatest radius")
    distances = patterns.measure_distances(points_m, window_m, child_rng(0, "stats"))
    return PointStatistics(
        n=len(points_m),
        window=window_m,
        density=len(points_m) / window_m.area_m2,
        hopkins=patterns.hopkins(distances),
        hopkins_skellam=patterns.hopkins_skellam(distances),
        clark_evans=patterns.clark_evans(distances.from_points_m, window_m),
        clark_evans_donnelly=patterns.clark_evans_donnelly(distances.from_points_m, window_m),
        radii_m=radii,
        k_isotropic_m2=patterns.ripley_k(points_m, window_m, radii, "isotropic"),
        k_translation_m2=patterns.ripley_k(points_m, window_m, radii, "translation"),
        duplicates=table.duplicates,
        notes=table.notes,
    )


def _radii(given: Sequence[float | str], table: PointTable) -> Floats:
    """The radii asked for, in their order; by default ten up to a quarter of the window or to 100 neighbours."""
    window, n = table.window, len(table.points_m)
    if not given:
        neighbours = min(_NEIGHBOURS, _DEFAULT_PAIRS / n)
        most = min(min(window.size_m) / 4, math.sqrt(neighbours * window.area_m2 / (math.pi * n)))
        return np.linspace(0, most, _DEFAULT_RADII + 1)[1:]
    most = patterns.greatest_radius(window)
    radii = [_radius(one, most) for text in given for one in str(text).split(",") if one.strip()]
    if not 0 < len(radii) <= _MOST_RADII:
        raise RecipeError(
            "too few or too many radii", parameter="radii", expected=f"1 to {_MOST_RADII}", got=str(len(radii))
        )
    return np.array(radii)


def _radius(text: str, most: float) -> float:
    radius = _number(text)
    if radius is not None and 0 <= radius <= most:
        return radius
    problem = "this radius is too large for the window" if (radius or 0) > most else "this is no radius"
    expected = f"metres, 0 to {most:g}: beyond, nothing can correct for the window's edges"
    raise RecipeError(problem, parameter="radii", expected=expected, got=text.strip())


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
