"""Images of a recipe: the methods of `Recipe` that make frames in memory, and data sets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from forestgen.api.datasets import Run
from forestgen.api.display import display_of
from forestgen.core.arguments import PathLike, address_of, whole_of
from forestgen.core.progress import Progress
from forestgen.recipe.dataset import NUMBERS_END

if TYPE_CHECKING:
    from forestgen.dataset.frame import Frame
    from forestgen.recipe.load import LoadedRecipe
    from forestgen.runs.start import DryRun
    from forestgen.runs.summary import Display


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
        from forestgen.scene.planning import check_plan

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
