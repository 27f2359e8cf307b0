"""The command `stats`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from forestgen.cli.arguments import Json


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
    from forestgen.cli.stats import stats as print_stats

    print_stats(points, window, radii or [], as_json)
