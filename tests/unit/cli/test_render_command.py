"""The arguments of `render` and `batch`, and what an interrupted run says of itself."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from forestgen.api.display import SilentDisplay
from forestgen.cli import app
from forestgen.cli.render import _amounts, kept
from forestgen.recipe.assets import recipes_dir
from forestgen.runs.summary import ProgressTracker


def test_resources() -> None:
    assert _amounts(["GPU=1", "memory=0.5"]) == {"GPU": 1.0, "memory": 0.5}
    for bad in ("GPU", "=1", "GPU=-1", "GPU=inf", "GPU=nan", "GPU=0"):
        with pytest.raises(typer.BadParameter):
            _amounts([bad])


@pytest.mark.parametrize(
    "options",
    [("--timeout", "abc"), ("--discard",), ("--resume", "--overwrite"), ("--scheduler", "tcp://10.0.0.1:8786")],
)
def test_a_dry_run_refuses_the_options_that_the_run_refuses(options: tuple[str, ...], tmp_path: Path) -> None:
    for dry in ((), ("--dry-run",)):
        arguments = ("batch", str(recipes_dir() / "quickstart.yaml"), "--out", str(tmp_path / "set"), *dry, *options)
        answer = CliRunner().invoke(app, arguments)
        assert answer.exit_code == 2, answer.output
        assert options[-1 if options[0] == "--resume" else 0] in answer.stderr
    assert not list(tmp_path.iterdir())


def test_an_interrupted_run_says_what_stays() -> None:
    display = SilentDisplay()
    assert kept(display) == "nothing was written"
    display.show(ProgressTracker(5))
    assert kept(display) == "none of 5 images was finished; the same command with --resume goes on"
    assert kept(display, if_none="nothing was written") == "nothing was written"  # render removes what it has begun
    display.show(ProgressTracker(5, already=1, made=2))
    assert kept(display) == "3 of 5 images are done and stay; the same command with --resume goes on"
    assert "--resume in place of --overwrite" in kept(display, overwrite=True)
    display.show(ProgressTracker(5))
    assert kept(display, overwrite=True) == "nothing was written; a previous data set is as it was"
