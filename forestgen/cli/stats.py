"""The command `stats`: how the points of a file lie, as a table or as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.arguments import Json
from forestgen.cli.console import Printer


def stats(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A CSV file with columns x,y in metres; # begins a comment.", show_default=False
        ),
    ],
    window: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            "--window",
            metavar="X0 X1 Y0 Y1",
            help="Where points were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
        ),
    ] = None,
    radii: Annotated[
        list[str] | None, typer.Option("--radii", metavar="R...", help="Radii of Ripley's K, metres: --radii 1 2 4.")
    ] = None,
    as_json: Json = False,
) -> None:
    """How points lie: clustered, random, regular."""
    from forestgen import stats as measure

    measured, say = measure(points, window=window, radii=radii or ()), Printer()
    if as_json:
        say.json(measured.as_dict())
    else:
        say(f"{points}: {measured}")
