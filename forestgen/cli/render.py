"""The commands `render` and `batch`."""

from __future__ import annotations

from collections.abc import Sequence
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
    progress_of,
    with_first,
)
from forestgen.cli.console import Printer, stops_keep
from forestgen.core.figures import count

if TYPE_CHECKING:
    from forestgen.api.display import Display


def render(
    recipe: RecipePath,
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="The data set's folder, or its address in an object store; by default outputs/NAME, ...-2, ...",
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
    from forestgen import load
    from forestgen.api.rendering import free_folder

    loaded = load(recipe, set=with_first(overrides, first))
    target = free_folder(Path("outputs") / recipe.stem) if out is None else out
    if dry_run:
        shown = progress_of(quiet)
        expected = loaded.estimate(
            target,
            images,
            workers=1,
            threads=threads,
            resume=resume,
            discard=discard,
            overwrite=overwrite,
            device=device,
            progress=shown,
        )
        Printer(quiet)(str(expected))
        return
    display = _display(quiet)
    with stops_keep(lambda: kept(display, overwrite=overwrite, if_none="nothing was written")):
        run = loaded.render(
            target,
            count=images,
            resume=resume,
            discard=discard,
            overwrite=overwrite,
            threads=threads,
            device=device,
            progress=display,
        )
    Printer(quiet)("\n".join(run.summary.lines(verbose=verbose)))


BatchFolder = Annotated[
    str,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        help="The data set's folder, or its address in an object store: s3://bucket/forests.",
    ),
]
WorkerMemory = Annotated[
    str | None,
    typer.Option(
        "--worker-memory",
        metavar="SIZE",
        help="What a worker may take, such as 4GB; one that takes more is stopped, and its image tried again.",
    ),
]
Timeout = Annotated[
    str | None,
    typer.Option(
        "--timeout",
        metavar="TIME",
        help="What an image may take, such as 30min; one that takes longer is stopped, and tried again.",
    ),
]
Retries = Annotated[
    int,
    typer.Option(
        "--retries",
        metavar="N",
        min=0,
        max=100,
        help="Further attempts at an image that failed for a reason that may pass.",
    ),
]
Engine = Annotated[
    str, typer.Option("--engine", metavar="local|dask", help="Who works: this machine, or a Dask cluster.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Of Dask, such as tcp://10.0.0.1:8786.")
]
Resources = Annotated[
    list[str] | None,
    typer.Option(
        "--resource",
        metavar="NAME=AMOUNT",
        help="That each image takes of a Dask worker, such as GPU=1. May be repeated.",
    ),
]


def batch(
    recipe: RecipePath,
    out: BatchFolder,
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
    engine: Engine = "local",
    scheduler: Scheduler = None,
    resources: Resources = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a data set of many images with many workers; --resume goes on where it was interrupted."""
    from forestgen import load

    loaded, amounts = load(recipe, set=with_first(overrides, first)), _amounts(resources or ())
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
    display = _display(quiet)
    with stops_keep(lambda: kept(display, overwrite=overwrite)):
        run = loaded.batch(out, images, progress=display, **options)
    Printer(quiet)("\n".join(run.summary.lines(verbose=verbose)))


def _display(quiet: bool) -> Display:
    from forestgen.api.display import display_of

    return display_of(progress_of(quiet))


def kept(display: Display, *, overwrite: bool = False, if_none: str = "") -> str:
    """What an interrupted run leaves behind, for people; `if_none`: where it has finished no image."""
    meter = display.meter
    if overwrite and (meter is None or not meter.done):
        return "nothing was written; a previous data set is as it was"
    if meter is None:
        return "nothing was written"
    if not meter.done and if_none:
        return if_none
    total = count(meter.total, "image")
    done = f"{meter.done:,} of {total} are done and stay" if meter.done else f"none of {total} was finished"
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
