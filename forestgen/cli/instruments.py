"""The commands that measure in a recipe's scene and make no data set: `measure`, `light`, `stand`, `calibrate`, ..."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forestgen.cli.console import Printer
from forestgen.core.figures import seconds, table_lines

if TYPE_CHECKING:
    from forestgen.api.rendering import ImageWeather


def measure(
    instrument: str,
    recipe: Path,
    keys: list[str] | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Measure in a recipe's scene: light, colours, gaps of the canopy, or what an installed package adds.

    NAME  An instrument, see forestgen models --kind instrument.
    --key KEY=VALUE  A key of the instrument, such as at=[[30,40,1.5]]; its page, forestgen models NAME, has them. May
        be repeated.
    --out -o FILE  A .json file, or another that its page names.
    """
    _measure(recipe, set_, instrument, keys or (), out, overwrite, quiet)


def _measure(
    recipe: Path,
    overrides: list[str] | None,
    instrument: str,
    keys: Sequence[str] | Mapping[str, Any],
    out: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    from forestgen import load

    started, say = time.perf_counter(), Printer(quiet)
    loaded = load(recipe, set=overrides)
    say(str(loaded.measure(instrument, keys, out=out, overwrite=overwrite, progress=not quiet)))
    say(f"measured in {seconds(time.perf_counter() - started)}")
    if out is not None:
        say(f"files: {out}")


def light(
    recipe: Path,
    at: list[str] | None = None,
    normals: list[str] | None = None,
    spectrum: float | None = None,
    out: Path | None = None,
    samples: int = 16384,
    absolute_z: bool = False,
    set_: list[str] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Measure light at points: lux, sun and sky, colour temperature, PAR, W/m², spectrum.

    A flat meter with a cosine response, from all directions above it: sun, sky and what plants and ground scatter.
    Every figure has a standard error, from eight independent replicates.

    --at X Y Z  A point, metres, z above ground. May be repeated.
    --normal DIRECTION  Where the meter looks: up, down, north, east, south, west, or x,y,z. May be repeated.
        [default: up]
    --spectrum NM  Tell the spectral irradiance too, 300 to 2500 nm, in steps of NM. [1 to 1100]
    --out -o FILE  A .csv or .json file.
    --samples N  Light paths of each light at each wavelength. [512 to 100000000]
    """
    from forestgen.core.errors import RecipeError
    from forestgen.instruments.light_meter import INSTRUMENT

    if not at:
        raise RecipeError("no point was given", where="--at", expected="--at X Y Z, metres", hint="--at 30 40 1.5")
    points = [one.split(",") for one in at]
    keys = {"samples": samples, "absolute_z": absolute_z, "spectrum": spectrum, "normals": normals or ["up"]}
    _measure(recipe, set_, INSTRUMENT.name, {"at": points, **keys}, out, overwrite, quiet)


def stand(
    recipe: Path,
    out: Path | None = None,
    min_dbh_cm: float = 7.0,
    set_: list[str] | None = None,
    json_: bool = False,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Measure the stand that a recipe renders, by species and storey, as a forester does.

    Prints stems, basal area, diameter, heights, slenderness, stem volume, biomass, leaf area index, and cover by
    vertical rays. The plants are grown as for a picture, and their geometry is measured; no light is traced.

    --out -o DIR  Folder for stand.csv, stand.json and two pictures: heights over diameters, leaf area by height.
    --min-dbh-cm CM  Least diameter at 1.3 m of what counts as a stem.
    """
    from forestgen import load

    started, say = time.perf_counter(), Printer(quiet)
    table = load(recipe, set=set_).stand(out, min_dbh_cm=min_dbh_cm, overwrite=overwrite, progress=not (quiet or json_))
    if json_:
        say.json(table.as_dict())
        return
    say(str(table))
    say(f"measured in {seconds(time.perf_counter() - started)}")
    if out is not None:
        say(f"files: {out}/")


def calibrate(
    recipe: Path,
    out: Path | None = None,
    at: list[str] | None = None,
    normal: str = "up",
    width_px: int = 96,
    samples: int = 64,
    absolute_z: bool = False,
    set_: list[str] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Check the colours: a ColorChecker and a grey card in the recipe's scene.

    Renders them at 81 wavelengths, in the spectral and in the rgb mode. Prints CIE delta E 2000 of each patch against
    colour-science, illuminance and colour temperature, and writes a sheet (calibration.html) and its numbers.

    Exit code 0 if mean delta E is below 0.5, max below 1.5, and the grey card agrees with a light meter; 5 if not.

    --out -o DIR  Folder for the sheet; by default outputs/NAME-calibration, ...-2, ...
    --at X Y Z  The board's middle, metres, z above ground; by default over the site's middle, above all plants.
    --normal DIRECTION  Where the board looks: up, north, east, south, west, or x,y,z.
    --width-px N  Width of the chart's picture. [64 to 1024]
    --samples N  Light paths a pixel, of each light. [4 to 65536]
    """
    from forestgen import load
    from forestgen.core.errors import RecipeError, RenderError
    from forestgen.instruments.calibration import SHEET

    if at is not None and len(at) > 1:
        raise RecipeError("one chart at a time", where="--at", expected="one point", got=f"{len(at)}")
    started, say = time.perf_counter(), Printer(quiet)
    found, folder = load(recipe, set=set_).calibrate(
        out,
        at=at[0].split(",") if at else None,
        normal=normal,
        width_px=width_px,
        samples=samples,
        absolute_z=absolute_z,
        overwrite=overwrite,
        progress=not quiet,
    )
    say(str(found))
    say(f"calibrated in {seconds(time.perf_counter() - started)}")
    say(f"files: {folder}/ (look at {folder / SHEET})")
    if missed := [check for check in found.checks if not check.holds]:
        problem = "the calibration misses " + ("a bound" if len(missed) == 1 else f"{len(missed)} bounds")
        expected = "; ".join(f"{check.name} below {check.bound:.3g}" for check in missed)
        got = "; ".join(f"{check.value:.3g}" for check in missed)
        hint = "more --samples if the picture is noisy; another --at if the chart lies in broken shade"
        raise RenderError(problem, where=str(folder), expected=expected, got=got, hint=hint)


def weather(
    recipe: Path,
    count_: int | None = None,
    out: list[Path] | None = None,
    picture: Path | None = None,
    set_: list[str] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Simulate a recipe's weather only: base, top and cover of its clouds, their water, rain.

    --out -o FILE  Of the last image: .nc, the state of the air; .vol or .vdb, its extinction for Mitsuba or Blender.
        May be repeated.
    --picture FILE  A PNG: clouds from the side, cut through, and from below; a row an image.
    """
    from forestgen import load

    started, say = time.perf_counter(), Printer(quiet)
    reports = load(recipe, set=set_).weather(
        count_, out=out or (), picture=picture, overwrite=overwrite, progress=not quiet
    )
    _print_weather(reports, say)
    if all(report.statistics.cover == 0 for report in reports):
        say("there are no clouds at this time; a larger sky.clouds.time_s may have some")
    say(f"simulated in {seconds(time.perf_counter() - started)}")
    for one in [*(out or []), *([picture] if picture else [])]:
        say(f"file: {one}")


def _print_weather(reports: Sequence[ImageWeather], say: Printer) -> None:
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
