"""The command `fit-kernel`: kernels of a measured stand, as a recipe that places new ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.arguments import Overwrite, Quiet, Seed, progress_of
from forestgen.cli.console import Printer

Points = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="A CSV file with columns x,y in metres, and perhaps species and radius_m; # begins a comment.",
        show_default=False,
    ),
]
Window = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--window",
        metavar="X0 X1 Y0 Y1",
        help="Where plants were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
    ),
]
Species = Annotated[
    str | None,
    typer.Option(
        "--species",
        metavar="NAME",
        help="What new plants look like: a species of the library; by default poplar, where the library does not "
        "know the names in the file.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="PATH",
        help="A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.",
    ),
]
ReachM = Annotated[
    float | None,
    typer.Option(
        "--reach-m",
        metavar="METRES",
        help="How far a plant acts; by default a quarter of the window, or six spacings if less.",
    ),
]
Checks = Annotated[
    int, typer.Option("--checks", metavar="N", min=1, max=1000, help="Test against N sets of 39 new stands.")
]
Founders = Annotated[
    bool,
    typer.Option(
        "--founders/--no-founders",
        help="Where one kernel leaves nearest neighbours far off, let some plants come first and draw the others.",
    ),
]


def fit_kernel(
    points: Points,
    window: Window = None,
    species: Species = None,
    out: Out = None,
    seed: Seed = 0,
    reach_m: ReachM = None,
    checks: Checks = 1,
    founders: Founders = True,
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
