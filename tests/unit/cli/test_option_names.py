"""Errors name parameters of Python; the command line shows its options."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import forestgen
from forestgen.cli import app
from forestgen.cli.console import in_options, names_of
from forestgen.core.errors import ForestgenError, RecipeErrors
from forestgen.recipe.assemble import apply_override
from forestgen.recipe.sources import SourceMap

GROUP: Any = typer.main.get_command(app)


def names(command: str) -> dict[str, str]:
    return names_of(GROUP.commands[command])


@pytest.mark.parametrize(
    ("command", "parameter", "shown"),
    [
        ("render", "count", "--count"),
        ("batch", "workers=8", "--workers 8"),
        ("simulate", "map_steps", "--map-step"),
        ("light", "normals", "--normal"),
        ("calibrate", "normal", "--normal"),
        ("plant", "species", "SPECIES"),
        ("fit-kernel", "species", "--species"),
        ("render", "source", "RECIPE"),
        ("merge", "sources", "DIR..."),
        ("render", "allow_folders", "forestgen --allow-folder"),
        ("render", "nothing_like_it", "nothing_like_it"),
    ],
)
def test_a_parameter_becomes_an_option(command: str, parameter: str, shown: str) -> None:
    error = ForestgenError("this is wrong", parameter=parameter, got="0")
    assert str(error) == f"{parameter}: this is wrong\n  got       0"
    assert in_options(error, names(command)) == f"{shown}: this is wrong\n  got       0"


@pytest.mark.parametrize("place", ["out", "source", "set", "split", "resume", "workers", "count=3", "set a=b"])
def test_a_file_of_an_options_name_stays(place: str) -> None:
    error = ForestgenError("the folder already holds files", where=place, expected="another", got="`count`")
    for command in GROUP.commands:
        assert in_options(error, names(command)) == str(error)


@pytest.mark.parametrize(
    ("command", "text", "shown"),
    [
        ("batch", "`workers=2`, or leave it out", "--workers 2, or leave it out"),
        ("render", "`overwrite=True` replaces it", "--overwrite replaces it"),
        ("verify", "the command with `resume=True`", "the command with --resume"),
        ("render", "`set='a=1'`", "--set a=1"),
        ("render", "`set='a={b: 1}'`", "--set 'a={b: 1}'"),
        ("render", "`set='a=`b`'`: a: unknown key", "--set a=`b`: a: unknown key"),
        ("render", "x.csv:4 (named by `set='a=x.csv'`: a)", "x.csv:4 (named by --set a=x.csv: a)"),
        ("render", "stand.yaml:3: seed", "stand.yaml:3: seed"),
        ("render", "`forestgen doctor` shows it", "`forestgen doctor` shows it"),
    ],
)
def test_parameters_in_words_become_options(command: str, text: str, shown: str) -> None:
    error = in_options(ForestgenError(text, where=text, expected=text, got=text, hint=text), names(command))
    assert error == str(ForestgenError(shown, where=shown, expected=shown, got=text, hint=shown))


def test_a_wrong_override_is_shown_as_it_was_written() -> None:
    with pytest.raises(ForestgenError) as caught:
        apply_override({}, SourceMap(), "seed")
    shown = in_options(caught.value, names("render"))
    assert shown.startswith("--set seed: not an override\n")


def test_each_of_several_errors_is_translated() -> None:
    several = RecipeErrors([ForestgenError("wrong", parameter="count"), ForestgenError("wrong", where="count")])
    text = several.text("error: ", lambda one: in_options(one, names("render")))
    assert text == "error: --count: wrong\n\nerror: count: wrong\n\n2 errors"


def test_texts_for_users_of_python_name_no_options() -> None:
    """But for whole commands, such as `forestgen plant NAME --out`."""
    options = {name for one in GROUP.commands.values() for param in one.params for name in param.opts if "--" in name}
    package = Path(forestgen.__file__).parent
    for path in sorted(set(package.rglob("*.py")) - set((package / "cli").rglob("*.py"))):
        source = path.read_text(encoding="utf-8")
        if not any(option in source for option in options):
            continue
        for line, text in texts_in(ast.parse(source)):
            found = options & set(text.replace(",", " ").replace(";", " ").split())
            assert not found or "forestgen " in text, (path, line, found)


def texts_in(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of all that is no comment."""
    nodes = list(ast.walk(tree))
    left_out = {id(one.value) for one in nodes if isinstance(one, ast.Expr)}
    left_out |= {id(piece) for one in nodes if isinstance(one, ast.JoinedStr) for piece in one.values}
    for one in nodes:
        pieces = one.values if isinstance(one, ast.JoinedStr) else [one]
        if id(one) not in left_out:
            yield (
                getattr(one, "lineno", 0),
                "".join(str(piece.value) for piece in pieces if isinstance(piece, ast.Constant)),
            )


def test_a_missing_option_is_named_with_what_it_takes() -> None:
    answer = CliRunner().invoke(app, ["pack", "somewhere", "--out", "elsewhere"])
    assert answer.exit_code == 2
    assert "Missing option '--format'. webdataset, huggingface" in " ".join(answer.output.split())
