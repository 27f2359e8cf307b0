"""`forestgen stats`: how the points of a file lie, as a table for people or as JSON."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.cli.console import count, output
from forestgen.community import point_patterns as patterns
from forestgen.community.point_patterns import Estimate, Window
from forestgen.community.point_table import PointTable, read_points
from forestgen.community.ripley import besag_l, count_pairs, greatest_radius, ripley_bound, ripley_k
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.randomness import child_rng

if TYPE_CHECKING:
    from rich.table import Table

_DEFAULT_RADII = 10
_NEIGHBOURS, _DEFAULT_PAIRS = 100, 50_000_000  # within the greatest default radius, at most
_MOST_RADII = 1000
_MOST_PAIRS = 2_000_000_000  # some minutes
_Z = 1.96  # of a normal distribution, 95% lies within so many standard errors


@dataclass(frozen=True)
class PointStatistics:
    """What the command tells about a pattern."""

    n: int
    window: Window
    density: float  # 1/m²
    hopkins: Estimate
    hopkins_skellam: Estimate
    clark_evans: Estimate
    clark_evans_donnelly: Estimate
    radii_m: NDArray[np.float64]
    k_isotropic_m2: NDArray[np.float64]
    k_translation_m2: NDArray[np.float64]


def stats(path: Path, window: tuple[float, float, float, float] | None, radii: Sequence[str], as_json: bool) -> None:
    """Print the statistics of a file's points."""
    table = read_points(path, window, allow_duplicates=True)
    radii_m = _radii(radii, table)
    _check_pairs(table.points_m, float(radii_m.max()))
    measured = measure(table.points_m, table.window, radii_m)
    if as_json:
        sys.stdout.write(json.dumps(_document(measured, table), indent=2, allow_nan=False) + "\n")
    else:
        _print(path, measured, table.notes)


def measure(points_m: NDArray[np.float64], window: Window, radii_m: NDArray[np.float64]) -> PointStatistics:
    """All statistics of a pattern; the same points give the same numbers."""
    distances = patterns.measure_distances(points_m, window, child_rng(0, "stats"))
    nearest_m = distances.from_points_m
    return PointStatistics(
        n=len(points_m),
        window=window,
        density=patterns.density(points_m, window),
        hopkins=patterns.hopkins(distances),
        hopkins_skellam=patterns.hopkins_skellam(distances),
        clark_evans=patterns.clark_evans(nearest_m, window),
        clark_evans_donnelly=patterns.clark_evans_donnelly(nearest_m, window),
        radii_m=radii_m,
        k_isotropic_m2=ripley_k(points_m, window, radii_m, "isotropic"),
        k_translation_m2=ripley_k(points_m, window, radii_m, "translation"),
    )


def _radii(texts: Sequence[str], table: PointTable) -> NDArray[np.float64]:
    """The radii asked for, in their order; by default ten up to a quarter of the window or to 100 neighbours."""
    window, n = table.window, len(table.points_m)
    if not texts:
        neighbours = min(_NEIGHBOURS, _DEFAULT_PAIRS / n)
        most = min(min(window.size_m) / 4, math.sqrt(neighbours * window.area_m2 / (math.pi * n)))
        return np.linspace(0, most, _DEFAULT_RADII + 1)[1:]
    most = greatest_radius(window)
    radii = [_radius(one, most) for text in texts for one in text.split(",") if one.strip()]
    if not 0 < len(radii) <= _MOST_RADII:
        raise RecipeError("so many radii", where="--radii", expected=f"1 to {_MOST_RADII}", got=str(len(radii)))
    return np.array(radii)


def _check_pairs(points_m: NDArray[np.float64], most_m: float) -> None:
    pairs = count_pairs(points_m, most_m)
    if pairs > _MOST_PAIRS:
        raise ResourceError(
            "too many pairs of points lie within the greatest radius",
            where="--radii",
            expected=f"at most {_MOST_PAIRS:,}",
            got=f"{pairs:,} within {most_m:g} m",
            hint="lower the greatest radius",
        )


