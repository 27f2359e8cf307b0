"""The commands of README, docs and recipes: found, read as the command line reads them, and called in Python."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import typer

import forestgen as fg
from forestgen.api.plants import grow_files
from forestgen.cli import app

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
TUTORIALS = tuple(sorted((ROOT / "docs" / "tutorials").glob("*.md")))
_COMMAND = re.compile(r"^(?:\$ )?(?:uv run )?(forestgen [a-z].*)$")
_GROUP: Any = typer.main.get_command(app)


def documented(pages: Sequence[Path] = PAGES) -> list[str]:
    """Every command of a shell block of a page, or of a recipe's comment, once, in order."""
    found: dict[str, None] = {}
    for page in pages:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            found |= dict.fromkeys(commands_of(block))
    for recipe in sorted((ROOT / "recipes").rglob("*.yaml")):
        comments = (line.lstrip("# ") for line in recipe.read_text(encoding="utf-8").splitlines() if line[:1] == "#")
        found |= dict.fromkeys(commands_of("\n".join(comments)))
    return list(found)


def commands_of(text: str) -> Iterator[str]:
    """forestgen's commands among the lines of a shell block."""
    for line in text.replace("\\\n", " ").splitlines():
        command = _COMMAND.match(line.strip())
        if command:
            yield re.split(r"\s{2,}[a-z]|\s+#|\s*[|>&;]", re.sub(r" {2,}--", " --", command[1]))[0].strip()


def python_blocks() -> Iterator[tuple[str, str]]:
    """Page and code of every Python block."""
    for page in (*PAGES, *TUTORIALS):
        for number, block in enumerate(
            re.findall(r"```python(?: title=\S+)?\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        ):
            yield f"{page.name}:{number}", block


def parsed(command: str) -> tuple[str, dict[str, Any]]:
    """Name of a command and its arguments by their names in Python, as typer reads them. Raises what typer raises."""
    name, *arguments = shlex.split(command)[1:]
    context = _GROUP.commands[name].make_context(name, arguments)
    return name, {parameter.removesuffix("_"): value for parameter, value in context.params.items()}


def in_python(command: str) -> Any:
    """Do with the API what a command does."""
    name, given = parsed(command)
    return _CALLS[name](given)


def _loaded(given: dict[str, Any]) -> fg.Recipe:
    first = given.pop("first", None)
    numbers = [f"first_image={first}"] if first is not None else []
    return fg.load(given.pop("recipe"), set=[*(given.pop("set") or ()), *numbers])


def _run(given: dict[str, Any], make: Callable[..., Any]) -> Any:
    for name in ("quiet", "verbose", "dry_run"):
        given.pop(name)
    recipe = _loaded(given)
    resources = given.pop("resources", None)
    more = {"resources": dict(one.split("=") for one in resources)} if resources else {}
    return make(recipe, given.pop("out"), count=given.pop("count"), progress=False, **given, **more)


def _simulate(given: dict[str, Any]) -> Any:
    recipe = _loaded(given)
    lists = {name: given.pop(name) or () for name in ("map_steps", "graphs")}
    del given["quiet"], given["verbose"]
    out = given.pop("out") or f"outputs/{recipe.name}-community"  # Python writes nothing unless it is given a folder
    return recipe.simulate(out, progress=False, **given, **lists)


def _weather(given: dict[str, Any]) -> Any:
    del given["quiet"]
    recipe, files = _loaded(given), given.pop("out") or ()
    return recipe.weather(given.pop("count"), out=files, progress=False, **given)


def _pack(given: dict[str, Any]) -> Any:
    del given["quiet"]
    channels = given.pop("channels")
    return fg.Dataset(given.pop("folder")).pack(
        given.pop("out"),
        given.pop("format"),
        channels=[name for one in channels for name in one.split(",")] if channels else None,
        splits=given.pop("splits") or (),
        progress=False,
        **given,
    )


def _stand(given: dict[str, Any]) -> Any:
    del given["quiet"], given["json"]
    recipe, out = _loaded(given), given.pop("out")
    return recipe.stand(out, progress=False, **given)


def _plant(given: dict[str, Any]) -> Any:
    for name in ("quiet", "json", "list"):
        given.pop(name)
    species, out, count = (given.pop(name) for name in ("species", "out", "count"))
    return grow_files(species, out, count=count, progress=False, **given)


_CALLS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "render": lambda given: _run(given, fg.Recipe.render),
    "batch": lambda given: _run(given, fg.Recipe.batch),
    "simulate": _simulate,
    "weather": _weather,
    "pack": _pack,
    "plant": _plant,
    "stand": _stand,
    "merge": lambda given: fg.merge(
        given["sources"], given["out"], link=given["link"], overwrite=given["overwrite"], progress=False
    ),
    "report": lambda given: fg.Dataset(given["folder"]).report(given["out"]),
    "doctor": lambda given: fg.doctor(),
    "verify": lambda given: fg.verify(
        given["folder"], rerender=given["rerender"], seed=given["seed"], hashes=given["hashes"], progress=False
    ),
}
