"""Measurements in a recipe's scene that are no pictures; and weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from forestgen.api.display import display_of
from forestgen.api.rendering import free_folder
from forestgen.atmosphere.clouds.source import WeatherReport, cloud_source_of
from forestgen.core.arguments import path_of, whole_of
from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.progress import Progress
from forestgen.core.timing import Timings
from forestgen.dataset.file_set import FileSet, check_writable
from forestgen.instruments.calibration import Calibration
from forestgen.instruments.instrument import Instrument, Reading, ReadingT, read_keys
from forestgen.pipeline import measure
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.registries import INSTRUMENTS

_WEATHER_FILES = (".nc", ".vol", ".vdb")


def measured_by(
    loaded: LoadedRecipe,
    name: str,
    keys: Mapping[str, Any],
    out: Path | None,
    overwrite: bool,
    progress: bool | Progress | None,
) -> Reading:
    """See `Recipe.measure`."""
    INSTRUMENTS.check(name, parameter="instrument")
    instrument: Instrument[Any, Reading] = INSTRUMENTS.load(name)
    return measured(loaded, instrument, keys, out, overwrite, progress)


def measured(
    loaded: LoadedRecipe,
    instrument: Instrument[Any, ReadingT],
    keys: Mapping[str, Any],
    out: Path | None,
    overwrite: bool,
    progress: bool | Progress | None,
) -> ReadingT:
    """Measure, and write a file of it."""
    section = read_keys(instrument, keys)
    if out is not None:
        _check_ending(out, instrument.endings)
        check_writable([out], overwrite=overwrite)
    display = display_of(progress)
    with display.running():
        reading = measure(loaded, instrument, section, display, Timings())
    if out is not None:
        with FileSet(overwrite=overwrite) as files:
            files.write(out, reading.content(out.suffix.lower(), loaded))
    return reading


def simulate_weather(
    loaded: LoadedRecipe,
    count: int | None,
    *,
    out: Sequence[Path],
    picture: Path | None,
    overwrite: bool,
    progress: bool | Progress | None,
) -> list[WeatherReport]:
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
    keys: Mapping[str, Any],
    overwrite: bool,
    progress: bool | Progress | None,
) -> tuple[Calibration, Path]:
    """See `Recipe.calibrate`; what was measured, and the folder of its sheet."""
    from forestgen.dataset.folder import OutputFolder
    from forestgen.dataset.manifest import build_manifest, write_manifest
    from forestgen.instruments.calibration import write_calibration
    from forestgen.instruments.colour_chart import INSTRUMENT

    section = read_keys(INSTRUMENT, keys)
    folder = out or path_of(free_folder(Path("outputs") / f"{loaded.path.stem}-calibration"), "out", output=True)
    timings, display = Timings(), display_of(progress)
    with display.running(), OutputFolder(folder, overwrite=overwrite) as staging:
        found = measure(loaded, INSTRUMENT, section, display, timings)
        write_calibration(staging, found, loaded)
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


def _save_weather(path: Path, report: WeatherReport) -> None:
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
