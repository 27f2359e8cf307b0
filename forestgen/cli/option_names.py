"""Parameters of Python's calls as options: errors name the former, and the command line shows the latter.

An error has its `parameter`; in its words a parameter stands between backticks, `` `overwrite=True` ``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import typer

from forestgen.core.errors import ForestgenError

_QUOTED = re.compile(r"`([a-z][a-z0-9_]*(?:='.*?'|=[^'`][^`]*)?)`", re.DOTALL)
#: Of other commands than the one that fails, such as that which made a data set.
_ELSEWHERE = {
    "resume": "--resume",
    "workers": "--workers",
    "split": "--split",
    "set": "--set",
    "allow_folders": "forestgen --allow-folder",  # before the command's name
}
_SOURCE = {"source": "RECIPE", "sources": "DIR..."}  # arguments by the names that they have in Python


def names_of(command: Any) -> dict[str, str]:
    """Parameter in Python -> option or argument of a command; several values are one name, `splits` and --split."""
    found = {}
    for one in command.params:
        if isinstance(one, typer.core.TyperArgument):
            found[one.name] = one.metavar or str(one.name).upper()
            continue
        option = next((name for name in one.opts if name.startswith("--")), one.opts[0])
        name = option.removeprefix("--").replace("-", "_")
        found |= {one.name: option, name: option, f"{name}s": option}
    return found


def in_options(error: ForestgenError, names: Mapping[str, str]) -> str:
    """The text of one error with options in place of parameters; what it got is a user's and stays.

    Parameters
    ----------
    names : of the command, see `names_of`.
    """
    known = {**_ELSEWHERE, **_SOURCE, **names}

    def option(parameter: str) -> str | None:
        """``workers=8`` as ``--workers 8``; None if there is no such option."""
        name, _, value = parameter.partition("=")
        if name not in known or value in ("", "True"):
            return known.get(name)
        value = value[1:-1] if value.startswith("'") else value
        return f"{known[name]} '{value}'" if " " in value else f"{known[name]} {value}"

    def words(text: str | None) -> str | None:
        return text and _QUOTED.sub(lambda found: option(found[1]) or found[0], text)

    where = words(error.where)
    if error.parameter is not None:
        where = option(error.parameter) or error.parameter
    problem = words(error.problem) or ""
    expected, hint = words(error.expected), words(error.hint)
    return str(ForestgenError(problem, where=where, expected=expected, got=error.got, hint=hint))
