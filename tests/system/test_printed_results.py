"""Results print what the command line prints, in the same words, and are short in a list."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from batch_pieces import copied
from command_line import run

import forestgen as fg

CELLS = Path(__file__).parents[1] / "unit" / "community" / "data" / "cells.csv"
_TIMES = re.compile(r"\b\d+(\.\d+)? s\b|simulated in .*|measured in .*|time: .*|disk +.*")


def timeless(text: str) -> str:
    return _TIMES.sub("", text).strip()


def check(result: object, printed: str) -> None:
    """`printed` begins with the result, times aside; its `repr` is one short line."""
    text = str(result)
    assert timeless(text)
    assert timeless(printed).startswith(timeless(text))
    assert len(text) < 10_000
    assert repr(result).startswith(f"<{type(result).__name__}")
    assert len(repr(result)) < 200
    assert "\n" not in repr(result)


@pytest.fixture
def recipe(whole: Path) -> Path:
    return whole.parent / "fireweed.yaml"


def test_a_simulation(recipe: Path, tmp_path: Path) -> None:
    answer = run("simulate", recipe, "--out", tmp_path / "stand")
    summary = fg.load(recipe).simulate(progress=False).summary
    check(summary, answer.out)
    assert "stems per ha" in str(summary)
    assert f"files: {tmp_path / 'stand'}/" in answer.out


def test_a_run(recipe: Path, whole: Path, tmp_path: Path) -> None:
    target = copied(whole, tmp_path / "set")
    answer = run("batch", recipe, "--count", "4", "--out", target, "--resume")
    summary = fg.load(recipe).render(target, count=4, resume=True, progress=False).summary
    check(summary, answer.out)
    assert "4 of 4 images done" in str(summary)


@pytest.mark.slow
def test_an_estimate(recipe: Path, tmp_path: Path) -> None:
    answer = run("batch", recipe, "--count", "3", "--out", tmp_path / "set", "--workers", "1", "--dry-run")
    expected = fg.load(recipe).estimate(tmp_path / "set", 3, workers=1, progress=False)
    assert str(expected).splitlines()[0] == answer.out.splitlines()[0]
    assert str(expected).splitlines()[-1] == answer.out.splitlines()[-1] == "nothing was made"
    assert repr(expected).startswith("<DryRun: 3 images, about ")


def test_a_verification(whole: Path, tmp_path: Path) -> None:
    check(fg.verify(whole, workers=1, progress=False), run("verify", whole, "--workers", "1").out)
    damaged = copied(whole, tmp_path / "set")
    (damaged / "README.md").unlink()
    report = fg.verify(damaged, workers=1, progress=False)
    check(report, run("verify", damaged, "--workers", "1").out)
    assert "finding" in repr(report)


@pytest.mark.slow
def test_light(recipe: Path) -> None:
    answer = run("light", recipe, "--at", "3", "3", "1", "--samples", "512")
    readings = fg.load(recipe).light([(3, 3, 1)], samples=512, progress=False)
    check(readings, answer.out)
    assert readings[0].illuminance_lux.value > 0
    assert len(readings) == 1


def test_points() -> None:
    answer = run("stats", CELLS, "--radii", "0.1,0.2")
    measured = fg.stats(CELLS, radii="0.1,0.2")
    check(measured, answer.out.removeprefix(f"{CELLS}: "))
    assert "Clark-Evans, Donnelly" in str(measured)
