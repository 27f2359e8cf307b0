"""The command `lsystem`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.arguments import Seed

FORMATS = ("string", "json", "count")
_CHUNK = 1 << 20


def lsystem(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="An L-system program: a .lsys or .sys file, or a shipped one's name.")
    ],
    steps: Annotated[
        int | None,
        typer.Option("--steps", metavar="N", help="Derivation steps; by default the file's derivation length."),
    ] = None,
    seed: Seed = 0,
    form: Annotated[
        str,
        typer.Option("--format", metavar="string|json|count", help="Words, their modules as JSON, or their number."),
    ] = "string",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Another value of a #define, or of an array: A=1,2,3."),
    ] = None,
    max_modules: Annotated[
        int,
        typer.Option(
            "--max-modules", metavar="N", min=1, max=10**9, help="Stop where the words grow longer than this."
        ),
    ] = 50_000_000,
) -> None:
    """Derive an L-system and print the string, or the words of the multiset."""
    from forestgen import derive
    from forestgen.core.errors import RecipeError

    if form not in FORMATS:
        raise RecipeError("no such format", where="--format", expected=", ".join(FORMATS), got=form)
    words = derive(file, steps, seed=seed, set=settings or (), max_modules=max_modules)
    if form == "count":
        _write([f"{words.modules}\n"])
    elif form == "string":
        _write(word + "\n" for word in words.text)
    else:
        _write([json.dumps(words.as_dict()), "\n"])


def _write(lines: Iterable[str]) -> None:
    from forestgen.core.errors import OutputError

    try:
        _write_chunks(lines)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError("the words cannot be written", where="standard output", got=str(error)) from error


def _write_chunks(lines: Iterable[str]) -> None:
    held: list[str] = []
    size = 0
    for line in lines:
        held.append(line)
        size += len(line)
        if size > _CHUNK:
            sys.stdout.write("".join(held))
            held, size = [], 0
    sys.stdout.write("".join(held))
