"""forestgen calibrate: a colour chart in a recipe's scene, and how right its colours are."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forestgen.cli.arguments import AbsoluteZ, Overrides, Overwrite, Quiet, RecipePath, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import seconds

if TYPE_CHECKING:
    from forestgen.instruments.calibration import Calibration

Folder = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Folder for the sheet; by default outputs/NAME-calibration, ...-2, ..."
    ),
]
Middle = Annotated[
    list[str] | None,
    typer.Option(
        "--at",
        metavar="X Y Z",
        help="The board's middle, metres, z above ground; by default over the site's middle, above all plants.",
    ),
]
Normal = Annotated[
    str,
    typer.Option(
        "--normal", metavar="DIRECTION", help="Where the board looks: up, north, east, south, west, or x,y,z."
    ),
]
WidthPx = Annotated[
    int, typer.Option("--width-px", metavar="N", min=64, max=1024, help="Width of the chart's picture.")
]
Samples = Annotated[
    int, typer.Option("--samples", metavar="N", min=4, max=65536, help="Light paths a pixel, of each light.")
]


def calibrate(
    recipe: RecipePath,
    out: Folder = None,
    at: Middle = None,
    normal: Normal = "up",
    width_px: WidthPx = 96,
    samples: Samples = 64,
    absolute_z: AbsoluteZ = False,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Check the colours: a ColorChecker and a grey card in the recipe's scene.

    Renders them at 81 wavelengths, in the spectral and in the rgb mode. Prints CIE delta E 2000 of each patch against
    colour-science, illuminance and colour temperature, and writes a sheet (calibration.html) and its numbers.

    Exit code 0 if mean delta E is below 0.5, max below 1.5, and the grey card agrees with a light meter; 5 if not.
    """
    from forestgen import load
    from forestgen.core.errors import RecipeError
    from forestgen.instruments.calibration import SHEET

    if at is not None and len(at) > 1:
        raise RecipeError("one chart at a time", where="--at", expected="one point", got=f"{len(at)}")
    started, say = time.perf_counter(), Printer(quiet)
    found, folder = load(recipe, set=overrides or ()).calibrate(
        out,
        at=at[0].split(",") if at else None,
        normal=normal,
        width_px=width_px,
        samples=samples,
        absolute_z=absolute_z,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    say(str(found))
    say(f"calibrated in {seconds(time.perf_counter() - started)}")
    say(f"files: {folder}/ (look at {folder / SHEET})")
    _fail_if_missed(found, folder)


def _fail_if_missed(found: Calibration, folder: Path) -> None:
    from forestgen.core.errors import RenderError

    missed = [check for check in found.checks if not check.holds]
    if missed:
        raise RenderError(
            "the calibration misses " + ("a bound" if len(missed) == 1 else f"{len(missed)} bounds"),
            where=str(folder),
            expected="; ".join(f"{check.name} below {check.bound:.3g}" for check in missed),
            got="; ".join(f"{check.value:.3g}" for check in missed),
            hint="more --samples if the picture is noisy; another --at if the chart lies in broken shade",
        )
