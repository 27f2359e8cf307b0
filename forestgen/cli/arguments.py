"""Options and arguments of commands: lines of a command's docstring, and of `SHARED` where several commands have one.

A line has an option's names and its metavar, or an argument's metavar, then two spaces and what it does; bounds and a
default as people write it may end it: ``--checks N  Test against N sets. [1 to 1000]``. A line of --map-step is of the
parameter `map_step`, `map_steps` or `map_step_`; lines of arguments are of the parameters that are left, in order.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, get_type_hints

import typer

from forestgen.cli.parsing import completion_of
from forestgen.core.progress import Progress

SHARED = """
RECIPE  The recipe, a YAML file.
--set KEY=VALUE  Override a value of the recipe, such as sky.turbidity=5. May be repeated.
--count N  How many images, in all; by default as many as the recipe says. [1 to 100000000]
--threads N  Threads of each worker; by default all cores are shared out. Results do not depend on it. [1 to 4096]
--workers -w N  Worker processes; by default as many as cores and memory allow. Results do not depend on it. [1 to 1024]
--device llvm|cuda  What traces rays: the processor (llvm) or a GPU (cuda); by default FORESTGEN_TRACING, else llvm.
--resume  Go on in a data set that is there: make what is missing or has changed.
--discard  With --resume: remove finished images that are too many now, or of which recipe or versions have changed.
    Without it they are counted, and kept.
--first N  Number of the first image; short for --set first_image=N. For parts that are merged later. [from 0]
--window X0 X1 Y0 Y1  Where points were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.
--dry-run  Check and estimate time, memory and disk; make nothing.
--absolute-z  Count z from z = 0, not from the ground below.
--overwrite  Replace a previous output of forestgen.
--seed N  Another seed draws other random numbers. [from 0]
--json  Print JSON.
--quiet -q  Show no progress, and print nothing but errors.
--verbose -v  Print all notes, and where the time went.
"""
_LINE = re.compile(r"^(-\S.*?|[A-Z][A-Z.]*)  +(\S.*(?:\n {4,}.*)*)\n?", re.MULTILINE)
_END = re.compile(r" \[(?:(\d+) to (\d+)|from (\d+)|default: (.*))\]$")


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command with its parameters as typer's options and arguments; its docstring keeps the other lines."""
    text = inspect.getdoc(command) or ""
    own, shared = _lines(text), _lines(SHARED)
    hints = {name: hint for name, hint in get_type_hints(command).items() if name != "return"}
    found = {name: _named(name, own) or _named(name, shared) for name in hints}
    taken = list(found.values())
    left = (line for line in own.values() if line not in taken)
    for name, hint in hints.items():
        usage, about = found[name] or next(left)
        completion = completion_of(command.__name__, name)
        command.__annotations__[name] = Annotated[hint, _parameter(usage, about, completion)]
    command.__doc__ = _LINE.sub("", text).strip()
    return command


def _lines(text: str) -> dict[str, tuple[str, str]]:
    """Name in Python -> usage and help."""
    found = {}
    for usage, about in _LINE.findall(text):
        name = next((word for word in usage.split() if word.startswith("--")), usage.rstrip("."))
        name = name.removeprefix("--").partition("/")[0].replace("-", "_").lower()
        found[name] = usage, " ".join(about.split())
    return found


def _named(name: str, lines: Mapping[str, tuple[str, str]]) -> tuple[str, str] | None:
    return lines.get(name) or lines.get(name.removesuffix("s")) or lines.get(name.removesuffix("_"))


def _parameter(usage: str, about: str, completion: Callable[[str], list[str]]) -> Any:
    """Typer's option or argument of a line."""
    settings: dict[str, Any] = {"autocompletion": completion}
    if end := _END.search(about):
        about, low, default = about[: end.start()], end[1] or end[3], end[4]
        settings |= {"show_default": default} if default else {"min": int(low), "max": end[2] and int(end[2])}
    if not usage.startswith("-"):
        return typer.Argument(metavar=usage, help=about, **settings)
    words = usage.split()
    names = [word for word in words if word.startswith("-")]
    return typer.Option(*names, metavar=" ".join(words[len(names) :]) or None, help=about, **settings)


def progress_of(quiet: bool) -> bool | Progress | None:
    """The API's argument `progress`."""
    return False if quiet else None


def listed_names(values: Iterable[str] | None) -> list[str]:
    """The names of an option that may be repeated, and takes several at a time: ``A,B``."""
    return [name for value in values or () for one in value.split(",") if (name := one.strip())]
