"""Options that commands share: one name, one meaning, everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forestgen.core.progress import Progress

RecipePath = Annotated[Path, typer.Argument(metavar="RECIPE", help="The recipe, a YAML file.", show_default=False)]
DatasetPath = Annotated[
    Path, typer.Argument(metavar="DIR", help="A data set's folder, of render, batch or merge.", show_default=False)
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a value of the recipe, such as sky.turbidity=5. May be repeated."
    ),
]
Count = Annotated[
    int | None,
    typer.Option(
        "--count",
        metavar="N",
        min=1,
        max=100_000_000,
        help="How many images, in all; by default as many as the recipe says.",
    ),
]
Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        metavar="N",
        min=1,
        max=4096,
        help="Threads of each worker; by default all cores are shared out. Results do not depend on it.",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        "-w",
        metavar="N",
        min=1,
        max=1024,
        help="Worker processes; by default as many as cores and memory allow. Results do not depend on it.",
    ),
]
Device = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="llvm|cuda",
        help="What traces rays: the processor (llvm) or a GPU (cuda); by default FORESTGEN_TRACING, else llvm.",
    ),
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on in a data set that is there: make what is missing or has changed.")
]
Discard = Annotated[
    bool,
    typer.Option(
        "--discard",
        help="With --resume: remove finished images that are too many now, or of which recipe or versions have "
        "changed. Without it they are counted, and kept.",
    ),
]
First = Annotated[
    int | None,
    typer.Option(
        "--first",
        metavar="N",
        min=0,
        help="Number of the first image; short for --set first_image=N. For parts that are merged later.",
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Check and estimate time, memory and disk; make nothing.")]
AbsoluteZ = Annotated[bool, typer.Option("--absolute-z", help="Count z from z = 0, not from the ground below.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a previous output of forestgen.")]
Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Another seed draws other random numbers.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress, and print nothing but errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print all notes, and where the time went.")]


def progress_of(quiet: bool) -> bool | Progress | None:
    """The API's argument `progress`."""
    return False if quiet else None


def with_first(overrides: list[str] | None, first: int | None) -> list[str]:
    """Overrides with the number of the first image."""
    return [*(overrides or []), *([f"first_image={first}"] if first is not None else [])]
