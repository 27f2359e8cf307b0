"""`forestgen fit-kernel` as the command line reads it; `fit_report.py` does what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from forestgen.cli.console import Bars


def fit_kernel(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A CSV file with columns x,y in metres, and perhaps species and radius_m; # begins a comment.",
            show_default=False,
        ),
    ],
    window: Annotated[
        Optional[tuple[float, float, float, float]],  # noqa: UP045
        typer.Option(
            "--window",
            metavar="X0 X1 Y0 Y1",
            help="Where plants were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
            show_default=False,
        ),
    ] = None,
    species: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--species",
            metavar="NAME",
            help="What new plants look like: a species of the library; by default poplar, where the library does not "
            "know the names in the file.",
            show_default=False,
        ),
    ] = None,
    target: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Another seed fits by other new stands.")] = 0,
    reach_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--reach-m",
            metavar="METRES",
            help="How far a plant acts; by default a quarter of the window, or six spacings if less.",
            show_default=False,
        ),
    ] = None,
    checks: Annotated[
        int, typer.Option("--checks", metavar="N", min=1, max=1000, help="Test against N sets of 39 new stands.")
    ] = 1,
    founders: Annotated[
        bool,
        typer.Option(
            "--founders/--no-founders",
            help="Where one kernel leaves nearest neighbours far off, let some plants come first and draw the others.",
        ),
    ] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Fit deformation kernels to a measured stand: a recipe that places new stands like it."""
    from forestgen.cli import fit_report

    settings = {"seed": seed, "checks": checks, "reach_m": reach_m, "founders": founders}
    fit_report.fit_kernel(points, window, species, target, settings, Bars(), overwrite=overwrite)
