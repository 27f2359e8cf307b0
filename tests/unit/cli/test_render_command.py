"""The arguments of `render` and `batch`, and what an interrupted run says of itself."""

from __future__ import annotations

import pytest
import typer

from forestgen.api.display import SilentDisplay
from forestgen.cli.render import _amounts, kept
from forestgen.runs.meter import Meter


def test_resources() -> None:
    assert _amounts(["GPU=1", "memory=0.5"]) == {"GPU": 1.0, "memory": 0.5}
    for bad in ("GPU", "=1", "GPU=-1", "GPU=inf", "GPU=nan", "GPU=0"):
        with pytest.raises(typer.BadParameter):
            _amounts([bad])


def test_an_interrupted_run_says_what_stays() -> None:
    display = SilentDisplay()
    assert kept(display) == "nothing was written"
    display.show(Meter(5))
    assert kept(display) == "none of 5 images was finished; the same command with --resume goes on"
    assert kept(display, if_none="nothing was written") == "nothing was written"  # render removes what it has begun
    display.show(Meter(5, already=1, made=2))
    assert kept(display) == "3 of 5 images are done and stay; the same command with --resume goes on"
    assert "--resume in place of --overwrite" in kept(display, overwrite=True)
