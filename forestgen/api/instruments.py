"""Light meters, colour charts and weather: measurements in a recipe's scene that are no pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from forestgen.api.display import display_of
from forestgen.api.rendering import free_folder
from forestgen.atmosphere.clouds.source import WeatherReport as Weather
from forestgen.atmosphere.clouds.source import cloud_source_of
from forestgen.core.arguments import listed, number_of, path_of, shown, whole_of
from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.progress import Progress, Timings
from forestgen.dataset.file_set import FileSet, check_writable
from forestgen.instruments.light import Point
from forestgen.instruments.light_text import LightReadings
from forestgen.recipe.camera_keys import DIRECTIONS
from forestgen.recipe.load import LoadedRecipe

if TYPE_CHECKING:
    from forestgen.instruments.colour_chart import Calibration

_LIGHT_FILES = (".csv", ".json")
_WEATHER_FILES = (".nc", ".vol", ".vdb")
_SPECTRUM_NM = (1.0, 1100.0)  # steps that can be asked for
_LEAST_SAMPLES, _MOST_SAMPLES = 512, 100_000_000


def measure_light(
    loaded: LoadedRecipe,
    at: Sequence[Sequence[float | str]],
    normals: str | Sequence[str | Sequence[float]],
    *,
    samples: int,
    absolute_z: bool,
    out: Path | None,
    spectrum: float | None,
    overwrite: bool,
    progress: bool | Progress | None,
) -> LightReadings:
    """See `Recipe.light`."""
    from forestgen.instruments import light

    samples = whole_of(samples, "samples", _LEAST_SAMPLES, _MOST_SAMPLES)
    if spectrum is not None:
        spectrum = number_of(spectrum, "spectrum", *_SPECTRUM_NM)
    if out is not None:
        _check_ending(out, _LIGHT_FILES)
        check_writable([out], overwrite=overwrite)
    points = [point_of(one) for one in listed(at, "at", "points")]
    directions = [normal_of(one, "normals") for one in listed(normals, "normals", "directions")]
    display = display_of(progress)
    with display.running():
        meters = light.light_at(
            loaded,
            points,
            directions,
            samples=samples,
            above_ground=not absolute_z,
            progress=display,
            timings=Timings(),
        )
    if out is not None:
        content = (
            light.as_json(meters, loaded, samples=samples, step_nm=spectrum or 10.0)
            if out.suffix.lower() == ".json"
            else light.as_csv(meters, step_nm=spectrum)
        )
        with FileSet(overwrite=overwrite) as files:
            files.write(out, content)
    return LightReadings(meters, spectrum)


def simulate_weather(
    loaded: LoadedRecipe,
    count: int | None,
    *,
    out: Sequence[Path],
    picture: Path | None,
    overwrite: bool,
    progress: bool | Progress | None,
) -> list[Weather]:
    """See `Recipe.weather`."""
    from forestgen.community.plot_weather import plot_weather

    for one in out:
        _check_ending(one, _WEATHER_FILES)
    if picture is not None and picture.suffix.lower() != ".png":
        raise RecipeError("no such kind of picture", parameter="picture", expected=".png", got=str(picture))
    check_writable([*out, *([picture] if picture else [])], overwrite=overwrite)
    number = loaded.images if count is None else whole_of(count, "count", 1, 10**8)
    display = display_of(progress)
    with display.running():
        images = map(loaded.draw, range(number))
        reports = [cloud_source_of(drawn).air(drawn, display) for drawn in images]
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        plot_weather(reports, picture)
    for one in out:
        _save_weather(one, reports[-1])
    return reports


def calibrate(
    loaded: LoadedRecipe,
    out: Path | None,
    *,
    at: Sequence[float | str] | None,
    normal: str | Sequence[float],
    width_px: int,
    samples: int,
    absolute_z: bool,
    overwrite: bool,
    progress: bool | Progress | None,
) -> tuple[Calibration, Path]:
    """See `Recipe.calibrate`; what was measured, and the folder of its sheet."""
    from forestgen.dataset.folder import OutputFolder
    from forestgen.dataset.manifest import build_manifest, write_manifest
    from forestgen.instruments import colour_chart as stage
    from forestgen.instruments.colour_chart_files import write_calibration

    width_px, samples = whole_of(width_px, "width_px", 64, 1024), whole_of(samples, "samples", 4, 65536)
    point, towards = (None if at is None else point_of(at)), normal_of(normal, "normal")
    folder = out or path_of(free_folder(Path("outputs") / f"{loaded.path.stem}-calibration"), "out", output=True)
    timings, display = Timings(), display_of(progress)
    with display.running(), OutputFolder(folder, overwrite=overwrite) as staging:
        found = stage.calibrate(
            loaded,
            at=point,
            normal=towards,
            above_ground=not absolute_z,
            width_px=width_px,
            samples=samples,
            progress=display,
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
    return found, folder


def point_of(values: Sequence[float | str]) -> Point:
    """A point of three numbers, metres, whose place is not checked. Raises `RecipeError`."""
    try:
        x, y, z = (float(one) for one in values)
    except (TypeError, ValueError, OverflowError):
        several = values if isinstance(values, list | tuple) else [values]
        got = " ".join(f"{one:.100}" if isinstance(one, str) else shown(one) for one in several)
        raise RecipeError(
            "this is no point", parameter="at", expected="three numbers, metres, such as 30 40 1.5", got=got
        ) from None
    return x, y, z


def normal_of(direction: str | Sequence[float], parameter: str) -> Point:
    """Unit vector of a direction, by its name or its components. Raises `RecipeError`."""
    if isinstance(direction, str) and direction.lower() in DIRECTIONS:
        return DIRECTIONS[direction.lower()]
    try:
        x, y, z = (float(one) for one in (direction.split(",") if isinstance(direction, str) else direction))
        length = math.sqrt(x * x + y * y + z * z)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not (math.isfinite(length) and length > 1e-9):
        expected = ", ".join(DIRECTIONS) + ", or x,y,z such as 0,0.5,1"
        got = direction if isinstance(direction, str) else shown(direction)
        raise RecipeError("this is no direction", parameter=parameter, expected=expected, got=got)
    return x / length, y / length, z / length


def _save_weather(path: Path, report: Weather) -> None:
    from forestgen.atmosphere.extinction import cloud_grid_of
    from forestgen.atmosphere.weather_files import write_clouds, write_weather

    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".nc":
        write_weather(path, report.weather, droplet_radius_um=report.droplet_radius_um)
        return
    grid = cloud_grid_of(report.weather, centre_m=None, droplet_radius_um=report.droplet_radius_um)
    if grid is None:
        raise OutputError("there are no clouds to write", where=str(path), hint="save the air as .nc")
    write_clouds(path, grid)


def _check_ending(path: Path, endings: Sequence[str]) -> None:
    if path.suffix.lower() not in endings:
        raise RecipeError("no such kind of file", parameter="out", expected=" or ".join(endings), got=str(path))


__all__ = ["LightReadings", "Weather", "calibrate", "measure_light", "normal_of", "point_of", "simulate_weather"]
