"""The commands `render` and `batch`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from forestgen.cli.arguments import (
    Count,
    Device,
    Discard,
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
from forestgen.cli.console import Printer, count, seconds, stops_keep

if TYPE_CHECKING:
    from forestgen.api.datasets import Run
    from forestgen.api.display import Display
    from forestgen.runs.start import DryRun
    from forestgen.runs.summary import RunSummary

_MOST_NOTES = 5
_MOST_STAGES = 5


def render(
    recipe: RecipePath,
    out: Annotated[
        Optional[str],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="The data set's folder, or its address in an object store; by default outputs/NAME, ...-2, ...",
            show_default=False,
        ),
    ] = None,
    images: Count = None,
    overrides: Overrides = None,
    resume: Resume = False,
    discard: Discard = False,
    overwrite: Overwrite = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and estimate time, memory and disk; make nothing.")
    ] = False,
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
    target = out or free_folder(Path("outputs") / recipe.stem)
    if dry_run:
        shown = progress_of(quiet)
        options: dict[str, Any] = {"workers": 1, "threads": threads, "overwrite": overwrite, "device": device}
        _dry_run(loaded.estimate(target, images, progress=shown, **options), Printer(quiet))
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
    _print(run, Printer(quiet), verbose=verbose)


def batch(
    recipe: RecipePath,
    out: Annotated[
        str,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="The data set's folder, or its address in an object store: s3://bucket/forests.",
        ),
    ],
    images: Count = None,
    overrides: Overrides = None,
    resume: Resume = False,
    discard: Discard = False,
    overwrite: Overwrite = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and estimate time, memory and disk; make nothing.")
    ] = False,
    workers: Workers = None,
    threads: Threads = None,
    device: Device = None,
    worker_memory: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--worker-memory",
            metavar="SIZE",
            help="What a worker may take, such as 4GB; one that takes more is stopped, and its image tried again.",
            show_default=False,
        ),
    ] = None,
    timeout: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--timeout",
            metavar="TIME",
            help="What an image may take, such as 30min; one that takes longer is stopped, and tried again.",
            show_default=False,
        ),
    ] = None,
    retries: Annotated[
        int,
        typer.Option(
            "--retries",
            metavar="N",
            min=0,
            max=100,
            help="Further attempts at an image that failed for a reason that may pass.",
        ),
    ] = 2,
    first: First = None,
    engine: Annotated[
        str, typer.Option("--engine", metavar="local|dask", help="Who works: this machine, or a Dask cluster.")
    ] = "local",
    scheduler: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--scheduler", metavar="ADDRESS", help="Of Dask, such as tcp://10.0.0.1:8786.", show_default=False
        ),
    ] = None,
    resources: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--resource",
            metavar="NAME=AMOUNT",
            help="That each image takes of a Dask worker, such as GPU=1. May be repeated.",
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a data set of many images with many workers; --resume goes on where it was interrupted."""
    from forestgen import load

    loaded, amounts = load(recipe, set=with_first(overrides, first)), _amounts(resources or ())
    options: dict[str, Any] = {
        "workers": workers,
        "threads": threads,
        "overwrite": overwrite,
        "worker_memory": worker_memory,
        "engine": engine,
        "device": device,
    }
    if dry_run:
        _dry_run(loaded.estimate(out, images, progress=progress_of(quiet), **options), Printer(quiet))
        return
    display = _display(quiet)
    with stops_keep(lambda: kept(display, overwrite=overwrite)):
        run = loaded.batch(
            out,
            images,
            resume=resume,
            discard=discard,
            timeout=timeout,
            retries=retries,
            scheduler=scheduler,
            resources=amounts,
            progress=display,
            **options,
        )
    _print(run, Printer(quiet), verbose=verbose)


def _display(quiet: bool) -> Display:
    from forestgen.api.display import display_of

    return display_of(progress_of(quiet))


