"""forestgen calibrate: a colour chart in a recipe's scene, and how right its colours are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import Overrides, RecipePath
from forestgen.cli.console import Bars, output, seconds
from forestgen.cli.light import normal_of, point_of

if TYPE_CHECKING:
    from forestgen.stages.calibrate import Calibration


def calibrate(
    recipe: RecipePath,
    target: Annotated[
        Optional[Path],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--output",
            "-o",
            "--out",
            metavar="FOLDER",
            help="Folder for the sheet; by default outputs/NAME-calibration, ...-2, ...",
            show_default=False,
        ),
    ] = None,
    at: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--at",
            metavar="X Y Z",
            help="The board's middle, metres, z above ground; by default over the site's middle, above all plants.",
            show_default=False,
        ),
    ] = None,
    normal: Annotated[
        str,
        typer.Option(
            "--normal", metavar="DIRECTION", help="Where the board looks: up, north, east, south, west, or x,y,z."
        ),
    ] = "up",
    width_px: Annotated[
        int, typer.Option("--width-px", metavar="N", min=64, max=1024, help="Width of the chart's picture.")
    ] = 96,
    samples: Annotated[
        int, typer.Option("--samples", metavar="N", min=4, max=65536, help="Light paths a pixel, of each light.")
    ] = 64,
    absolute_z: Annotated[
        bool, typer.Option("--absolute-z", help="Count z from z = 0, not from the ground below.")
    ] = False,
    overrides: Overrides = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a previous forestgen output in that folder.")
    ] = False,
) -> None:
    """Check the colours: a ColorChecker and a grey card in the recipe's scene.

    Renders them at 81 wavelengths, in the spectral and in the rgb mode. Tells CIE delta E 2000 of each patch against
    colour-science, illuminance and colour temperature, and writes a sheet (calibration.html) and its numbers.

    Exit code 0 if mean delta E is below 0.5, max below 1.5, and the grey card agrees with a light meter; 5 if not.
    """
    _calibrate(recipe, target, at or [], normal, width_px, samples, absolute_z, overrides or [], overwrite)


def _calibrate(
    recipe: Path,
    target: Path | None,
    at: Sequence[str],
    normal: str,
    width_px: int,
    samples: int,
    absolute_z: bool,
    overrides: Sequence[str],
    overwrite: bool,
) -> None:
    from forestgen.cli.commands import output_folder
    from forestgen.core.errors import RecipeError
    from forestgen.core.timing import Timings
    from forestgen.dataset.folder import OutputFolder
    from forestgen.dataset.manifest import build_manifest, write_manifest
    from forestgen.stages import calibrate as stage
    from forestgen.stages.calibration_files import SHEET, write_calibration
    from forestgen.stages.load_checked import load_checked

    if len(at) > 1:
        raise RecipeError("one chart at a time", where="--at", expected="one point", got=f"{len(at)}")
    point, towards = (point_of(at[0]) if at else None), normal_of(normal)
    timings, bars = Timings(), Bars()
    loaded = load_checked(recipe, overrides)
    folder = output_folder(target, recipe.with_name(f"{recipe.stem}-calibration"))
    with bars.running(), OutputFolder(folder, overwrite=overwrite) as staging:
        found = stage.calibrate(
            loaded,
            at=point,
            normal=towards,
            above_ground=not absolute_z,
            width_px=width_px,
            samples=samples,
            progress=bars,
            timings=timings,
        )
        write_calibration(staging, found, loaded, samples)
        manifest = build_manifest(
            staging,
            recipe_hash=loaded.hash,
            root_seed=loaded.seed,
            image_seeds=[],
            timings_s=timings.seconds,
            extra={"calibration_holds": found.holds},
        )
        write_manifest(staging, manifest)
    _print(found)
    out = output()
    out.print(f"calibrated in {seconds(timings.total())}", markup=False)
    out.print(f"files: {folder}/ (look at {folder / SHEET})", markup=False)
    _fail_if_missed(found, folder)


def _print(found: Calibration) -> None:
    from forestgen.stages.calibrate import MODES

    out = output()
    x, y, _ = found.point_m
    out.print(f"chart at {x:g} {y:g}, {found.above_ground_m:.2f} m above the ground", markup=False)
    out.print(f"{'delta E 2000':<24}" + "".join(f"{title:>16}" for title in MODES.values()), markup=False)
    for patch in found.patches:
        out.print(f"{patch.name:<24}" + "".join(f"{patch.delta_e[mode]:>16.2f}" for mode in MODES), markup=False)
    for word in ("mean", "max"):
        values = (float(getattr(found.delta_e(mode), word)()) for mode in MODES)
        out.print(f"{word:<24}" + "".join(f"{value:>16.2f}" for value in values), markup=False)
    meter, white = found.meter, found.white
    out.print(
        f"illuminance {found.illuminance_lux:,.0f} lux by the grey card, {meter.illuminance_lux.value:,.0f} ± "
        f"{meter.illuminance_lux.error:,.0f} by a light meter; {100 * meter.from_sun.value:.0f}% straight from the sun",
        markup=False,
    )
    cct = "none" if math.isnan(white.cct_k) else f"{white.cct_k:,.0f} K"
    out.print(f"correlated colour temperature {cct}, Duv {white.duv:+.4f}", markup=False)
    for note in found.notes:
        out.print(f"note: {note}", markup=False)


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
