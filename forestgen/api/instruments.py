"""Light meters, colour charts and weather: the methods of `Recipe` that measure in its scene and make no pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from forestgen.api.display import display_of
from forestgen.api.rendering import free_folder
from forestgen.core.arguments import PathLike, listed, number_of, path_of, paths_of, shown, whole_of
from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.progress import Progress
from forestgen.core.timing import Timings
from forestgen.recipe.camera_keys import DIRECTIONS

if TYPE_CHECKING:
    from forestgen.atmosphere.clouds.source import WeatherReport as Weather
    from forestgen.recipe.load import LoadedRecipe
    from forestgen.stages.calibrate import Calibration
    from forestgen.stages.light import Point
    from forestgen.stages.light_text import LightReadings

_LIGHT_FILES = (".csv", ".json")
_WEATHER_FILES = (".nc", ".vol", ".vdb")
_SPECTRUM_NM = (1.0, 1100.0)  # steps that can be asked for
_LEAST_SAMPLES, _MOST_SAMPLES = 512, 100_000_000


class Instruments:
    """Methods of `Recipe`."""

    _loaded: LoadedRecipe

    def light(
        self,
        at: Sequence[Sequence[float | str]],
        *,
        normals: str | Sequence[str | Sequence[float]] = ("up",),
        samples: int = 16384,
        absolute_z: bool = False,
        out: PathLike | None = None,
        spectrum: float | None = None,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> LightReadings:
        """Measure light at points of the first image's scene.

        Parameters
        ----------
        at : points x, y, z in metres, z above ground.
        normals : where the meter looks: up, down, north, east, south, west, or a vector.
        samples : light paths of each light at each wavelength.
        absolute_z : count z from z = 0, not from the ground below.
        out : a .csv or .json file.
        spectrum : step in nm of the spectra in `out`.
        overwrite : replace an existing file.
        """
        from forestgen.stages.light import as_csv, as_json, light_at
        from forestgen.stages.light_text import LightReadings
        from forestgen.stages.plant_files import FileSet, check_writable

        samples = whole_of(samples, "samples", _LEAST_SAMPLES, _MOST_SAMPLES)
        step_nm = None if spectrum is None else number_of(spectrum, "spectrum", *_SPECTRUM_NM)
        target = None if out is None else path_of(out, "out", output=True)
        if target is not None:
            _check_ending(target, _LIGHT_FILES)
            check_writable([target], overwrite=overwrite)
        points = [point_of(one) for one in listed(at, "at", "points")]
        directions = [normal_of(one, "normals") for one in listed(normals, "normals", "directions")]
        display = display_of(progress)
        with display.running():
            meters = light_at(
                self._loaded,
                points,
                directions,
                samples=samples,
                above_ground=not absolute_z,
                progress=display,
                timings=Timings(),
            )
        if target is not None:
            with FileSet(overwrite=overwrite) as files:
                if target.suffix.lower() == ".json":
                    files.write(target, as_json(meters, self._loaded, samples=samples, step_nm=step_nm or 10.0))
                else:
                    files.write(target, as_csv(meters, step_nm=step_nm))
        return LightReadings(meters, step_nm)

    def weather(
        self,
        count: int | None = None,
        *,
        out: Sequence[PathLike] | PathLike = (),
        picture: PathLike | None = None,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> list[Weather]:
        """Simulate the weather alone, of each of `count` images.

        Parameters
        ----------
        out : files for the last image's: .nc, the state of the air; .vol or .vdb, its extinction.
        picture : a PNG, a row an image.
        """
        from forestgen.atmosphere.clouds.source import cloud_source_of
        from forestgen.stages.plant_files import check_writable
        from forestgen.stages.weather import plot_weather

        files = paths_of(out, "out", output=True)
        for one in files:
            _check_ending(one, _WEATHER_FILES)
        image = None if picture is None else path_of(picture, "picture", output=True)
        if image is not None and image.suffix.lower() != ".png":
            raise RecipeError("no such kind of picture", parameter="picture", expected=".png", got=str(image))
        check_writable([*files, *([] if image is None else [image])], overwrite=overwrite)
        number = self._loaded.images if count is None else whole_of(count, "count", 1, 10**8)
        display = display_of(progress)
        with display.running():
            images = map(self._loaded.draw, range(number))
            reports = [cloud_source_of(drawn).air(drawn, display) for drawn in images]
        if image is not None:
            image.parent.mkdir(parents=True, exist_ok=True)
            plot_weather(reports, image)
        for one in files:
            _save_weather(one, reports[-1])
        return reports

    def calibrate(
        self,
        out: PathLike | None = None,
        *,
        at: Sequence[float | str] | None = None,
        normal: str | Sequence[float] = "up",
        width_px: int = 96,
        samples: int = 64,
        absolute_z: bool = False,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> tuple[Calibration, Path]:
        """Render a ColorChecker and a grey card in the scene and compare them with colour science.

        Parameters
        ----------
        out : folder for a sheet, calibration.html, and its numbers; by default outputs/NAME-calibration.
        at : the board's middle, metres, z above ground; by default over the site's middle, above all plants.
        normal : where the board looks: up, north, east, south, west, or a vector.
        width_px, samples : of the chart's picture; light paths a pixel, of each light.
        absolute_z : count z from z = 0, not from the ground below.

        Returns
        -------
        What was measured, whose `holds` tells whether the bounds hold; and the folder.
        """
        from forestgen.dataset.folder import OutputFolder
        from forestgen.dataset.manifest import build_manifest, write_manifest
        from forestgen.stages.calibrate import calibrate
        from forestgen.stages.calibration_files import write_calibration

        loaded = self._loaded
        wanted = free_folder(Path("outputs") / f"{loaded.path.stem}-calibration") if out is None else out
        folder = path_of(wanted, "out", output=True)
        width_px, samples = whole_of(width_px, "width_px", 64, 1024), whole_of(samples, "samples", 4, 65536)
        point, towards = (None if at is None else point_of(at)), normal_of(normal, "normal")
        timings, display = Timings(), display_of(progress)
        with display.running(), OutputFolder(folder, overwrite=overwrite) as staging:
            found = calibrate(
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
