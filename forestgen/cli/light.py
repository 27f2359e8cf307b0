"""forestgen light: what a light meter reads at points of a recipe's site."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from forestgen.cli.arguments import AbsoluteZ, Overrides, Overwrite, Quiet, RecipePath, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import seconds

_LIKE_A_NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)", re.IGNORECASE)


class PointsCommand(typer.core.TyperCommand):
    """A command whose option --at takes three numbers, and may be repeated: typer has no such options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, join_points(args))


def join_points(arguments: Sequence[str]) -> list[str]:
    """`--at x y z` as `--at=x,y,z`; what is no point is left for the API to refuse."""
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


Points = Annotated[
    list[str] | None,
    typer.Option("--at", metavar="X Y Z", help="A point, metres, z above ground. May be repeated."),
]
Normals = Annotated[
    list[str] | None,
    typer.Option(
        "--normal",
        metavar="DIRECTION",
        help="Where the meter looks: up, down, north, east, south, west, or x,y,z. May be repeated.",
        show_default="up",
    ),
]
Spectrum = Annotated[
    float | None,
    typer.Option(
        "--spectrum",
        metavar="NM",
        min=1.0,
        max=1100.0,
        help="Tell the spectral irradiance too, 300 to 2500 nm, in steps of NM.",
    ),
]
Samples = Annotated[
    int,
    typer.Option(
        "--samples", metavar="N", min=512, max=100_000_000, help="Light paths of each light at each wavelength."
    ),
]


def light(
    recipe: RecipePath,
    at: Points = None,
    normals: Normals = None,
    spectrum: Spectrum = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="A .csv or .json file.")] = None,
    samples: Samples = 16384,
    absolute_z: AbsoluteZ = False,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Measure light at points: lux, sun and sky, colour temperature, PAR, W/m², spectrum.

    A flat meter with a cosine response, from all directions above it: sun, sky and what plants and ground scatter.
    Every figure has a standard error, from eight independent replicates.
    """
    from forestgen import load
    from forestgen.core.errors import RecipeError

    if not at:
        raise RecipeError("no point was given", where="--at", expected="--at X Y Z, metres", hint="--at 30 40 1.5")
    started = time.perf_counter()
    readings = load(recipe, set=overrides or ()).light(
        [one.split(",") for one in at],
        normals=normals or ["up"],
        samples=samples,
        absolute_z=absolute_z,
        out=out,
        spectrum=spectrum,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    say = Printer(quiet)
    say(str(readings))
    say(f"measured in {seconds(time.perf_counter() - started)}")
    if out is not None:
        say(f"files: {out}")
