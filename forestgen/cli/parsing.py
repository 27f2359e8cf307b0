"""What typer does not do with a command's words: options by its docstring, numbers in a row, suggestions, completion.

Options and arguments are lines of a command's docstring, and of `SHARED` where several commands have one. A line has an
option's names and its metavar, or an argument's metavar, then two spaces and what it does; bounds and a default as
people write it may end it: ``--checks N  Test against N sets. [1 to 1000]``. A line of --map-step is of the parameter
`map_step`, `map_steps` or `map_step_`; lines of arguments are of the parameters that are left, in order.

An unknown option is answered by what it was meant for: by the names that other programs give it, then by its spelling.
Only options that the command has are suggested, and `--set` with a key only where it sets keys of a recipe.
"""

from __future__ import annotations

import difflib
import inspect
import itertools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal, get_type_hints

import typer
from typer import completion

from forestgen.recipe.suggestions import did_you_mean

_LIKE_A_NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)", re.IGNORECASE)


def join_numbers(arguments: Sequence[str], option: str, most: int | None = None) -> list[str]:
    """`option x y z` as `option=x,y,z`, as far as what follows looks like a number; of `most` numbers, None: all."""
    joined: list[str] = []
    rest = list(arguments)
    while rest and rest[0] != "--":
        joined.append(rest.pop(0))
        numbers = list(itertools.takewhile(_LIKE_A_NUMBER.match, rest[:most])) if joined[-1] == option else []
        if numbers:
            joined[-1] = f"{option}={','.join(numbers)}"
            del rest[: len(numbers)]
    return [*joined, *rest]


class NumbersCommand(typer.core.TyperCommand):
    """A command whose options may take several numbers in a row: typer has no such options that may be repeated.

    Metavars tell how many: ``X Y Z``, or any number as in ``R...``.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        parameters: Any = self.params
        for one in parameters:
            words = (one.metavar or "").split()
            if getattr(one, "multiple", False) and (len(words) > 1 or words[-1:] == ["R..."]):
                args = join_numbers(args, one.opts[0], len(words) if len(words) > 1 else None)
        return super().parse_args(ctx, args)


class _Argument(typer.core.TyperArgument):
    """An argument that help pages show by its name alone, `RECIPE`; typer's own are `{RECIPE}` and `RECIPE <path>`."""

    def get_usage_pieces(self, ctx: Any) -> list[str]:
        return [self._shown if self.required else f"[{self._shown}]"]

    def get_help_record(self, ctx: Any) -> tuple[str, str] | None:
        record = super().get_help_record(ctx)
        return None if record is None else (self._shown, record[1])

    @property
    def _shown(self) -> str:
        return self.metavar or str(self.name).upper()


def show_plainly(group: Any) -> None:
    """Show the arguments of a group's commands by their names alone."""
    for command in group.commands.values():
        for parameter in command.params:
            if isinstance(parameter, typer.core.TyperArgument):
                parameter.__class__ = _Argument  # typer makes the arguments, and has no place to name another class


_RECIPE = "RECIPE"  # stands for the argument of that name