def _radius(text: str, most: float) -> float:
    try:
        radius = float(text)
    except ValueError:
        radius = math.nan
    if 0 <= radius <= most:
        return radius
    raise RecipeError(
        "this radius is too large for the window" if radius > most else "this is no radius",
        where="--radii",
        expected=f"metres, 0 to {most:g}: beyond, nothing can correct for the window's edges",
        got=text.strip(),
    )


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _document(measured: PointStatistics, table: PointTable) -> dict[str, object]:
    window = measured.window
    return {
        "n": measured.n,
        "duplicates": table.duplicates,
        "density": measured.density,
        "hopkins": _number(measured.hopkins.value),
        "hopkins_error": _number(measured.hopkins.error),
        "hopkins_skellam": _number(measured.hopkins_skellam.value),
        "hopkins_skellam_error": _number(measured.hopkins_skellam.error),
        "clark_evans": measured.clark_evans.value,
        "clark_evans_donnelly": measured.clark_evans_donnelly.value,
        "radii": measured.radii_m.tolist(),
        "ripley_k_isotropic": measured.k_isotropic_m2.tolist(),
        "ripley_k_translation": measured.k_translation_m2.tolist(),
        "window": [window.x0, window.x1, window.y0, window.y1],
        "notes": list(table.notes),
    }


def _word(difference: float, error: float) -> str:
    """What a difference from the random pattern means; one that chance makes in 19 of 20 patterns means none."""
    if not math.isfinite(error):
        return "unclear"
    if abs(difference) <= _Z * error:
        return "random"
    return "clustered" if difference > 0 else "regular"


def _rows(measured: PointStatistics) -> Iterator[tuple[str, str, str, str]]:
    """Name, value, standard error and meaning. An index below 1 is clustered for all but Hopkins' own."""
    named = (
        ("Hopkins", measured.hopkins, 1),
        ("Hopkins-Skellam", measured.hopkins_skellam, -1),
        ("Clark-Evans, naive", measured.clark_evans, -1),
        ("Clark-Evans, Donnelly", measured.clark_evans_donnelly, -1),
    )
    for name, (value, error), sign in named:
        shown = f"± {error:.3f}" if math.isfinite(error) else ""
        yield name, f"{value:.4f}", shown, _word(sign * (value - 1), error)


def _ripley_table(measured: PointStatistics) -> Table:
    """K by both corrections, and by how much L departs from that of a random pattern."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="")
    for title in ("r (m)", "K isotropic", "K translation", "π r² (m²)", "L - r (m)"):
        table.add_column(title, justify="right")
    table.add_column("pattern")
    bound_m = ripley_bound(measured.n, measured.window)
    for r, isotropic, translation in zip(
        measured.radii_m, measured.k_isotropic_m2, measured.k_translation_m2, strict=True
    ):
        excess_m = float(besag_l(isotropic)) - float(r)
        numbers = (f"{one:.6g}" for one in (r, isotropic, translation, math.pi * r * r))
        table.add_row(*numbers, f"{excess_m:+.4g}", _word(excess_m, bound_m / _Z))
    return table


def _print(path: Path, measured: PointStatistics, notes: Sequence[str]) -> None:
    from rich.table import Table
    from rich.text import Text

    out = output()
    out.print(Text(f"{path}: {count(measured.n, 'point')} in {measured.window}"))
    out.print(Text(f"density {measured.density:.6g} per m²"))
    out.print()
    indices = Table("index", box=None, pad_edge=False, header_style="")
    for title in ("value", "error"):
        indices.add_column(title, justify="right")
    indices.add_column("pattern")
    for row in _rows(measured):
        indices.add_row(*row)
    out.print(indices)
    out.print(Text("errors are standard errors; Hopkins is above 1 for clusters, the others below 1"))
    out.print()
    out.print(_ripley_table(measured))
    for note in notes:
        out.print(Text(f"note: {note}"))
