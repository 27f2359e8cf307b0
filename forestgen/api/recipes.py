"""Recipes: `load` reads one, and everything that a recipe can make is a method of `Recipe`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from forestgen.core.arguments import PathLike, address_of, path_of, paths_of, plain_copy, shown, texts_of
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.scene.load_checked import load_checked

if TYPE_CHECKING:
    from forestgen.api.datasets import Run
    from forestgen.api.stands import Stand
    from forestgen.api.validation import Validation
    from forestgen.atmosphere.clouds.source import WeatherReport
    from forestgen.dataset.frame import Frame
    from forestgen.instruments.calibration import Calibration
    from forestgen.instruments.instrument import Reading
    from forestgen.instruments.light_meter import LightReadings
    from forestgen.runs.start import DryRun

Overrides = Mapping[str, Any] | Sequence[str] | None


def load(
    source: PathLike | Mapping[str, Any],
    set: Overrides = (),  # noqa: A002 - the name of the option on the command line
    *,
    allow_folders: PathLike | Sequence[PathLike] = (),
) -> Recipe:
    """Read a recipe and check it.

    Parameters
    ----------
    source : path of a YAML file, or a mapping with the same keys, or the YAML itself, a text of several lines; paths in
        a mapping or a text are relative to the working folder.
    set : values that replace those of the recipe: ``{"sky.turbidity": 5, "cameras.0.size_px": [640, 480]}``, or texts
        ``["sky.turbidity=5"]`` whose values are YAML; None: nothing.
    allow_folders : folders besides the recipe's own that this recipe, and all later ones of this process, may read
        files from.

    Raises
    ------
    RecipeError, AssetError : with `place`, `expected`, `got` and `hint`; `errors` has all that were found.
    """
    if folders := paths_of(allow_folders, "allow_folders"):
        from forestgen.recipe.paths import allow_folders as allow

        allow(folders)
    return Recipe(source, _texts(set))


def _texts(overrides: Overrides) -> list[str]:
    """Overrides as ``key=YAML``."""
    if overrides is None:
        return []
    if not isinstance(overrides, Mapping):
        return texts_of(overrides, "set")
    return [f"{key}={_yaml(key, plain_copy(value, f'set: {key}'))}" for key, value in overrides.items()]


def _yaml(key: str, value: Any) -> str:
    """JSON, which is YAML; arrays and NumPy's numbers as lists and numbers."""
    try:
        return json.dumps(value, default=lambda one: one.tolist(), allow_nan=False)
    except (TypeError, ValueError, AttributeError) as error:
        expected = "a number, a text, a list or a mapping"
        raise RecipeError(
            "this value cannot be set", where=f"set: {key}", expected=expected, got=shown(value)
        ) from error


def _values(texts: Sequence[str]) -> dict[str, Any]:
    """Key -> value of texts ``key=YAML``."""
    from forestgen.recipe.yaml_source import parse_yaml

    found = {}
    for text in texts:
        key, equals, written = text.partition("=")
        if not equals:
            raise RecipeError("this gives no key a value", parameter="keys", expected="key=value", got=shown(text))
        found[key.strip()], _ = parse_yaml(written, f"keys: {key.strip()}", lines=False)
    return found


