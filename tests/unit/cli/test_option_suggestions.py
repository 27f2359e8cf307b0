"""Unknown options are answered by an option that the command has."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from forestgen.cli import app
from forestgen.cli.parsing import _MEANT, options_suggested, suggestion, with_options


def command_of(*options: str, recipe: bool = True) -> Any:
    """A command with flags of these names, and with a recipe and `--set`."""

    def with_recipe(recipe: str, set_: list[str] | None = None) -> None: ...

    def without() -> None: ...

    one = typer.Typer()
    one.command()(with_options(with_recipe if recipe else without))
    made = typer.main.get_command(one)
    made.params += [SimpleNamespace(name=option, opts=[option]) for option in options]
    return made


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("--output", ["--out"], "--out"),
        ("--out", ["--output"], "--output"),
        ("--output_dir", ["--out"], "--out"),
        ("--images", ["--count"], "--count"),
        ("--n", ["--count"], "--count"),
        ("--n", [], "--set images=10"),
        ("--jobs", ["--workers", "--threads"], "--workers"),
        ("--jobs", ["--threads"], "--threads"),
        ("-j", ["--workers"], "--workers"),
        ("--threads", ["--workers"], "--workers"),
        ("--gpu", ["--device"], "--device"),
        ("--gpu", ["--output"], None),
        ("--config", [], "RECIPE"),
        ("--size", [], "--set cameras.0.size_px=[640,360]"),
        ("--size", ["--size-px"], "--size-px"),
        ("--force", ["--overwrite"], "--overwrite"),
        ("--ovewrite", ["--overwrite"], "--overwrite"),
        ("--nothing-like-it", ["--overwrite"], None),
        ("-z", ["--overwrite"], None),
    ],
)
def test_what_was_meant(name: str, options: list[str], expected: str | None) -> None:
    assert suggestion(name, command_of(*options)) == expected


def test_keys_of_a_recipe_are_set_only_where_there_is_one() -> None:
    assert suggestion("--size", command_of(recipe=False)) is None
    assert suggestion("--config", command_of(recipe=False)) is None


def commands(group: Any) -> list[Any]:
    found = []
    for one in group.commands.values():
        found += commands(one) if hasattr(one, "commands") else [one]
    return found


@pytest.mark.parametrize("command", commands(typer.main.get_command(app)), ids=lambda one: str(one.name))
def test_only_what_the_command_has_is_suggested(command: Any) -> None:
    has = {option for one in command.params for option in one.opts}
    for name in {*_MEANT, "--outt", "--sett"} - has:
        found = suggestion(name, command)
        assert found is None or found == "RECIPE" or found.split()[0] in has


def test_the_message_of_the_command_line() -> None:
    said = CliRunner().invoke(app, ["render", "stand.yaml", "--config", "x"])
    assert said.exit_code == 2
    assert "No such option: --config. The recipe's file is an argument: " in said.output
    assert "render RECIPE" in said.output
    said = CliRunner().invoke(app, ["render", "stand.yaml", "--size", "3"])
    assert "A value of the recipe is set by --set cameras.0.size_px=[640,360]" in said.output
    said = CliRunner().invoke(app, ["validate", "stand.yaml", "--zzz"])
    assert "No such option: --zzz\n" in said.output


def test_other_errors_pass() -> None:
    with pytest.raises(KeyError), options_suggested():
        raise KeyError("other")


def test_an_option_in_the_singular_means_that_in_the_plural() -> None:
    assert suggestion("--worker", command_of("--worker-memory", "--workers")) == "--workers"
