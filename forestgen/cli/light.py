"""forestgen light: what a light meter reads at points of a recipe's site."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from forestgen.cli.arguments import Overrides, RecipePath
from forestgen.cli.console import Bars, output, seconds

if TYPE_CHECKING:
    from forestgen.stages.light import LightMeter, Point, Quantity

_LIKE_A_NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)", re.IGNORECASE)
_ENDINGS = (".csv", ".json")


class PointsCommand(typer.core.TyperCommand):
    """A command whose option --at takes three numbers, and may be repeated: typer has no such options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, join_points(args))


def join_points(arguments: Sequence[str]) -> list[str]:
    """`--at x y z` as `--at=x,y,z`; what is no point is left for `point_of` to refuse."""
    joined: list[str] = []
    rest = list(arguments)
    while rest:
        one = rest.pop(0)
        if one == "--":
            return [*joined, one, *rest]
        if one != "--at":
            joined.append(one)
            continue
        numbers = list(itertools.takewhile(_LIKE_A_NUMBER.match, rest[:3]))
        joined.append("--at=" + ",".join(numbers))
        del rest[: len(numbers)]
    return joined


def point_of(text: str) -> Point:
    """A point of three numbers.

    Raises
    ------
    RecipeError : there are more or fewer, or one is no number.
    """
    from forestgen.core.errors import RecipeError

    try:
        x, y, z = (float(one) for one in text.split(","))
    except ValueError:
        raise RecipeError(
            "this is no point",
            where="--at",
            expected="three numbers, metres: --at 30 40 1.5",
            got=text.replace(",", " "),
        ) from None
    return x, y, z


def normal_of(text: str) -> Point:
    """A direction by its name or its components.

    Raises
    ------
    RecipeError : neither.
    """
    from forestgen.core.errors import RecipeError
    from forestgen.recipe.cameras import DIRECTIONS

    if text.lower() in DIRECTIONS:
        return DIRECTIONS[text.lower()]
    try:
        x, y, z = (float(one) for one in text.split(","))
        length = math.sqrt(x * x + y * y + z * z)
    except ValueError:
        length = math.nan
    if not (math.isfinite(length) and length > 1e-9):
        expected = ", ".join(DIRECTIONS) + ", or x,y,z such as 0,0.5,1"
        raise RecipeError("this is no direction", where="--normal", expected=expected, got=text)
    return x / length, y / length, z / length


