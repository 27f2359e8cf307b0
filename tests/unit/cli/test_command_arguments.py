"""Options and arguments are lines of a command's docstring."""

from __future__ import annotations

from typing import Any

import typer

from forestgen.cli.parsing import with_options


def made_of(command: Any) -> Any:
    app = typer.Typer(rich_markup_mode=None)
    app.command()(with_options(command))
    return typer.main.get_command(app)


def test_a_line_belongs_to_the_parameter_of_its_name() -> None:
    def command(where: str, map_steps: list[int] | None = None, set_: str = "a", quiet: bool = False) -> None:
        """Do it.

        More about it.

        PLACE  Where
            to do it.
        --map-step N  A step. [1 to 9]
        --set -s KEY  Of a row. [default: that of A]
        """

    made = made_of(command)
    assert made.help == "Do it.\n\nMore about it."
    where, steps, setting, quiet, *_ = made.params
    assert (where.metavar, where.help) == ("PLACE", "Where to do it.")
    assert (steps.opts, steps.metavar, steps.help) == (["--map-step"], "N", "A step.")
    assert "[1<=x<=9]" in steps.get_help_record(made.make_context("command", ["here"]))[1]
    assert (setting.opts, setting.metavar, setting.show_default) == (["--set", "-s"], "KEY", "that of A")
    assert quiet.opts == ["--quiet", "-q"]
    assert quiet.help == "Show no progress, and print nothing but errors."
