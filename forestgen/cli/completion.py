"""`forestgen completion SHELL`: a script by which a shell completes commands, options and shipped names."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Annotated, Any, Literal

import typer
from typer import completion

_VARIABLE = "_FORESTGEN_COMPLETE"  # as typer makes it of the program's name


def _assets(*kinds: str) -> list[str]:
    from forestgen.recipe.assets import list_assets

    return [name for kind in kinds for name in list_assets(kind)]


def _model_names() -> list[str]:
    from forestgen import models

    return list(dict.fromkeys(one.name for one in models()))


#: Command and parameter -> the names that may stand there; a path may stand there too.
_NAMES: dict[tuple[str, str], Callable[[], list[str]]] = {
    ("plant", "species"): lambda: _assets("species"),
    ("fit-kernel", "species"): lambda: _assets("species"),
    ("lsystem", "file"): lambda: _assets("lsystems"),
    ("models", "name"): _model_names,
}


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


def complete_names(group: Any) -> None:
    """Let the commands of a group complete names that come with forestgen, and leave files to the shell."""
    if _VARIABLE not in os.environ:
        return
    for command in group.commands.values():
        if hasattr(command, "commands"):
            complete_names(command)
        for parameter in command.params:
            _complete(parameter, _NAMES.get((command.name, parameter.name)))


def _complete(parameter: Any, names: Callable[[], list[str]] | None) -> None:
    of_typer = parameter.shell_complete

    def complete(context: Any, incomplete: str) -> list[Any]:
        if names is not None:
            item = typer.core.CompletionItem  # type: ignore[attr-defined]
            return [item(name) for name in names() if name.startswith(incomplete)]
        # Where typer leaves a file to the shell, it names what is there already, which would be all that is offered.
        return [one for one in of_typer(context, incomplete) if one.type == "plain"]

    parameter.shell_complete = complete
