"""The commands that make nothing: `validate`, `schema`, `models`, `doctor`."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path

import typer

from forestgen.cli.console import Printer


def validate(recipe: Path, set_: list[str] | None = None, json_: bool = False) -> None:
    """Check a recipe without making anything, and say what it would make."""
    from forestgen import load

    found, say = load(recipe, set=set_).validate(), Printer()
    if json_:
        say.json(found.as_dict())
        return
    for line in str(found).splitlines():
        say(line)
    for note in found.notes:
        say(f"note: {note}")


def schema() -> None:
    """Print the JSON Schema of recipes, for editors."""
    from forestgen import schema as schema_of

    sys.stdout.write(json.dumps(schema_of(), indent=2) + "\n")


def models(name: str | None = None, kind: str | None = None, json_: bool = False) -> None:
    """List models, generators, data set formats and all other parts, species and recipes.

    NAME  Show this part's manual page, or this species' or recipe's file.
    --kind KIND  Only these, such as community_model or species; an unknown one lists the kinds.
    """
    from forestgen import models as list_models
    from forestgen.recipe.assets import recipes_dir, scenes_dir

    found, say = list_models(name, kind=kind), Printer()
    if json_:
        say.json([{**one.as_dict(), "page": one.page} if name is not None else one.as_dict() for one in found])
        return
    if name is not None:
        say("\n\n".join(one.page for one in found))
        return
    for each, entries in groupby(found, key=lambda one: one.kind):
        say(each if each == "species" else f"{each.replace('_', ' ')}s")
        listed = list(entries)
        width = max(len(one.name) for one in listed)
        for one in listed:
            say(f"  {one.name:<{width}}  {one.description}".rstrip())
    say(f"species and lsystems lie in {scenes_dir()}, recipes in {recipes_dir()}")


def doctor(json_: bool = False) -> None:
    """Check this machine, and say what to do about what is missing. Exit code 3 if it cannot render."""
    from forestgen import doctor as diagnose
    from forestgen.core.errors import ResourceError

    found, say = diagnose(), Printer()
    if json_:
        say.json(found.as_dict())
    else:
        for line in found.lines():
            say(line)
    if not found.ready:
        raise typer.Exit(ResourceError.exit_code)
