"""The command `fit-kernel`: kernels of a measured stand, as a recipe that places new ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from forestgen.cli.arguments import Overwrite, Quiet, Seed, progress_of
from forestgen.cli.console import Printer


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
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--out",
            "-o",
            metavar="PATH",
            help="A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
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
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Fit deformation kernels to a measured stand: a recipe that places new stands like it."""
    import forestgen

    fitted = forestgen.fit_kernel(
        points,
        window=window,
        species=species,
        out=out or Path("outputs") / f"{points.stem}-kernel.yaml",
        seed=seed,
        reach_m=reach_m,
        checks=checks,
        founders=founders,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    Printer(quiet)(str(fitted))
