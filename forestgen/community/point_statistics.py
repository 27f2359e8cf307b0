"""How the points of a file lie: all indices and functions of a pattern, with their errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from forestgen.community import point_patterns as patterns
from forestgen.community.point_patterns import Estimate, Window
from forestgen.community.point_table import PointTable, read_points
from forestgen.community.population import Floats
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.figures import count, table_lines
from forestgen.core.randomness import child_rng

_DEFAULT_RADII = 10
_NEIGHBOURS, _DEFAULT_PAIRS = 100, 50_000_000  # within the greatest default radius, at most
_MOST_RADII = 1000
_Z = 1.96  # of a normal distribution, 95% lies within so many standard errors
_MOST_PAIRS = 2_000_000_000  # some minutes


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
            "hopkins": _number(self.hopkins.value),
            "hopkins_error": _number(self.hopkins.error),
            "hopkins_skellam": _number(self.hopkins_skellam.value),
            "hopkins_skellam_error": _number(self.hopkins_skellam.error),
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
        raise ResourceError(
            "too many pairs of points lie within the greatest radius",
            parameter="radii",
            expected=f"at most {_MOST_PAIRS:,}",
            got=f"{pairs:,} within {most_m:g} m",
            hint="lower the greatest radius",
        )
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
    try:
        radius = float(text)
    except ValueError:
        radius = math.nan
    if 0 <= radius <= most:
        return radius
    raise RecipeError(
        "this radius is too large for the window" if radius > most else "this is no radius",
        parameter="radii",
        expected=f"metres, 0 to {most:g}: beyond, nothing can correct for the window's edges",
        got=text.strip(),
    )


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
