"""Frames and runs: what `Recipe.frames`, `render`, `batch` and `estimate` do."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from forestgen.api.datasets import Run
from forestgen.api.display import display_of
from forestgen.api.frames import MadeFrame
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.core.timing import Timings
from forestgen.dataset.frame import Frame
from forestgen.pipeline import assemble_image, image_frames
from forestgen.recipe.load import LoadedRecipe
from forestgen.render.variant import mitsuba
from forestgen.runs import start
from forestgen.runs.start import DryRun, RunOptions
from forestgen.stages.data_set import data_set_of
from forestgen.stages.plan import check_memory, check_plan, make_plan


def frames_of(
    loaded: LoadedRecipe, count: int | None, first: int, threads: int | None, progress: bool | Progress | None
) -> Iterator[Frame]:
    """See `Recipe.frames`."""
    total = loaded.images if count is None else count
    if total < 0:
        raise RecipeError("no such number of images", where="count", expected="0 or more", got=str(total))
    check_plan(loaded)
    mitsuba(threads)
    display = display_of(progress)
    for index in range(first, first + total):
        with display.running():
            plan = make_plan(loaded.draw(index))
            check_memory(plan)
            image = assemble_image(plan, loaded.seed, display, Timings())
        made = image_frames(image, display, Timings())
        while True:
            with display.running():  # not while the caller looks at a frame
                frame = next(made, None)
            if frame is None:
                break
            yield Frame(MadeFrame(frame, image.drawn, data_set_of(image.drawn)))


def render_run(
    loaded: LoadedRecipe,
    out: str | os.PathLike[str] | None,
    options: Mapping[str, Any],
    progress: bool | Progress | None,
) -> Run:
    """See `Recipe.render`."""
    target = os.fspath(out) if out is not None else str(free_folder(Path("outputs") / loaded.path.stem))
    display = display_of(progress)
    with display.running():
        return Run(start.render(loaded, target, RunOptions(**options), display))


def batch_run(loaded: LoadedRecipe, out: str, options: Mapping[str, Any], progress: bool | Progress | None) -> Run:
    """See `Recipe.batch`."""
    display = display_of(progress)
    with display.running():
        return Run(start.batch(loaded, out, RunOptions(**options), display))


def estimate_run(
    loaded: LoadedRecipe, out: str, options: Mapping[str, Any], progress: bool | Progress | None
) -> DryRun:
    """See `Recipe.estimate`."""
    display = display_of(progress)
    with display.running():
        return start.dry_run(loaded, out, RunOptions(**options), display)


def free_folder(wanted: Path) -> Path:
    """The first of NAME, NAME-2, NAME-3, ... that is not there."""
    target, number = wanted, 1
    while target.exists():
        number += 1
        target = wanted.with_name(f"{wanted.name}-{number}")
    return target
