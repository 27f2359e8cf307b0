"""The command `weather`: the simulated weather of a recipe, in numbers, as a picture and as files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forestgen.cli.arguments import Count, Overrides, Overwrite, Quiet, RecipePath, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import seconds, table_lines

if TYPE_CHECKING:
    from forestgen.atmosphere.clouds.source import WeatherReport


def weather(
    recipe: RecipePath,
    images: Count = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Of the last image: .nc, the state of the air; .vol or .vdb, its extinction for Mitsuba or Blender. "
            "May be repeated.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            metavar="FILE",
            help="A PNG: clouds from the side, cut through, and from below; a row an image.",
        ),
    ] = None,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a recipe's weather only: base, top and cover of its clouds, their water, rain."""
    from forestgen import load

    started = time.perf_counter()
    reports = load(recipe, set=overrides or ()).weather(
        images, out=out or (), picture=picture, overwrite=overwrite, progress=progress_of(quiet)
    )
    say = Printer(quiet)
    _print(reports, say)
    if all(report.statistics.cover == 0 for report in reports):
        say("there are no clouds at this time; a larger sky.clouds.time_s may have some")
    say(f"simulated in {seconds(time.perf_counter() - started)}")
    for one in [*(out or []), *([picture] if picture else [])]:
        say(f"file: {one}")


def _print(reports: Sequence[WeatherReport], say: Printer) -> None:
    names = ("image", "type", "time", "cover", "base", "top", "depth", "cloud", "rain", "fallen", "up")
    units = ("", "", "s", "%", "m", "m", "", "g/m²", "g/m²", "mm", "m/s")
    rows = [names, units]
    for number, report in enumerate(reports):
        one = report.statistics
        rows.append(
            (
                str(number),
                report.kind,
                f"{one.time_s:.0f}",
                f"{100 * one.cover:.0f}",
                "none" if one.base_m is None else f"{one.base_m:.0f}",
                "none" if one.top_m is None else f"{one.top_m:.0f}",
                f"{one.optical_depth:.1f}",
                f"{1000 * one.cloud_kg_per_m2:.1f}",
                f"{1000 * one.rain_kg_per_m2:.1f}",
                f"{one.fallen_kg_per_m2:.2f}",
                f"{one.updraught_m_per_s:.1f}",
            )
        )
    for line in table_lines(rows, names_left=False):
        say(line)
    say(
        "base, top: above the ground, where droplets are 0.01 g/kg and more; depth: optical, straight up, of cloudy "
        "columns; cloud, rain: mean water of a column; fallen: rain on the ground so far; up: the strongest updraught"
    )
