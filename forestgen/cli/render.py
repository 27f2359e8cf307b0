"""The commands `render` and `batch`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from forestgen.cli.arguments import (
    Count,
    Device,
    Discard,
    DryRun,
    First,
    Overrides,
    Overwrite,
    Quiet,
    RecipePath,
    Resume,
    Threads,
    Verbose,
    Workers,
    option,
    progress_of,
)
from forestgen.cli.console import NOTHING_WRITTEN, Printer, stops_keep
from forestgen.core.figures import count

if TYPE_CHECKING:
    from forestgen.api.datasets import Run
    from forestgen.api.recipes import Recipe
    from forestgen.runs.tracker import Display


def render(
    recipe: RecipePath,
    out: Annotated[
        str | None,
        option(
            "--out -o DIR",
            "The data set's folder, or its address in an object store; by default outputs/NAME, ...-2, ...",
        ),
    ] = None,
    images: Count = None,
    overrides: Overrides = None,
    resume: Resume = False,
    discard: Discard = False,
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    first: First = None,
    threads: Threads = None,
    device: Device = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Render a recipe: a data set of images, masks and tables, made in this process.

    The same bytes as `batch` makes with many workers. Ctrl-C keeps finished images; --resume goes on.
    """
    from forestgen.api.rendering import free_folder

    loaded = _load(recipe, overrides, first)
    target = free_folder(Path("outputs") / recipe.stem) if out is None else out
    options: dict[str, Any] = {
        "resume": resume,
        "discard": discard,
        "overwrite": overwrite,
        "threads": threads,
        "device": device,
    }
    if dry_run:
        Printer(quiet)(str(loaded.estimate(target, images, workers=1, progress=progress_of(quiet), **options)))
        return

    def make(display: Display) -> Run:
        return loaded.render(target, count=images, progress=display, **options)

    _run(make, quiet, verbose, overwrite=overwrite, if_none=NOTHING_WRITTEN)


WorkerMemory = Annotated[
    str | None,
    option(
        "--worker-memory SIZE",
        "What a worker may take, such as 4GB; one that takes more is stopped, and its image tried again.",
    ),
]
Timeout = Annotated[
    str | None,
    option(
        "--timeout TIME",
        "What an image may take, such as 30min; one that takes longer is stopped, and tried again.",
    ),
]
Retries = Annotated[
    int,
    option("--retries N", "Further attempts at an image that failed for a reason that may pass.", min=0, max=100),
]
Resources = Annotated[
    list[str] | None,
    option("--resource NAME=AMOUNT", "That each image takes of a Dask worker, such as GPU=1. May be repeated."),
]


def batch(
    recipe: RecipePath,
    out: Annotated[
        str, option("--out -o DIR", "The data set's folder, or its address in an object store: s3://bucket/forests.")
    ],
    images: Count = None,
    overrides: Overrides = None,
    resume: Resume = False,
    discard: Discard = False,
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    workers: Workers = None,
    threads: Threads = None,
    device: Device = None,
    worker_memory: WorkerMemory = None,
    timeout: Timeout = None,
    retries: Retries = 2,
    first: First = None,
    engine: Annotated[str, option("--engine local|dask", "Who works: this machine, or a Dask cluster.")] = "local",
    scheduler: Annotated[str | None, option("--scheduler ADDRESS", "Of Dask, such as tcp://10.0.0.1:8786.")] = None,
    resources: Resources = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a data set of many images with many workers; --resume goes on where it was interrupted."""
    loaded, amounts = _load(recipe, overrides, first), _amounts(resources or ())
    options: dict[str, Any] = {
        "workers": workers,
        "threads": threads,
        "resume": resume,
        "discard": discard,
        "overwrite": overwrite,
        "worker_memory": worker_memory,
        "timeout": timeout,
        "retries": retries,
        "engine": engine,
        "scheduler": scheduler,
        "resources": amounts,
        "device": device,
    }
    if dry_run:
        Printer(quiet)(str(loaded.estimate(out, images, progress=progress_of(quiet), **options)))
        return
    _run(lambda display: loaded.batch(out, images, progress=display, **options), quiet, verbose, overwrite=overwrite)


def _load(recipe: Path, overrides: list[str] | None, first: int | None) -> Recipe:
    from forestgen import load

    return load(recipe, set=[*(overrides or []), *([f"first_image={first}"] if first is not None else [])])


def _run(make: Callable[[Display], Run], quiet: bool, verbose: bool, *, overwrite: bool, if_none: str = "") -> None:
    """Make a data set, and print what was made, or what stays if it is interrupted: see `kept`."""
    from forestgen.api.display import display_of

    display = display_of(progress_of(quiet))
    with stops_keep(lambda: kept(display, overwrite=overwrite, if_none=if_none)):
        run = make(display)
    Printer(quiet)("\n".join(run.summary.lines(verbose=verbose)))


def kept(display: Display, *, overwrite: bool = False, if_none: str = "") -> str:
    """What an interrupted run leaves behind, for people; `if_none`: where it has finished no image."""
    tracker = display.tracker
    if overwrite and (tracker is None or not tracker.done):
        return f"{NOTHING_WRITTEN}; a previous data set is as it was"
    if tracker is None:
        return NOTHING_WRITTEN
    if not tracker.done and if_none:
        return if_none
    total = count(tracker.total, "image")
    done = f"{tracker.done:,} of {total} are done and stay" if tracker.done else f"none of {total} was finished"
    return f"{done}; the same command with --resume{' in place of --overwrite' if overwrite else ''} goes on"


def _amounts(texts: Sequence[str]) -> dict[str, float]:
    """Resources such as GPU=1."""
    found = {}
    for text in texts:
        name, _, amount = text.partition("=")
        try:
            found[name] = float(amount)
        except ValueError:
            found[name] = -1.0
        if not name or not 0 < found[name] < float("inf"):
            raise typer.BadParameter(f"{text!r} is no NAME=AMOUNT such as GPU=1", param_hint="--resource")
    return found
