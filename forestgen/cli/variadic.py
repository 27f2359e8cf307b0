"""Options that take several values: `--radii 0.05 0.1`, which typer reads as one value and a stray argument."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import typer

_LIKE_A_NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)", re.IGNORECASE)


def repeat_option(arguments: Sequence[str], option: str) -> list[str]:
    """`option a b c` as `option a option b option c`, as far as what follows looks like a number."""
    repeated: list[str] = []
    rest = list(arguments)
    while rest:
        one = rest.pop(0)
        if one == "--":
            return [*repeated, one, *rest]
        repeated.append(one)
        if one != option or not rest:
            continue
        repeated.append(rest.pop(0))
        while rest and _LIKE_A_NUMBER.match(rest[0]):
            repeated += [option, rest.pop(0)]
    return repeated


class RadiiCommand(typer.core.TyperCommand):
    """A command whose option --radii takes several numbers."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, repeat_option(args, "--radii"))
