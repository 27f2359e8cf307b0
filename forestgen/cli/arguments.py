"""Options that commands share: one name, one meaning, everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from forestgen.core.progress import Progress


def option(usage: str, help: str, **settings: Any) -> Any:  # noqa: A002 - as typer names it
    """An option, by its names and metavar as its help page shows them: ``option("--out -o DIR", "A folder.")``."""
    words = usage.split(" ")
    names = [word for word in words if word.startswith("-")]
    return typer.Option(*names, metavar=" ".join(words[len(names) :]) or None, help=help, **settings)


def argument(metavar: str, help: str, **settings: Any) -> Any:  # noqa: A002
    """An argument, by its metavar."""
    return typer.Argument(metavar=metavar, help=help, **settings)


RecipePath = Annotated[Path, argument("RECIPE", "The recipe, a YAML file.", show_default=False)]
DatasetPath = Annotated[Path, argument("DIR", "A data set's folder, of render, batch or merge.", show_default=False)]
Overrides = Annotated[
    list[str] | None,
    option("--set KEY=VALUE", "Override a value of the recipe, such as sky.turbidity=5. May be repeated."),
]
Count = Annotated[
    int | None,
    option("--count N", "How many images, in all; by default as many as the recipe says.", min=1, max=100_000_000),
]
Threads = Annotated[
    int | None,
    option(
        "--threads N",
        "Threads of each worker; by default all cores are shared out. Results do not depend on it.",
        min=1,
        max=4096,
    ),
]
Workers = Annotated[
    int | None,
    option(
        "--workers -w N",
        "Worker processes; by default as many as cores and memory allow. Results do not depend on it.",
        min=1,
        max=1024,
    ),
]
Device = Annotated[
    str | None,
    option(
        "--device llvm|cuda",
        "What traces rays: the processor (llvm) or a GPU (cuda); by default FORESTGEN_TRACING, else llvm.",
    ),
]
Resume = Annotated[bool, option("--resume", "Go on in a data set that is there: make what is missing or has changed.")]
Discard = Annotated[
    bool,
    option(
        "--discard",
        "With --resume: remove finished images that are too many now, or of which recipe or versions have "
        "changed. Without it they are counted, and kept.",
    ),
]
First = Annotated[
    int | None,
    option(
        "--first N",
        "Number of the first image; short for --set first_image=N. For parts that are merged later.",
        min=0,
    ),
]
Window = Annotated[
    tuple[float, float, float, float] | None,
    option(
        "--window X0 X1 Y0 Y1",
        "Where points were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
    ),
]
DryRun = Annotated[bool, option("--dry-run", "Check and estimate time, memory and disk; make nothing.")]
AbsoluteZ = Annotated[bool, option("--absolute-z", "Count z from z = 0, not from the ground below.")]
Overwrite = Annotated[bool, option("--overwrite", "Replace a previous output of forestgen.")]
Seed = Annotated[int, option("--seed N", "Another seed draws other random numbers.", min=0)]
Json = Annotated[bool, option("--json", "Print JSON.")]
Quiet = Annotated[bool, option("--quiet -q", "Show no progress, and print nothing but errors.")]
Verbose = Annotated[bool, option("--verbose -v", "Print all notes, and where the time went.")]


def progress_of(quiet: bool) -> bool | Progress | None:
    """The API's argument `progress`."""
    return False if quiet else None
