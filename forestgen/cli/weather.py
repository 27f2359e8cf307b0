"""forestgen weather: the simulated weather of a recipe, in numbers, as a picture and as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import Overrides, RecipePath
from forestgen.cli.console import Bars, output, seconds

if TYPE_CHECKING:
    from forestgen.stages.weather import Report

_FIELDS = (".nc", ".vol", ".vdb")


def weather(
    recipe: RecipePath,
    images: Annotated[
        Optional[int],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--images", metavar="N", min=1, help="The weather of so many images; by default all.", show_default=False
        ),
    ] = None,
    targets: Annotated[
        Optional[list[Path]],  # noqa: UP045
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Of the last image: .nc, the state of the air; .vol or .vdb, its extinction for Mitsuba or Blender. "
            "May be repeated.",
            show_default=False,
        ),
    ] = None,
    picture: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--picture",
            metavar="FILE",
            help="A PNG: clouds from the side, cut through, and from below; a row an image.",
            show_default=False,
        ),
    ] = None,
    overrides: Overrides = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Simulate a recipe's weather only: base, top and cover of its clouds, their water, rain."""
    from forestgen.core.errors import RecipeError
    from forestgen.core.timing import Timings
    from forestgen.stages.load_checked import load_checked
    from forestgen.stages.plant_files import check_writable
    from forestgen.stages.weather import plot_weather, weather_report

    outputs = targets or []
    for one in outputs:
        if one.suffix.lower() not in _FIELDS:
            raise RecipeError("no such kind of file", where="--out", expected=" or ".join(_FIELDS), got=str(one))
    if picture is not None and picture.suffix.lower() != ".png":
        raise RecipeError("no such kind of picture", where="--picture", expected=".png", got=str(picture))
    check_writable([*outputs, *([picture] if picture else [])], overwrite=overwrite)
    loaded = load_checked(recipe, overrides or [])
    bars, timings = Bars(), Timings()
    with bars.running(), timings("weather"):
        reports = [weather_report(loaded.draw(index), bars) for index in range(images or loaded.images)]
    _print(reports)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        plot_weather(reports, picture)
    for one in outputs:
        _save(one, reports[-1])
    if all(report.statistics.cover == 0 for report in reports):
        output().print("there are no clouds at this time; a larger sky.clouds.time_s may have some", markup=False)
    output().print(f"simulated in {seconds(timings.seconds['weather'])}", markup=False)
    for one in [*outputs, *([picture] if picture else [])]:
        output().print(f"file: {one}", markup=False)


def _save(path: Path, report: Report) -> None:
    from forestgen.atmosphere.extinction import cloud_grid_of
    from forestgen.atmosphere.weather_files import write_clouds, write_weather
    from forestgen.core.errors import OutputError

    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".nc":
        write_weather(path, report.weather, droplet_radius_um=report.droplet_radius_um)
        return
    grid = cloud_grid_of(report.weather, kind=report.kind, centre_m=None, droplet_radius_um=report.droplet_radius_um)
    if grid is None:
        raise OutputError("there are no clouds to write", where=str(path), hint="save the air as .nc")
    write_clouds(path, grid)


def _print(reports: list[Report]) -> None:
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
    widths = [max(len(row[k]) for row in rows) for k in range(len(names))]
    for row in rows:
        line = "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        output().print(line, markup=False)
    output().print(
        "base, top: above the ground, where droplets are 0.01 g/kg and more; depth: optical, straight up, of cloudy "
        "columns; cloud, rain: mean water of a column; fallen: rain on the ground so far; up: the strongest updraught",
        markup=False,
    )
