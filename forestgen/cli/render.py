"""The commands `render` and `batch`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from forestgen.cli.console import NOTHING_WRITTEN, Printer, stops_keep
from forestgen.core.figures import count

if TYPE_CHECKING:
    from forestgen.api.datasets import Run
    from forestgen.api.recipes import Recipe
    from forestgen.runs.summary import Display

_OPTIONS = (
    "workers", "threads", "resume", "discard", "overwrite", "worker_memory", "timeout", "retries", "engine",
    "scheduler", "resources", "device",
)  # fmt: skip


def render(
    recipe: Path,
    out: str | None = None,
    count_: int | None = None,
    set_: list[str] | None = None,
    resume: bool = False,
    discard: bool = False,
    overwrite: bool = False,
    dry_run: bool = False,
    first: int | None = None,
    threads: int | None = None,
    device: str | None = None,
    quiet: bool = False,
    verbose: bool = False,
) -> None:
    """Render a recipe: a data set of images, masks and tables, made in this process.

    The same bytes as `batch` makes with many workers. Ctrl-C keeps finished images; --resume goes on.

    --out -o DIR  The data set's folder, or its address in an object store; by default outputs/NAME, ...-2, ...
    """
    from forestgen.api.rendering import free_folder

    loaded = _load(recipe, set_, first)
    target = free_folder(Path("outputs") / recipe.stem) if out is None else out
    _run(loaded, loaded.render, target, locals(), if_none=NOTHING_WRITTEN)


def batch(
    recipe: Path,
    out: str,
    count_: int | None = None,
    set_: list[str] | None = None,
    resume: bool = False,
    discard: bool = False,
    overwrite: bool = False,
    dry_run: bool = False,
    workers: int | None = None,
    threads: int | None = None,
    device: str | None = None,
    worker_memory: str | None = None,
    timeout: str | None = None,
    retries: int = 2,
    first: int | None = None,
    engine: str = "local",
    scheduler: str | None = None,
    resources: list[str] | None = None,
    quiet: bool = False,
    verbose: bool = False,
) -> None:
    """Make a data set of many images with many workers; --resume goes on where it was interrupted.

    --out -o DIR  The data set's folder, or its address in an object store: s3://bucket/forests.
    --worker-memory SIZE  What a worker may take, such as 4GB; one that takes more is stopped, and its image tried
        again.
    --timeout TIME  What an image may take, such as 30min; one that takes longer is stopped, and tried again.
    --retries N  Further attempts at an image that failed for a reason that may pass. [0 to 100]
    --engine local|dask  Who works: this machine, or a Dask cluster.
    --scheduler ADDRESS  Of Dask, such as tcp://10.0.0.1:8786.
    --resource NAME=AMOUNT  That each image takes of a Dask worker, such as GPU=1. May be repeated.
    """
    loaded = _load(recipe, set_, first)
    _run(loaded, loaded.batch, out, {**locals(), "resources": _amounts(resources or ())})


def _load(recipe: Path, overrides: list[str] | None, first: int | None) -> Recipe:
    from forestgen import load

    return load(recipe, set=[*(overrides or []), *([f"first_image={first}"] if first is not None else [])])


def _run(
    loaded: Recipe, make: Callable[..., Run], target: str | Path, given: Mapping[str, Any], if_none: str = ""
) -> None:
    """Make a data set, or estimate it, and print what was made; what stays if it is interrupted: see `kept`.

    `given`: the command's parameters.
    """
    from forestgen.api.display import display_of

    quiet, count_ = given["quiet"], given["count_"]
    options = {name: given[name] for name in _OPTIONS if name in given}
    display = display_of(not quiet)
    if given["dry_run"]:
        Printer(quiet)(str(loaded.estimate(target, count_, progress=display, **{"workers": 1, **options})))
        return
    with stops_keep(lambda: kept(display, overwrite=given["overwrite"], if_none=if_none)):
        run = make(target, count=count_, progress=display, **options)
    Printer(quiet)("\n".join(run.summary.lines(verbose=given["verbose"])))


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
