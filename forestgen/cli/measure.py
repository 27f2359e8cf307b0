"""forestgen measure: any instrument in a recipe's scene."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.arguments import Overrides, Overwrite, Quiet, RecipePath, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import seconds

InstrumentName = Annotated[
    str, typer.Argument(metavar="NAME", help="An instrument, see forestgen models --kind instrument.")
]
Keys = Annotated[
    list[str] | None,
    typer.Option(
        "--key",
        metavar="KEY=VALUE",
        help="A key of the instrument, such as at=[[30,40,1.5]]; its page, forestgen models NAME, has them. May be "
        "repeated.",
    ),
]


def measure(
    instrument: InstrumentName,
    recipe: RecipePath,
    keys: Keys = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="A .json file, or another that its page names.")
    ] = None,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Measure in a recipe's scene: light, colours, gaps of the canopy, or what an installed package adds."""
    from forestgen import load

    started, say = time.perf_counter(), Printer(quiet)
    reading = load(recipe, set=overrides or ()).measure(
        instrument, keys or (), out=out, overwrite=overwrite, progress=progress_of(quiet)
    )
    say(str(reading))
    say(f"measured in {seconds(time.perf_counter() - started)}")
    if out is not None:
        say(f"files: {out}")
