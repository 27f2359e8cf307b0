"""`derive`: words, their number, other values, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import forestgen as fg
from forestgen.cli import app
from support.error_messages import raises_error

PROGRAM = """\
#define ANGLE 60
lsystem: curve
derivation length: 2
axiom: F(ANGLE) A(0.5)
F(a) --> F(a) F(2*a)
endlsystem
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "curve.lsys"
    path.write_text(PROGRAM)
    return path


def test_a_shipped_program_is_found_by_its_name() -> None:
    words = fg.derive("koch", 2)
    assert words.steps == 2
    assert words.counts == {"F": 48, "+": 34, "-": 30}
    assert words.modules == 112 == sum(words.counts.values())
    assert Path(words.file).name == "koch.lsys"
    assert fg.derive("koch").steps == 4  # the file's derivation length
    assert len(repr(words)) < 300


def test_words_are_lists_of_modules(program: Path) -> None:
    words = fg.derive(program)
    assert list(words) == [[["F", 60], ["F", 120], ["F", 120], ["F", 240], ["A", 0.5]]]
    assert list(words.text) == ["F(60)F(120)F(120)F(240)A(0.5)"]
    assert list(fg.derive(program, 0)) == [[["F", 60], ["A", 0.5]]]


@pytest.mark.parametrize("values", [{"ANGLE": 2.5}, ["ANGLE=2.5"], ["ANGLE= 2.5 "]])
def test_defined_values_are_replaced(program: Path, values: object) -> None:
    assert list(fg.derive(program, 1, set=values)) == [[["F", 2.5], ["F", 5], ["A", 0.5]]]  # type: ignore[arg-type]


def test_the_command_prints_the_same(program: Path) -> None:
    words = fg.derive(program, 3, seed=2)
    said = CliRunner().invoke(app, ["lsystem", str(program), "--steps", "3", "--seed", "2", "--format", "json"])
    assert json.loads(said.stdout) == words.as_dict()
    count = CliRunner().invoke(app, ["lsystem", str(program), "--steps", "3", "--format", "count"])
    assert int(count.stdout) == words.modules


def test_what_cannot_be_derived(program: Path) -> None:
    for arguments, kind, part in (
        ({"steps": -1}, fg.RecipeError, "0 to 1,000,000"),
        ({"set": {"NIX": 1}}, fg.LsystemError, "NIX"),
        ({"set": ["ANGLE"]}, fg.LsystemError, "NAME=NUMBER"),
        ({"set": ["ANGLE=x"]}, fg.LsystemError, "NAME=NUMBER"),
        ({"steps": 9, "max_modules": 20}, fg.ForestgenError, "at most 20 modules"),
    ):
        with pytest.raises(kind, match=part):
            fg.derive(program, **arguments)  # type: ignore[arg-type]
    with raises_error(fg.AssetError):
        fg.derive("kch", 2)
    program.write_text(PROGRAM.replace("derivation length: 2\n", ""))
    with raises_error(fg.RecipeError, place="curve.lsys"):
        fg.derive(program)