def light(
    recipe: RecipePath,
    at: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--at", metavar="X Y Z", help="A point, metres, z above ground. May be repeated.", show_default=False
        ),
    ] = None,
    normals: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--normal",
            metavar="DIRECTION",
            help="Where the meter looks: up, down, north, east, south, west, or x,y,z. May be repeated.",
            show_default="up",
        ),
    ] = None,
    spectrum: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--spectrum",
            metavar="NM",
            min=1.0,
            max=1100.0,
            help="Tell the spectral irradiance too, 300 to 2500 nm, in steps of NM.",
            show_default=False,
        ),
    ] = None,
    target: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--output", "-o", "--out", metavar="FILE", help="A .csv or .json file.", show_default=False),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            "--samples", metavar="N", min=512, max=100_000_000, help="Light paths of each light at each wavelength."
        ),
    ] = 16384,
    absolute_z: Annotated[
        bool, typer.Option("--absolute-z", help="Count z from z = 0, not from the ground below.")
    ] = False,
    overrides: Overrides = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Measure light at points: lux, sun and sky, colour temperature, PAR, W/m², spectrum.

    A flat meter with a cosine response, from all directions above it: sun, sky and what plants and ground scatter.
    Every figure has a standard error, from eight independent replicates.
    """
    _measure(recipe, at or [], normals or ["up"], spectrum, target, samples, absolute_z, overrides or [], overwrite)


def _measure(
    recipe: Path,
    at: Sequence[str],
    normals: Sequence[str],
    spectrum: float | None,
    target: Path | None,
    samples: int,
    absolute_z: bool,
    overrides: Sequence[str],
    overwrite: bool,
) -> None:
    from forestgen.core.errors import RecipeError
    from forestgen.core.timing import Timings
    from forestgen.stages import light as stage
    from forestgen.stages.load_checked import load_checked
    from forestgen.stages.plant_files import FileSet, check_writable

    if not at:
        raise RecipeError("no point was given", where="--at", expected="--at X Y Z, metres", hint="--at 30 40 1.5")
    if target is not None:
        if target.suffix.lower() not in _ENDINGS:
            raise RecipeError("no such kind of file", where="--output", expected=" or ".join(_ENDINGS), got=str(target))
        check_writable([target], overwrite=overwrite)
    points = [point_of(one) for one in at]
    directions = [normal_of(one) for one in normals]
    timings, bars = Timings(), Bars()
    loaded = load_checked(recipe, overrides)
    with bars.running():
        meters = stage.light_at(
            loaded, points, directions, samples=samples, above_ground=not absolute_z, progress=bars, timings=timings
        )
    _print(meters, spectrum)
    out = output()
    if target is not None:
        step = spectrum or 10.0
        content = (
            stage.as_json(meters, loaded, samples=samples, step_nm=step)
            if target.suffix.lower() == ".json"
            else stage.as_csv(meters, step_nm=spectrum)
        )
        with FileSet(overwrite=overwrite) as files:
            files.write(target, content)
    out.print(f"measured in {seconds(timings.seconds['light'])}", markup=False)
    if target is not None:
        out.print(f"files: {target}", markup=False)


def _print(meters: Sequence[LightMeter], step_nm: float | None) -> None:
    turned = {meter.normal for meter in meters} != {(0.0, 0.0, 1.0)}
    rows = [
        ["x", "y", "z", *(["normal"] if turned else []), "lux", "sun", "sky", "scattered", "CCT (K)", "PAR", "W/m²"]
    ]
    for meter in meters:
        scattered = 1.0 - meter.from_sun.value - meter.from_sky.value
        shares = (meter.from_sun.value, meter.from_sky.value, scattered)
        rows.append(
            [
                *(f"{value:g}" for value in meter.point_m[:2]),
                f"{meter.above_ground_m:.2f}",
                *([",".join(f"{value:.2g}" for value in meter.normal)] if turned else []),
                told(meter.illuminance_lux),
                *(f"{100 * max(share, 0.0):.1f}%" for share in shares),
                "none" if math.isnan(meter.cct_k.value) else told(meter.cct_k),
                told(meter.par_umol_per_m2_s),
                told(meter.irradiance_w_per_m2),
            ]
        )
    out = output()
    _columns(rows)
    out.print("x, y and z (above ground) in metres; PAR: µmol/m²/s of 400 to 700 nm; W/m² of 300 to 2500 nm")
    out.print("sun, sky: their direct shares of the lux; the rest was scattered by plants and ground; ± standard error")
    if step_nm is not None:
        _spectra(meters, step_nm)
    for number, meter in enumerate(meters, start=1):
        if meter.note:
            out.print(f"note: point {number}: {meter.note}", markup=False)


def _columns(rows: Sequence[Sequence[str]]) -> None:
    """Right-aligned columns as wide as they must be: rich would cut them to the terminal's width."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        line = "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        output().print(line, markup=False)


def _spectra(meters: Sequence[LightMeter], step_nm: float) -> None:
    from forestgen.stages.light import sampled

    columns = [sampled(meter, step_nm) for meter in meters]
    rows = [["nm", *(f"point {number + 1}" for number in range(len(meters)))]]
    rows += [[f"{row[0][0]:g}", *(f"{value:.4g}" for _, value, _ in row)] for row in zip(*columns, strict=True)]
    output().print()
    _columns(rows)
    output().print("W/m²/nm, means over each step")


def told(one: Quantity) -> str:
    """A value to at most five digits and no more than its error leaves, and that error."""
    value, error = one.value, one.error
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    places = 4 - math.floor(math.log10(abs(value)))
    if not (math.isfinite(error) and error > 0):
        return _plain(value, places)
    places = min(places, 1 - math.floor(math.log10(error)))
    return f"{_plain(value, places)} ± {_plain(max(error, 10.0**-places), places)}"


def _plain(value: float, places: int) -> str:
    """Rounded to decimal places; a negative number of them rounds to tens, hundreds, ..."""
    return f"{round(value, places):,.{max(places, 0)}f}"
