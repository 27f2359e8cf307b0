"""Errors name parameters of Python; the command line shows its options."""

from __future__ import annotations

from typing import Any

import pytest
import typer

from forestgen.cli import app
from forestgen.cli.option_names import in_options, names_of


def names(command: str) -> dict[str, str]:
    group: Any = typer.main.get_command(app)
    return names_of(group.commands[command])


@pytest.mark.parametrize(
    ("command", "text", "shown"),
    [
        ("render", "error: count: no such number\n  got       0", "error: --count: no such number\n  got       0"),
        ("batch", "error: workers=8: too many", "error: --workers 8: too many"),
        ("batch", "  try       `workers=2`, or leave it out", "  try       --workers 2, or leave it out"),
        ("render", "  try       `overwrite=True` replaces it", "  try       --overwrite replaces it"),
        ("verify", "  try       the command with `resume=True`", "  try       the command with --resume"),
        ("simulate", "error: map_steps: no such step", "error: --map-step: no such step"),
        ("light", "error: normals: this is no direction", "error: --normal: this is no direction"),
        ("plant", "error: species: none has this name", "error: SPECIES: none has this name"),
        ("fit-kernel", "error: species: no such species", "error: --species: no such species"),
        ("render", "error: source: this is no path", "error: RECIPE: this is no path"),
        ("render", "error: set a.b=4: a.b: unknown key", "error: --set a.b=4: a.b: unknown key"),
        ("render", "error: x.csv:4 (named by set a=x.csv): no", "error: x.csv:4 (named by --set a=x.csv): no"),
        ("render", "  try       `set='a=1'`", "  try       --set a=1"),
        ("render", "  try       `set='a={b: 1}'`", "  try       --set 'a={b: 1}'"),
        ("render", "error: stand.yaml:3: seed: bad value", "error: stand.yaml:3: seed: bad value"),
        ("render", "  got       `count`", "  got       `count`"),
        ("render", "  try       `forestgen doctor` shows it", "  try       `forestgen doctor` shows it"),
    ],
)
def test_parameters_become_options(command: str, text: str, shown: str) -> None:
    assert in_options(text, names(command)) == shown