#: What does the job -> names that it has elsewhere. Of several that do it, the first that the command has is suggested.
_CALLED: dict[tuple[str, ...], str] = {
    ("--out", "--output"): "--out --output --output-dir --out-dir --outdir --output-folder --folder --dest "
    "--destination --save --target -o -O",
    ("--count", "--images", "--set images=10"): "--count --images --n --num --number --num-images --n-images -n -c",
    ("--workers", "--threads"): "--workers --jobs --processes --num-workers --nproc --parallel -j -w",
    ("--threads", "--workers"): "--threads --cores --cpus --num-threads --n-threads -t",
    (_RECIPE,): "--config --recipe --file --input --cfg --yaml -f -i",
    ("--device",): "--device --gpu --cuda --cpu --backend --accelerator",
    ("--size-px", "--set cameras.0.size_px=[640,360]"): "--size-px --size --resolution --res --width --height "
    "--image-size",
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
        if type(error).__name__ == "MissingParameter":
            missing: Any = error
            missing.message = missing.param.help
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
    """What `command`, of the command line, has for an option `name` that it lacks; None: nothing is near."""
    options = [option for one in command.params if not isinstance(one, typer.core.TyperArgument) for option in one.opts]
    takes_recipe = any(isinstance(one, typer.core.TyperArgument) and one.name == "recipe" for one in command.params)
    plain = name.replace("_", "-")
    if f"{plain}s" in options:
        return f"{plain}s"
    begun = [option for option in options if option.startswith(f"{plain}-")]
    if len(begun) == 1:
        return str(begun[0])
    for does in _MEANT.get(plain, ()):
        is_key = takes_recipe and (does == _RECIPE or (" " in does and "--set" in options))
        if does != name and (does in options or is_key):
            return does
    if not name.startswith("--"):
        return None
    spelled = {option.removeprefix("--"): option for option in options if option.startswith("--")}
    near = difflib.get_close_matches(plain.removeprefix("--"), spelled, n=1)
    return spelled[near[0]] if near else None


_VARIABLE = "_FORESTGEN_COMPLETE"  # as typer makes it of the program's name


def _assets(kind: str) -> list[str]:
    from forestgen.recipe.assets import list_assets

    return list_assets(kind)


def _model_names() -> list[str]:
    from forestgen import models

    return list(dict.fromkeys(one.name for one in models()))


#: Command and parameter -> the names that may stand there; a path may stand there too.
_NAMES: dict[tuple[str, str], Callable[[], list[str]]] = {
    ("plant", "species"): lambda: _assets("species"),
    ("fit_kernel", "species"): lambda: _assets("species"),
    ("lsystem", "file"): lambda: _assets("lsystems"),
    ("models", "name"): _model_names,
}


def completion_of(command: str, parameter: str) -> Callable[[str], list[str]]:
    """What a shell may complete: names that come with forestgen.

    Typer would name files that are there already, and the shell would offer nothing else: files are left to the shell.
    """

    def complete(incomplete: str) -> list[str]:
        names = _NAMES.get((command, parameter))
        return [] if names is None else [name for name in names() if name.startswith(incomplete)]

    return complete


def print_script(
    shell: Annotated[Literal["bash", "zsh", "fish"], typer.Argument(metavar="bash|zsh|fish", show_default=False)],
) -> None:
    """Print a script that completes commands, options and shipped names in a shell."""
    make = completion.get_completion_script  # type: ignore[attr-defined]
    typer.echo(make(prog_name="forestgen", complete_var=_VARIABLE, shell=shell))


def add_completion(app: typer.Typer) -> None:
    """Give the program its command, and, where a shell asks for it, the answers."""
    app.command("completion", epilog="Example: forestgen completion bash > ~/.forestgen-completion.bash")(print_script)
    if _VARIABLE in os.environ:
        completion.completion_init()  # type: ignore[attr-defined]


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
        complete = completion_of(command.__name__, name)
        command.__annotations__[name] = Annotated[hint, _parameter(usage, about, complete)]
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


def _parameter(usage: str, about: str, complete: Callable[[str], list[str]]) -> Any:
    """Typer's option or argument of a line."""
    settings: dict[str, Any] = {"autocompletion": complete}
    if end := _END.search(about):
        about, low, default = about[: end.start()], end[1] or end[3], end[4]
        settings |= {"show_default": default} if default else {"min": int(low), "max": end[2] and int(end[2])}
    if not usage.startswith("-"):
        return typer.Argument(metavar=usage, help=about, **settings)
    words = usage.split()
    names = [word for word in words if word.startswith("-")]
    return typer.Option(*names, metavar=" ".join(words[len(names) :]) or None, help=about, **settings)
