"""What the command line shows: bars while it works, errors in plain words, exit codes for scripts.

    0    done
    1    a forestgen error of no other kind
    2    the recipe or an argument is wrong, or a file is missing
    3    this machine lacks memory or a library
    4    a result cannot be written
    5    the renderer failed
    70   a bug in forestgen
    130  interrupted (Ctrl-C); 143: terminated. Nothing is left half-written.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from forestgen.core.errors import ForestgenError, ResourceError

INTERNAL_ERROR = 70


class Bars:
    """Progress bars with time left, on standard error; silent where that is no terminal."""

    def __init__(self) -> None:
        self._progress: Any = None

    @contextmanager
    def running(self) -> Iterator[Bars]:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description:<18}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        console = Console(stderr=True)
        with Progress(*columns, console=console, disable=not console.is_terminal, refresh_per_second=5) as progress:
            self._progress = progress
            yield self

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[[int], None]]:
        task = self._progress.add_task(title, total=total)
        try:
            yield lambda steps: self._progress.advance(task, steps)
        finally:
            self._progress.stop_task(task)


class _TerminatedError(BaseException):
    """SIGTERM, raised so that every `finally` runs."""


def _terminate(*_: object) -> None:
    raise _TerminatedError


def fail(message: str, code: int) -> NoReturn:
    """Print an error and leave."""
    sys.stderr.write(message.rstrip() + "\n")
    raise SystemExit(code)


@contextmanager
def errors_for_people() -> Iterator[None]:
    """Turn exceptions into messages and exit codes. FORESTGEN_DEBUG=1 shows tracebacks instead."""
    if os.environ.get("FORESTGEN_DEBUG"):
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except ForestgenError as error:
        fail(f"error: {error}", error.exit_code)
    except MemoryError:
        fail(
            f"error: {ResourceError('memory ran out', hint='smaller images, a smaller site or fewer plants')}",
            ResourceError.exit_code,
        )
    except KeyboardInterrupt:
        fail("interrupted: nothing was written", 130)
    except _TerminatedError:
        fail("terminated: nothing was written", 143)
    except BrokenPipeError:
        # The reader of our output has left, as `head` does. Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except Exception as error:  # noqa: BLE001 - the one place where a bug is caught, named as such, and reported
        fail(
            f"error: a bug in forestgen: {type(error).__name__}: {error}\n"
            "  try       the same command with FORESTGEN_DEBUG=1 shows the traceback for a report",
            INTERNAL_ERROR,
        )


def seconds(value: float) -> str:
    """A duration for people."""
    return f"{value:.1f} s" if value < 60 else f"{int(value) // 60} min {int(value) % 60:02d} s"
