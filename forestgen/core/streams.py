"""Standard streams that are closed, or lead to a full disk."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any


class _Output(io.FileIO):
    """Standard output that keeps the error with which it failed."""

    failure: OSError | None = None

    def write(self, content: Any, /) -> int:
        try:
            return super().write(content)
        except BrokenPipeError:
            raise
        except OSError as error:
            self.failure = error
            raise


def open_streams() -> None:
    """Let closed standard streams lead nowhere, and watch standard output; before any file is opened.

    A file that is opened must not take the number of a closed stream, which compiled code may write on.
    """
    if sys.stdin is None or sys.stdout is None or sys.stderr is None:
        while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
            pass
        os.close(number)
        sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    out: Any = sys.stdout
    buffer = getattr(out, "buffer", None)
    if type(getattr(buffer, "raw", buffer)) is not io.FileIO:
        return  # such as a console of Windows
    raw = _Output(out.fileno(), "w", closefd=False)
    watched: Any = raw if out.write_through else io.BufferedWriter(raw)  # python -u writes through
    sys.stdout = io.TextIOWrapper(
        watched,
        encoding=out.encoding,
        errors=out.errors,
        line_buffering=out.line_buffering,
        write_through=out.write_through,
    )


def output_failure() -> OSError | None:
    """Why standard output takes no more; None: it does."""
    buffer = getattr(sys.stdout, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    return raw.failure if isinstance(raw, _Output) else None


def redirect_failed_streams() -> None:
    """Let standard streams that take no more lead nowhere: Python would complain when it flushes them at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        except ValueError:  # it was closed
            pass
