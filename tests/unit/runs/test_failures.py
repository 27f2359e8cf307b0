"""What an image may break on, and whether it is worth another attempt."""

from __future__ import annotations

import errno
import os

import pytest
from forestgen.cli.batch_command import amounts, bytes_of, seconds_of

from forestgen.core.errors import AssetError, OutputError, RecipeError, RenderError, ResourceError
from forestgen.dataset.files import output_error
from forestgen.runs.contract import TRANSIENT
from forestgen.runs.work import explained, failure_kind


def full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/data/x")


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (MemoryError(), "memory"),
        (ResourceError("too little memory"), "memory"),
        (full(), "output"),
        (caused(output_error(full()), full()), "output"),
        (caused(RenderError("mitsuba"), full()), "output"),
        (caused(OutputError("cannot write OpenEXR"), RuntimeError("No space left on device")), "output"),
        (OutputError("an id does not fit into its format"), "recipe"),
        (RecipeError("bad"), "recipe"),
        (AssetError("gone"), "recipe"),
        (RenderError("bad"), "renderer"),
        (ZeroDivisionError("division"), "bug"),
        (FileNotFoundError(errno.ENOENT, "gone"), "bug"),
    ],
)
def test_kinds(error: Exception, kind: str) -> None:
    assert failure_kind(error) == kind


def test_what_may_pass_is_tried_again_and_the_rest_is_not() -> None:
    assert set(TRANSIENT) == {"memory", "output", "worker", "time"}


def test_a_bug_is_told_with_its_place() -> None:
    with pytest.raises(ZeroDivisionError) as divided:
        _ = 1 / 0
    assert "ZeroDivisionError: division by zero (test_failures.py:" in explained(divided.value)
    assert "free some space" in explained(full())
    assert "fewer workers" in explained(MemoryError())


@pytest.mark.parametrize(
    ("text", "size"),
    [("4GB", 4_000_000_000), ("500 MB", 500_000_000), ("1.5GiB", 3 << 29), ("2g", 2_000_000_000), ("100000000", 10**8)],
)
def test_sizes(text: str, size: int) -> None:
    assert bytes_of(text, "--worker-memory") == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "4XB", "0", "4", "four", "1e9"])
def test_what_is_no_size(text: str) -> None:
    import typer

    with pytest.raises(typer.BadParameter):
        bytes_of(text, "--worker-memory")


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("30 min", 1800.0), ("1.5h", 5400.0)])
def test_durations(text: str, seconds: float) -> None:
    assert seconds_of(text, "--timeout") == seconds


@pytest.mark.parametrize("text", ["", "90", "0s", "-1h", "2 days", "min"])
def test_what_is_no_duration(text: str) -> None:
    import typer

    with pytest.raises(typer.BadParameter, match="30min"):
        seconds_of(text, "--timeout")


def test_resources() -> None:
    import typer

    assert amounts(["GPU=1", "memory=0.5"]) == {"GPU": 1.0, "memory": 0.5}
    for bad in ("GPU", "=1", "GPU=-1", "GPU=inf", "GPU=nan", "GPU=0"):
        with pytest.raises(typer.BadParameter):
            amounts([bad])
