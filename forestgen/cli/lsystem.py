"""`forestgen lsystem`: derive an L-system and print what comes out."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from forestgen.core.errors import LsystemError, OutputError, RecipeError
from forestgen.lsystem.compiler import Value, compile_listing, with_values
from forestgen.lsystem.derivation import Derivation, derive
from forestgen.lsystem.multiset import words_as_lists, words_as_text
from forestgen.lsystem.program import Program
from forestgen.lsystem.reading import read_listing
from forestgen.recipe.assets import find_asset

FORMATS = ("string", "json", "count")
_MOST_STEPS = 1_000_000
_CHUNK = 1 << 20


def lsystem(file: Path, steps: int | None, seed: int, form: str, settings: Sequence[str], most_modules: int) -> None:
    """Print the words of FILE after some steps."""
    if form not in FORMATS:
        raise RecipeError("no such format", where="--format", expected=", ".join(FORMATS), got=form)
    path = file if file.exists() else find_asset("lsystems", str(file))
    program = compile_listing(with_values(read_listing(path), _values(settings)))
    wanted = _steps(program, steps)
    last: Derivation | None = None
    for last in derive(program, wanted, seed, most_modules=most_modules):  # noqa: B007 - only the last matters
        pass
    assert last is not None
    if form == "count":
        _write([f"{len(last.multiset.code)}\n"])
    elif form == "string":
        _write(word + "\n" for word in words_as_text(last.multiset))
    else:
        words = [[_plain(module) for module in word] for word in words_as_lists(last.multiset)]
        described = {
            "file": str(path),
            "steps": wanted,
            "seed": seed,
            "modules": len(last.multiset.code),
            "counts": last.multiset.counts(),
            "words": words,
        }
        _write([json.dumps(described), "\n"])


def _steps(program: Program, steps: int | None) -> int:
    wanted = program.derivation_length if steps is None else steps
    if wanted is None:
        raise RecipeError(
            "how many steps?",
            where=program.name,
            expected="--steps N, or derivation length: N in the file",
            got="neither",
        )
    if not 0 <= wanted <= _MOST_STEPS:
        raise RecipeError("no such number of steps", where="--steps", expected=f"0 to {_MOST_STEPS:,}", got=str(wanted))
    return wanted


def _values(settings: Sequence[str]) -> dict[str, Value]:
    """Settings NAME=NUMBER or NAME=NUMBER,NUMBER,..."""
    values: dict[str, Value] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        try:
            numbers = [float(one) for one in text.split(",") if one.strip()]
        except ValueError:
            numbers = []
        if not equals or not name.strip() or not numbers:
            raise LsystemError(
                "not a setting", where="--set", expected="NAME=NUMBER or NAME=NUMBER,NUMBER", got=setting
            )
        values[name.strip()] = numbers if "," in text else numbers[0]
    return values


def _plain(module: Sequence[str | float]) -> list[str | float]:
    """A module with whole numbers written as such."""
    symbol, *values = module
    return [symbol, *(int(v) if isinstance(v, float) and v.is_integer() and abs(v) < 1e15 else v for v in values)]


def _write(lines: Iterable[str]) -> None:
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
