"""Frames and runs: what `Recipe.frames`, `render`, `batch` and `estimate` do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from forestgen.api.datasets import Run
from forestgen.api.display import Display, display_of
from forestgen.api.frames import MadeFrame
from forestgen.core.arguments import address_of, whole_of
from forestgen.core.progress import Progress
from forestgen.core.threads import cores, limit_cores
from forestgen.core.timing import Timings
from forestgen.dataset.data_set import data_set_of
from forestgen.dataset.frame import Frame
from forestgen.pipeline import assemble_image, image_frames
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.splits import NUMBERS_END
from forestgen.render.variant import mitsuba, tracing_on
from forestgen.runs import start
from forestgen.runs.start import DryRun, RunOptions
from forestgen.scene.plan import check_memory
from forestgen.scene.planning import check_plan, make_plan


def frames_of(
    loaded: LoadedRecipe,
    count: int | None,
    first: int,
    threads: int | None,
    device: str | None,
    progress: bool | Progress | None,
) -> Iterator[Frame]:
    """See `Recipe.frames`. Arguments are checked at once, and nothing is set while the caller looks at a frame."""
    end = NUMBERS_END - int(loaded.complete["first_image"])
    first = whole_of(first, "first", 0, end - 1)
    total = whole_of(loaded.images if count is None else count, "count", 0, end - first)
    threads = RunOptions(threads=threads, device=device).check().threads
    check_plan(loaded)
    return _frames(loaded, range(first, first + total), threads, device, display_of(progress))


def _frames(
    loaded: LoadedRecipe, images: range, threads: int | None, device: str | None, display: Display
) -> Iterator[Frame]:
    for index in images:
        with _tracing(threads, device), display.running():
            plan = make_plan(loaded.draw(index))
            check_memory(plan)
            image = assemble_image(plan, display, Timings())
        made = image_frames(image, display, Timings())
        while True:
            with _tracing(threads, device), display.running():
                frame = next(made, None)
            if frame is None:
                break
            yield Frame(MadeFrame(frame, image.drawn, data_set_of(image.drawn)))


@contextmanager
def _tracing(threads: int | None, device: str | None) -> Iterator[None]:
    """In the block, rays are traced by so many threads, and on a device."""
    with tracing_on(device):
        limit_cores(threads)
        mitsuba(threads)
        try:
            yield
        finally:
            if threads is not None:
                limit_cores(None)
                mitsuba(cores())


def render_run(loaded: LoadedRecipe, out: str | None, options: RunOptions, progress: bool | Progress | None) -> Run:
    """See `Recipe.render`."""
    target = address_of(free_folder(Path("outputs") / loaded.path.stem), "out") if out is None else out
    display = display_of(progress)
    with display.running():
        return Run(start.render(loaded, target, options, display))


def batch_run(loaded: LoadedRecipe, out: str, options: RunOptions, progress: bool | Progress | None) -> Run:
    """See `Recipe.batch`."""
    display = display_of(progress)
    with display.running():
        return Run(start.batch(loaded, out, options, display))


def estimate_run(loaded: LoadedRecipe, out: str, options: RunOptions, progress: bool | Progress | None) -> DryRun:
    """See `Recipe.estimate`."""
    display = display_of(progress)
    with display.running():
        return start.dry_run(loaded, out, options, display)


def free_folder(wanted: Path) -> Path:
    """The first of NAME, NAME-2, NAME-3, ... that is not there."""
    target, number = wanted, 1
    while target.exists():
        number += 1
        target = wanted.with_name(f"{wanted.name}-{number}")
    return target
