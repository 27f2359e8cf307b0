"""The command `batch`."""

from __future__ import annotations

from typing import Annotated, Optional

import typer

from forestgen.cli.arguments import Overrides, RecipePath

_ENGINES = ("local", "dask")


def batch(
    recipe: RecipePath,
    count: Annotated[
        int, typer.Option("--count", metavar="N", min=1, max=100_000_000, help="Images of the data set, in all.")
    ],
    out: Annotated[
        str,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="The data set's folder, or its address in an object store: s3://bucket/forests.",
        ),
    ],
    overrides: Overrides = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on in a data set that is there: make what is missing or has changed.")
    ] = False,
    discard: Annotated[
        bool,
        typer.Option(
            "--discard",
            help="With --resume: throw finished images away that are too many now, or of which recipe or versions have "
            "changed. Without it they are counted, and kept.",
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and estimate time, memory and disk; make nothing.")
    ] = False,
    workers: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--workers",
            metavar="K",
            min=1,
            max=1024,
            help="Processes of the local engine; by default as many as cores and memory allow.",
            show_default=False,
        ),
    ] = None,
    threads: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--threads",
            metavar="T",
            min=1,
            max=1024,
            help="Threads of each worker; by default all cores are shared out. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
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
            metavar="R",
            min=0,
            max=100,
            help="Further attempts at an image that failed for a reason that may pass.",
        ),
    ] = 2,
    first: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--first",
            metavar="N",
            min=0,
            help="Number of the first image; short for --set first_image=N. For parts that are merged later.",
            show_default=False,
        ),
    ] = None,
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
) -> None:
    """Make a data set of many images, with many workers; go on where it was interrupted."""
    from forestgen.cli import batch_command

    if engine not in _ENGINES:
        raise typer.BadParameter(f"{engine!r} is none of {', '.join(_ENGINES)}", param_hint="--engine")
    if engine == "local" and (scheduler is not None or resources):
        raise typer.BadParameter("--scheduler and --resource belong to --engine dask", param_hint="--engine")
    if engine == "dask" and workers is not None:
        raise typer.BadParameter("the cluster has its own workers", param_hint="--workers")
    if engine == "dask" and timeout is not None:
        raise typer.BadParameter("only workers of this machine can be stopped", param_hint="--timeout")
    if discard and not resume:
        raise typer.BadParameter("it belongs to --resume", param_hint="--discard")
    asked = batch_command.Asked(
        recipe=recipe,
        overrides=(*(overrides or ()), *([f"first_image={first}"] if first is not None else [])),
        count=count,
        target=out,
        resume=resume,
        discard=discard,
        workers=workers,
        threads=threads,
        memory_bytes=None if worker_memory is None else batch_command.bytes_of(worker_memory, "--worker-memory"),
        timeout_s=None if timeout is None else batch_command.seconds_of(timeout, "--timeout"),
        retries=retries,
        engine=engine,
        scheduler=scheduler,
        resources=batch_command.amounts(resources or ()),
    )
    if dry_run:
        batch_command.dry_run(asked)
    else:
        batch_command.batch(asked)
