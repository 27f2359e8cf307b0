"""Methods of `Recipe` that make frames in memory and data sets, and that measure: light, colours, weather."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from forestgen.api.datasets import Run
from forestgen.api.display import display_of
from forestgen.core.arguments import PathLike, address_of, path_of, paths_of, shown, texts_of, whole_of
from forestgen.core.errors import OutputError, RecipeError
from forestgen.core.progress import Progress, Timings
from forestgen.recipe.dataset import NUMBERS_END

if TYPE_CHECKING:
    from forestgen.atmosphere.clouds.source import CloudStatistics, WeatherReport
    from forestgen.atmosphere.grid import Weather
    from forestgen.dataset.frame import Frame
    from forestgen.instruments.calibration import Calibration
    from forestgen.instruments.instrument import Reading
    from forestgen.instruments.light_meter import LightReadings
    from forestgen.instruments.stand_table import StandTable
    from forestgen.recipe.load import LoadedRecipe
    from forestgen.runs.start import DryRun
    from forestgen.runs.summary import Display

_WEATHER_FILES = (".nc", ".vol", ".vdb")


class Rendering:
    """Methods of `Recipe`."""

    _loaded: LoadedRecipe

    def frames(
        self,
        count: int | None = None,
        *,
        first: int = 0,
        threads: int | None = None,
        device: str | None = None,
        progress: bool | Progress | None = None,
    ) -> Iterator[Frame]:
        """Render images one after another and yield their frames, arrays in memory; nothing is written.

        Parameters
        ----------
        count : images, each of which has a frame for every camera; by default as many as the recipe says.
        first : index of the first one.
        threads, device, progress : see `render`.
        """
        from forestgen.api.frames import frames_of
        from forestgen.runs.contract import RunOptions
        from forestgen.scene.plan import check_plan

        loaded = self._loaded
        end = NUMBERS_END - int(loaded.complete["first_image"])
        first = whole_of(first, "first", 0, end - 1)
        total = whole_of(loaded.images if count is None else count, "count", 0, end - first)
        threads = RunOptions(threads=threads, device=device).check().threads
        check_plan(loaded)
        return frames_of(loaded, range(first, first + total), threads, device, display_of(progress))

    def render(
        self,
        out: PathLike | None = None,
        *,
        count: int | None = None,
        resume: bool = False,
        discard: bool = False,
        overwrite: bool = False,
        threads: int | None = None,
        device: str | None = None,
        progress: bool | Progress | None = None,
    ) -> Run:
        """Make a data set in this process, one image after another.

        Parameters
        ----------
        out : its folder; by default outputs/NAME, outputs/NAME-2, ...
        count : images, in all; by default as many as the recipe says.
        resume : go on in a data set that is there: make what is missing, damaged or has changed.
        discard : with resume, remove finished images that do not belong to the data set any more.
        overwrite : replace a previous data set.
        threads : by default all cores. Results do not depend on it.
        device : what traces rays: llvm, the processor, or cuda.
        progress : None or True: shown; False: silent; or a listener, see `forestgen.api.display`.

        Raises
        ------
        ForestgenError : the first image that fails raises its own error; finished images stay, and `resume` goes on.
        """
        from forestgen.runs.contract import RunOptions
        from forestgen.runs.start import render

        options = RunOptions.of(locals())
        target = address_of(free_folder(Path("outputs") / self._loaded.path.stem) if out is None else out, "out")
        with _shown(options.device, progress) as display:
            return Run(render(self._loaded, target, options, display))

    def batch(
        self,
        out: PathLike,
        count: int | None = None,
        *,
        workers: int | None = None,
        threads: int | None = None,
        resume: bool = False,
        discard: bool = False,
        overwrite: bool = False,
        worker_memory: int | str | None = None,
        timeout: float | str | None = None,
        retries: int = 2,
        engine: str = "local",
        scheduler: str | None = None,
        resources: Mapping[str, float] | None = None,
        device: str | None = None,
        progress: bool | Progress | None = None,
    ) -> Run:
        """Make a data set with worker processes, or on a Dask cluster. The bytes are those that `render` makes.

        Parameters
        ----------
        out : its folder, or its address in an object store, such as s3://bucket/forests.
        count, resume, discard, overwrite, device, progress : see `render`.
        workers : processes; by default as many as cores and memory allow.
        threads : of each worker; by default all cores are shared out.
        worker_memory : bytes, or a text such as 4GB; a worker that takes more is stopped, and its image tried again.
        timeout : seconds, or a text such as 30min, that an image may take.
        retries : further attempts at an image that failed for a reason that may pass.
        engine, scheduler, resources : ``"dask"``, its scheduler's address, and what each image takes of a worker.

        Raises
        ------
        DatasetError : images could not be made; the others are there.
        RecipeError, ResourceError, OutputError
        """
        from forestgen.runs.contract import RunOptions
        from forestgen.runs.start import batch

        options, target = RunOptions.of(locals()), address_of(out, "out")
        with _shown(options.device, progress) as display:
            return Run(batch(self._loaded, target, options, display))

    def estimate(
        self,
        out: PathLike,
        count: int | None = None,
        *,
        workers: int | None = None,
        threads: int | None = None,
        resume: bool = False,
        discard: bool = False,
        overwrite: bool = False,
        worker_memory: int | str | None = None,
        timeout: float | str | None = None,
        retries: int = 2,
        engine: str = "local",
        scheduler: str | None = None,
        resources: Mapping[str, float] | None = None,
        device: str | None = None,
        progress: bool | Progress | None = None,
    ) -> DryRun:
        """What a batch would take in time, memory and disk: some of its images are made and thrown away.

        The parameters are those of `batch`; without `overwrite`, finished images that are there do not count.

        Raises
        ------
        RecipeError, ResourceError, OutputError : the batch could not be made.
        """
        from forestgen.runs.contract import RunOptions
        from forestgen.runs.start import dry_run

        options, target = RunOptions.of(locals()), address_of(out, "out")
        with _shown(options.device, progress) as display:
            return dry_run(self._loaded, target, options, display)

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
        """Measure light at points of the first image's scene: `measure` with a light meter.

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
        from forestgen.instruments.light_meter import INSTRUMENT

        keys = {"at": at, "normals": normals, "samples": samples, "absolute_z": absolute_z, "spectrum": spectrum}
        read = self.measure(INSTRUMENT.name, keys, out=out, overwrite=overwrite, progress=progress)
        return cast("LightReadings", read)

    def measure(
        self,
        instrument: str,
        keys: Mapping[str, Any] | Sequence[str] | None = None,
        *,
        out: PathLike | None = None,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> Reading:
        """Measure in the first image's scene with an instrument; `print` shows what it measured.

        Parameters
        ----------
        instrument : one of `forestgen.models(kind="instrument")`, whose page has its keys.
        keys : of the measurement: ``{"at": [[30, 40, 1.5]]}``, or texts ``["at=[[30, 40, 1.5]]"]`` whose values are
            YAML.
        out : a file, in one of the formats of the instrument; most write .json.
        overwrite : replace an existing file.
        """
        from forestgen.dataset.files import FileSet, check_writable
        from forestgen.instruments.instrument import Instrument, read_keys
        from forestgen.pipeline import measure
        from forestgen.recipe.registries import INSTRUMENTS

        values = keys if isinstance(keys, Mapping) else _values(texts_of(keys or (), "keys"))
        INSTRUMENTS.check(instrument, parameter="instrument")
        chosen: Instrument[Any, Reading] = INSTRUMENTS.load(instrument)
        target = None if out is None else path_of(out, "out", output=True)
        section, display = read_keys(chosen, values), display_of(progress)
        if target is not None:
            _check_ending(target, chosen.endings)
            check_writable([target], overwrite=overwrite)
        with display.running():
            reading = measure(self._loaded, chosen, section, display, Timings())
        if target is not None:
            with FileSet(overwrite=overwrite) as files:
                files.write(target, reading.content(target.suffix.lower(), self._loaded))
        return reading

    def stand(
        self,
        out: PathLike | None = None,
        *,
        min_dbh_cm: float = 7.0,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> StandTable:
        """Measure the stand of the first image, as it is rendered: `measure` with a stand table.

        Parameters
        ----------
        out : folder for stand.csv, stand.json, and pictures of diameters and heights and of leaf area by height.
        min_dbh_cm : least diameter at 1.3 m of what counts as a stem.

        Returns
        -------
        `rows` by species and storey, `total`, a profile; `print` shows the table.
        """
        from forestgen.dataset.folder import OutputFolder
        from forestgen.instruments.stand_plots import write_stand
        from forestgen.instruments.stand_table import INSTRUMENT

        target = nullcontext() if out is None else OutputFolder(path_of(out, "out", output=True), overwrite=overwrite)
        with target as folder:
            found = cast("StandTable", self.measure(INSTRUMENT.name, {"min_dbh_cm": min_dbh_cm}, progress=progress))
            if folder is not None:
                write_stand(folder, found, self._loaded)
        return found

    def weather(
        self,
        count: int | None = None,
        *,
        out: Sequence[PathLike] | PathLike = (),
        picture: PathLike | None = None,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> list[ImageWeather]:
        """Simulate the weather alone, of each of `count` images.

        Parameters
        ----------
        out : files for the last image's: .nc, the state of the air; .vol or .vdb, its extinction.
        picture : a PNG, a row an image.

        Returns
        -------
        The weather of each image, of the last one with the state of its air.
        """
        from forestgen.atmosphere.clouds.source import cloud_source_of
        from forestgen.community.plot_series import WeatherPicture
        from forestgen.dataset.files import FileSet, check_writable

        files = paths_of(out, "out", output=True)
        for one in files:
            _check_ending(one, _WEATHER_FILES)
        image = None if picture is None else path_of(picture, "picture", output=True)
        if image is not None and image.suffix.lower() != ".png":
            raise RecipeError("no such kind of picture", parameter="picture", expected=".png", got=str(image))
        check_writable([*files, *([] if image is None else [image])], overwrite=overwrite)
        number = self._loaded.images if count is None else whole_of(count, "count", 1, 10**8)
        display, found = display_of(progress), list[ImageWeather]()
        drawing = None if image is None else WeatherPicture(number)
        with display.running(), FileSet(overwrite=overwrite) as written:
            for index, drawn in enumerate(map(self._loaded.draw, range(number))):
                last = cloud_source_of(drawn).air(drawn, display)
                weather = last.weather if index == number - 1 else None  # the air of many images would fill the memory
                found.append(ImageWeather(last.kind, last.droplet_radius_um, last.statistics, weather))
                if drawing is not None:
                    drawing.draw(index, last)
            for one in files:
                written.write(one, _weather_file(one, last))
            if image is not None and drawing is not None:
                written.write(image, drawing.content())
        return found

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
    ) -> Calibrated:
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
        `calibration`, what was measured, whose `holds` tells whether the bounds hold; and `folder`.
        """
        from forestgen.dataset.folder import OutputFolder
        from forestgen.dataset.manifest import write_manifest
        from forestgen.instruments.calibration import write_calibration
        from forestgen.instruments.colour_chart import INSTRUMENT
        from forestgen.instruments.instrument import read_keys
        from forestgen.pipeline import measure

        keys = {"at": at, "normal": normal, "width_px": width_px, "samples": samples, "absolute_z": absolute_z}
        loaded, section = self._loaded, read_keys(INSTRUMENT, keys)
        wanted = free_folder(Path("outputs") / f"{loaded.path.stem}-calibration") if out is None else out
        folder = path_of(wanted, "out", output=True)
        timings, display = Timings(), display_of(progress)
        with display.running(), OutputFolder(folder, overwrite=overwrite) as staging:
            found = measure(loaded, INSTRUMENT, section, display, timings)
            write_calibration(staging, found, loaded)
            write_manifest(
                staging,
                recipe_hash=loaded.hash,
                root_seed=loaded.seed,
                image_seeds=[],
                timings_s=timings.seconds,
                extra={"calibration_holds": found.holds},
            )
        return Calibrated(found, folder)


@dataclass(frozen=True)
class ImageWeather:
    """The simulated weather of an image."""

    kind: str  # type of the conditions at that time
    droplet_radius_um: float
    statistics: CloudStatistics
    weather: Weather | None  # the state of the air, of the last image alone


class Calibrated(NamedTuple):
    """What `Recipe.calibrate` measured, and where it wrote it."""

    calibration: Calibration  # `holds` tells whether the bounds hold
    folder: Path


@contextmanager
def _shown(device: str | None, progress: bool | Progress | None) -> Iterator[Display]:
    """A block whose progress is shown, and in which rays are traced on a device."""
    from forestgen.render.variant import tracing_on

    display = display_of(progress)
    with tracing_on(device), display.running():
        yield display


def free_folder(wanted: Path) -> Path:
    """The first of NAME, NAME-2, NAME-3, ... that is not there."""
    target, number = wanted, 1
    while target.exists():
        number += 1
        target = wanted.with_name(f"{wanted.name}-{number}")
    return target


def _values(texts: Sequence[str]) -> dict[str, Any]:
    """Key -> value of texts ``key=YAML``."""
    from forestgen.recipe.sources import parse_yaml

    found = {}
    for text in texts:
        key, equals, written = text.partition("=")
        if not equals:
            raise RecipeError("this gives no key a value", parameter="keys", expected="key=value", got=shown(text))
        found[key.strip()], _ = parse_yaml(written, f"keys: {key.strip()}", lines=False)
    return found


def _weather_file(path: Path, report: WeatherReport) -> bytes:
    """The content of a file of the air, .nc, or of its extinction."""
    from forestgen.atmosphere.extinction import cloud_grid_of
    from forestgen.atmosphere.weather_files import write_clouds, write_weather

    weather, droplet_radius_um = report.weather, report.droplet_radius_um
    with TemporaryDirectory(prefix="forestgen-weather-") as folder:
        file = Path(folder) / f"air{path.suffix}"  # NetCDF's library writes to no stream
        if path.suffix.lower() == ".nc":
            write_weather(file, weather, droplet_radius_um=droplet_radius_um)
        else:
            grid = cloud_grid_of(weather, centre_m=None, droplet_radius_um=droplet_radius_um)
            if grid is None:
                raise OutputError("there are no clouds to write", where=str(path), hint="save the air as .nc")
            write_clouds(file, grid)
        return file.read_bytes()


def _check_ending(path: Path, endings: Sequence[str]) -> None:
    if path.suffix.lower() not in endings:
        raise RecipeError("no such kind of file", parameter="out", expected=" or ".join(endings), got=str(path))
