"""What an unknown option was meant for: by the names that other programs give it, then by its spelling.

Only options that the command has are suggested, and `--set` with a key only where it sets keys of a recipe.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import typer

from forestgen.recipe.suggestions import did_you_mean

_RECIPE = "RECIPE"  # stands for the argument of that name

#: What does the job -> names that it has elsewhere. Of several that do it, the first that the command has is suggested.
_CALLED: dict[tuple[str, ...], str] = {
    (
        "--out",
        "--output",
    ): "--out --output --output-dir --out-dir --outdir --output-folder --folder --dest --destination "
    "--save --target -o -O",
    ("--count", "--images", "--set images=10"): "--count --images --n --num --number --num-images --n-images -n -c",
    ("--workers", "--threads"): "--workers --jobs --processes --num-workers --nproc --parallel -j -w",
    ("--threads", "--workers"): "--threads --cores --cpus --num-threads --n-threads -t",
    (_RECIPE,): "--config --recipe --file --input --cfg --yaml -f -i",
    ("--device",): "--device --gpu --cuda --cpu --backend --accelerator",
    (
        "--size-px",
        "--set cameras.0.size_px=[640,360]",
    ): "--size-px --size --resolution --res --width --height --image-size",
    ("--samples", "--set render.samples=64"): "--samples --spp --quality",
    ("--seed", "--set seed=3"): "--seed --random-seed --rng --random-state -s",
    ("--steps", "--set community.steps=100"): "--steps --years --iterations --time-steps",
    ("--set",): "--set --param --parameter --override --define --option -D -p",
    ("--overwrite",): "--overwrite --force --replace --clobber --yes -y",
    ("--dry-run",): "--dry-run --dry --check-only --simulate-only --no-act --plan",
    ("--quiet",): "--quiet --silent --no-progress -q",
    ("--verbose",): "--verbose --debug --log-level --loglevel -v",
    ("--json",): "--json --as-json --output-format",
    ("--format",): "--format --formats --type",
    ("--resume",): "--resume --continue --restart",
    ("--species", "--set species.spruce=spruce"): "--species --plants --trees",
    ("--set sky.clouds=noise",): "--clouds --cloud",
    ("--set sky.sun.elevation_deg=40",): "--sun --sun-elevation",
    ("--set plants.season=autumn",): "--season",
    ("--set site.size_m=[80,80]",): "--site --site-size --area --extent",
    ("--set community.model=multiset_lsystem",): "--model --community",
}
_MEANT = {name: does for does, names in _CALLED.items() for name in names.split()}
_BOUNDS = {"greater_than_equal": ("at least", "ge"), "less_than_equal": ("at most", "le")}


@contextmanager
def options_suggested() -> Iterator[None]:
    """Let the error of an unknown option say which one does the job."""
    try:
        yield
    except Exception as error:
        cause: Any = error.__cause__
        if isinstance(error, typer.BadParameter) and hasattr(cause, "errors"):
            error.message = _value_message(cause.errors()[0])
        name, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
        if type(error).__name__ == "NoSuchOption" and isinstance(name, str) and context is not None:
            unknown: Any = error
            unknown.message = _message(name, context)
            unknown.possibilities = None
        raise


def _value_message(details: Mapping[str, Any]) -> str:
    """What is wrong with a value, in the words of recipes."""
    from forestgen.core.arguments import shown
    from forestgen.recipe.messages import expectation

    kind, context, given = details["type"], details.get("ctx", {}), details["input"]
    if kind == "value_error":  # of a choice: 'bsh' is not one of 'bash', 'zsh', 'fish'.
        text = str(context["error"])
        choices = re.findall(r"'([^']*)'", text.partition("is not one of")[2])
        near = did_you_mean(str(given), choices)
        return text + (f" {near[0].upper()}{near[1:]}" if near else "")
    bound = _BOUNDS.get(kind)
    if bound is not None:
        return f"{given} is not {bound[0]} {context[bound[1]]:,}."
    return f"{shown(given)} is not {expectation(kind, context, details['msg'])}."


def _message(name: str, context: Any) -> str:
    found = suggestion(name, context.command)
    if found == _RECIPE:
        return f"No such option: {name}. The recipe's file is an argument: {context.command_path} {_RECIPE}"
    if found is not None and " " in found:
        return f"No such option: {name}. A value of the recipe is set by {found}"
    return f"No such option: {name}" + ("" if found is None else f". Did you mean {found}?")


def suggestion(name: str, command: Any) -> str | None:
    """What `command` has for an option `name` that it lacks; None: nothing is near.

    Parameters
    ----------
    name : with its dashes.
    command : a command of the command line, with its `params`.
    """
    options = [option for one in command.params if not isinstance(one, typer.core.TyperArgument) for option in one.opts]
    takes_recipe = any(isinstance(one, typer.core.TyperArgument) and one.name == "recipe" for one in command.params)
    begun: list[str] = [option for option in options if option.startswith(f"{name.replace('_', '-')}-")]
    if len(begun) == 1:
        return begun[0]
    for does in _MEANT.get(name.replace("_", "-"), ()):
        if does != name and (
            does in options or (takes_recipe and (does == _RECIPE or (" " in does and "--set" in options)))
        ):
            return does
    if not name.startswith("--"):
        return None
    spelled = {option.removeprefix("--"): option for option in options if option.startswith("--")}
    near = difflib.get_close_matches(name.removeprefix("--").replace("_", "-"), spelled, n=1)
    return spelled[near[0]] if near else None
