"""Parameters of Python's calls as options: errors name the former, and the command line shows the latter.

In an error a parameter is its place, ``count: no such number``, or stands between backticks, `` `overwrite=True` ``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import typer

_PLACE = re.compile(r"(?P<before>(?:error: )?)(?P<name>[a-z][a-z0-9_]*)(?:=(?P<value>\w+))?(?=: )")
_QUOTED = re.compile(r"`(?P<name>[a-z][a-z0-9_]*)(?:=(?P<value>[^`]+))?`")
_OVERRIDE = re.compile(r"(?P<before>^(?:error: )?|\(named by )set (?=\S*=|\S+: not an override)")
#: Of other commands than the one that fails, such as that which made a data set.
_ELSEWHERE = {
    "resume": "--resume",
    "workers": "--workers",
    "split": "--split",
    "set": "--set",
    "allow_folders": "--allow-folder",
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


def in_options(text: str, names: Mapping[str, str]) -> str:
    """The text of errors with options in place of parameters.

    Parameters
    ----------
    names : of the command, see `names_of`.
    """
    known = {**_ELSEWHERE, **_SOURCE, **names}

    def shown(found: re.Match[str], join: str) -> str | None:
        option, value = known.get(found["name"]), found["value"]
        if option is None or value in (None, "True"):
            return option
        value = value.strip("'\"")
        return f"{option}{join}'{value}'" if " " in value else f"{option}{join}{value}"

    def place(found: re.Match[str]) -> str:
        option = shown(found, " ")
        return found[0] if option is None else found["before"] + option

    lines = []
    for line in text.split("\n"):
        if not line.startswith("  "):
            line = _OVERRIDE.sub(r"\g<before>--set ", line)
            line = _PLACE.sub(place, line, count=1) if _PLACE.match(line) else line
        if not line.startswith("  got"):
            line = _QUOTED.sub(lambda found: shown(found, " ") or found[0], line)
        lines.append(line)
    return "\n".join(lines)
