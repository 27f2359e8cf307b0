"""What an image may break on, and whether it is worth another attempt."""

from __future__ import annotations

import errno
import os

import pytest

from forestgen.core.errors import AssetError, OutputError, RecipeError, RenderError, ResourceError, output_error
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