def kept(display: Display, *, overwrite: bool = False, if_none: str = "") -> str:
    """What an interrupted run leaves behind, for people; `if_none`: where it has finished no image."""
    meter = display.meter
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


def _dry_run(expected: DryRun, say: Printer) -> None:
    from forestgen.runs.estimate_text import lines

    for text in lines(expected.estimate):
        say(text)
    if expected.discarded:
        number = count(expected.discarded, "finished image")
        say(f"--resume --discard would remove {number}: {expected.reasons}")
    say("nothing was made")


def _print(run: Run, say: Printer, *, verbose: bool) -> None:
    summary = run.summary
    if summary.last is not None:
        _print_image(summary, say)
    before = f", {summary.already:,} of them before" if summary.already else ""
    say(f"{summary.images - len(summary.missing):,} of {count(summary.images, 'image')} done{before}")
    say(
        f"{count(summary.frames, 'frame')}, {summary.bytes / 1e6:,.1f} MB in {seconds(summary.seconds)}{_pace(summary)}"
    )
    _print_notes(summary, say, verbose=verbose)
    total = sum(summary.stages_s.values())
    if total:
        stages = list(summary.stages_s.items())[: None if verbose else _MOST_STAGES]
        say("time: " + ", ".join(f"{name} {100 * spent / total:.0f} %" for name, spent in stages))
    say(f"files: {summary.target}/")
    if summary.last is not None and summary.last.rows:
        folder = f"{summary.target}/{summary.last.rows[0]['folder']}"
        say(f"look at {folder}/preview.png and {folder}/overlay.png{_and_report(summary)}")
    elif summary.report:
        say(f"look at {summary.report}")


def _and_report(summary: RunSummary) -> str:
    return f", or at {summary.report}" if summary.report else ""


def _pace(summary: RunSummary) -> str:
    if summary.images_per_hour is None or summary.made < 2:
        return ""
    return f", {summary.images_per_hour:,.0f} images an hour"


def _print_notes(summary: RunSummary, say: Printer, *, verbose: bool) -> None:
    notes = [*dict.fromkeys([*summary.image_notes, *summary.notes])]
    shown = notes if verbose else notes[:_MOST_NOTES]
    for note in shown:
        say(f"note: {note}")
    if len(notes) > len(shown):
        say(f"note: {len(notes) - len(shown)} more notes; --verbose prints all")


def _print_image(summary: RunSummary, say: Printer) -> None:
    """The plants, the noise and the exemplars of the image that was finished last."""
    assert summary.last is not None
    report = summary.last.report
    counts: Mapping[str, int] = report.get("counts", {})
    if summary.made > 1:
        say(f"image {summary.last.image}:")
    kinds = ", ".join(f"{number:,} {name}" for name, number in counts.items())
    dead = f", {report['standing_dead']:,} of them standing dead" if report.get("standing_dead") else ""
    seen = f"; {report.get('visible_plants', 0):,} of them in view"
    say(f"{count(sum(counts.values()), 'plant')} ({kinds}){dead}{seen}")
    errors = [row.get("relative_error") for row in summary.last.rows]
    known = [100 * error for error in errors if error is not None and math.isfinite(error)]
    if known:
        least, most = f"{min(known):.2g}", f"{max(known):.2g}"
        say(f"noise: relative error {least if least == most else f'{least} to {most}'} % before denoising")
    _print_size_errors(report.get("size_errors", []), say)


def _print_size_errors(errors: Sequence[Mapping[str, Any]], say: Printer) -> None:
    """How well the exemplars stand for the plants: root mean squares of relative errors."""
    if not errors:
        return
    rows = [("species", "plants", "exemplars", "rms size error", "rms crown width error")]
    for one in errors:
        rms = (
            "-" if one[name] is None else f"{100 * one[name]:.1f} %"  # no species of its kind has a crown
            for name in ("radius_rms", "crown_width_rms")
        )
        rows.append((one["species"], f"{one['plants']:,}", f"{one['exemplars']:,}", *rms))
    say.table(rows)