class Recipe:
    """A recipe that has passed the checks of its text. Objects do not change; `set` returns another one."""

    def __init__(self, source: PathLike | Mapping[str, Any], overrides: Sequence[str] = ()) -> None:
        self._source, self._overrides = source, tuple(overrides)
        given: Path | str | Mapping[str, Any]
        if isinstance(source, Mapping) or (isinstance(source, str) and "\n" in source):
            given = source
        else:
            given = path_of(source, "source")
        self._loaded = load_checked(given, overrides)

    @property
    def name(self) -> str:
        """Of its file, without the ending."""
        return self._loaded.path.stem

    @property
    def images(self) -> int:
        """How many images it makes unless another count is asked for."""
        return self._loaded.images

    @property
    def seed(self) -> int:
        return self._loaded.seed

    @property
    def hash(self) -> str:
        """SHA-256 of all that the recipe says."""
        return self._loaded.hash

    @property
    def data(self) -> dict[str, Any]:
        """Everything the recipe says, defaults filled in, as plain values; a copy."""
        return json.loads(json.dumps(self._loaded.complete))  # type: ignore[no-any-return]

    @property
    def yaml(self) -> str:
        """The same as YAML text."""
        from forestgen.recipe.load import yaml_text

        return yaml_text(self._loaded.complete)

    def set(self, values: Overrides) -> Recipe:
        """The recipe with other values; see `load`."""
        return Recipe(self._source, (*self._overrides, *_texts(values)))

    def validate(self) -> Validation:
        """Check all that can be checked without simulating, and describe what the recipe makes.

        Raises
        ------
        RecipeError, AssetError, ResourceError : what is wrong, or would not fit into memory.
        """
        from forestgen.api.validation import validation_of

        return validation_of(self._loaded)

    def simulate(
        self,
        out: PathLike | None = None,
        *,
        map_steps: Sequence[int] = (),
        resume: PathLike | None = None,
        from_step: int | None = None,
        graphs: PathLike | Sequence[PathLike] = (),
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> Stand:
        """Simulate the plant community of the first image.

        Parameters
        ----------
        out : folder for its history, statistics and maps; None: nothing is written.
        map_steps : steps to draw a map of; by default the last.
        resume : a history.parquet that the recipe made with fewer steps, to go on from.
        from_step : of that history; by default its last.
        graphs : files for the branches of the last step: .parquet, .csv, .gltf, .glb, .obj, .usda, .usdc.
        overwrite : replace a previous output.
        progress : None or True: shown; False: silent; or a listener, see `forestgen.api.display`.

        Raises
        ------
        RecipeError, ResourceError, OutputError
        """
        from forestgen.api.stands import simulated

        return simulated(
            self._loaded,
            None if out is None else path_of(out, "out", output=True),
            map_steps=map_steps,
            resume=None if resume is None else path_of(resume, "resume"),
            from_step=from_step,
            graphs=paths_of(graphs, "graphs", output=True),
            overwrite=overwrite,
            progress=progress,
        )

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
        from forestgen.api.rendering import frames_of

        return frames_of(self._loaded, count, first, threads, device, progress)

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
        from forestgen.api.rendering import render_run
        from forestgen.runs.start import RunOptions

        options = RunOptions(
            count=count, resume=resume, discard=discard, overwrite=overwrite, threads=threads, device=device
        )
        return render_run(self._loaded, None if out is None else address_of(out, "out"), options, progress)

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
        from forestgen.api.rendering import batch_run
        from forestgen.runs.start import RunOptions

        options = RunOptions(
            count=count,
            workers=workers,
            threads=threads,
            resume=resume,
            discard=discard,
            overwrite=overwrite,
            worker_memory=worker_memory,
            timeout=timeout,
            retries=retries,
            engine=engine,
            scheduler=scheduler,
            resources={} if resources is None else resources,
            device=device,
        )
        return batch_run(self._loaded, address_of(out, "out"), options, progress)

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
        from forestgen.api.rendering import estimate_run
        from forestgen.runs.start import RunOptions

        options = RunOptions(
            count=count,
            workers=workers,
            threads=threads,
            resume=resume,
            discard=discard,
            overwrite=overwrite,
            worker_memory=worker_memory,
            timeout=timeout,
            retries=retries,
            engine=engine,
            scheduler=scheduler,
            resources={} if resources is None else resources,
            device=device,
        )
        return estimate_run(self._loaded, address_of(out, "out"), options, progress)

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
        from forestgen.api.instruments import measured
        from forestgen.instruments.light_meter import INSTRUMENT

        keys = {"at": at, "normals": normals, "samples": samples, "absolute_z": absolute_z, "spectrum": spectrum}
        target = None if out is None else path_of(out, "out", output=True)
        return measured(self._loaded, INSTRUMENT, keys, target, overwrite, progress)

    def measure(
        self,
        instrument: str,
        keys: Overrides = None,
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
        from forestgen.api.instruments import measured_by

        values = keys if isinstance(keys, Mapping) else _values(texts_of(keys or (), "keys"))
        target = None if out is None else path_of(out, "out", output=True)
        return measured_by(self._loaded, instrument, values, target, overwrite, progress)

    def weather(
        self,
        count: int | None = None,
        *,
        out: Sequence[PathLike] | PathLike = (),
        picture: PathLike | None = None,
        overwrite: bool = False,
        progress: bool | Progress | None = None,
    ) -> list[WeatherReport]:
        """Simulate the weather alone, of each of `count` images.

        Parameters
        ----------
        out : files for the last image's: .nc, the state of the air; .vol or .vdb, its extinction.
        picture : a PNG, a row an image.
        """
        from forestgen.api.instruments import simulate_weather

        return simulate_weather(
            self._loaded,
            count,
            out=paths_of(out, "out", output=True),
            picture=None if picture is None else path_of(picture, "picture", output=True),
            overwrite=overwrite,
            progress=progress,
        )

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
        from forestgen.api.instruments import calibrate

        return calibrate(
            self._loaded,
            None if out is None else path_of(out, "out", output=True),
            {"at": at, "normal": normal, "width_px": width_px, "samples": samples, "absolute_z": absolute_z},
            overwrite,
            progress,
        )

    def __repr__(self) -> str:
        return f"<Recipe {self._loaded.path}: {self.images} image{'' if self.images == 1 else 's'}>"
