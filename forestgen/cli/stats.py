"""The command `stats`: how the points of a file lie, as a table or as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import Json
from forestgen.cli.console import Printer, count

if TYPE_CHECKING:
    from forestgen.community.point_statistics import PointStatistics

_Z = 1.96  # of a normal distribution, 95% lies within so many standard errors


def stats(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A CSV file with columns x,y in metres; # begins a comment.", show_default=False
        ),
    ],
    window: Annotated[
        Optional[tuple[float, float, float, float]],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--window",
            metavar="X0 X1 Y0 Y1",
            help="Where points were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
            show_default=False,
        ),
    ] = None,
    radii: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option("--radii", metavar="R...", help="Radii of Ripley's K, metres: --radii 1 2 4.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """How points lie: clustered, random, regular."""
    from forestgen import stats as measure

    measured, say = measure(points, window=window, radii=radii or ()), Printer()
    if as_json:
        say.json(measured.as_dict())
    else:
        _print(points, measured, say)


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


def _print(path: Path, measured: PointStatistics, say: Printer) -> None:
    from forestgen.community.ripley import besag_l, ripley_bound

    say(f"{path}: {count(measured.n, 'point')} in {measured.window}")
    say(f"density {measured.density:.6g} per m²")
    say()
    say.table([("index", "value", "error", "pattern"), *_rows(measured)])
    say("errors are standard errors; Hopkins is above 1 for clusters, the others below 1")
    say()
    rows = [("r (m)", "K isotropic", "K translation", "π r² (m²)", "L - r (m)", "pattern")]
    bound_m = ripley_bound(measured.n, measured.window)
    functions = zip(measured.radii_m, measured.k_isotropic_m2, measured.k_translation_m2, strict=True)
    for r, isotropic, translation in functions:
        excess_m = float(besag_l(isotropic)) - float(r)
        numbers = (f"{one:.6g}" for one in (r, isotropic, translation, math.pi * r * r))
        rows.append((*numbers, f"{excess_m:+.4g}", _word(excess_m, bound_m / _Z)))  # type: ignore[arg-type]
    say.table(rows)
    for note in measured.notes:
        say(f"note: {note}")
