"""What the command line shows: results, errors in plain words, exit codes for scripts.

0    done
1    a forestgen error of no other kind
2    the recipe or an argument is wrong, or a file is missing
3    this machine lacks memory or a library
4    a result cannot be written
5    the renderer failed
6    a data set's files are damaged or contradict each other
70   a bug in forestgen
129  the terminal was closed; 130: interrupted (Ctrl-C); 143: terminated. Nothing is left half-written.
141  the reader of the output has left, as `head` does
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NoReturn, cast

import typer

from forestgen.cli.option_names import in_options
from forestgen.core.errors import ForestgenError, OutputError, ResourceError, plain
from forestgen.core.streams import output_failure, redirect_failed_streams

if TYPE_CHECKING:
    from rich.console import Console

INTERNAL_ERROR = 70
# The base of all errors of the command line's syntax, which typer does not export.
_UsageError: type[Exception] = cast("type[Exception]", typer.BadParameter.__base__)


def output() -> Console:
    """Where results are told: standard output, without colours of its own choosing, without wrapping."""
    from rich.console import Console

    class Output(Console):
        def on_broken_pipe(self) -> NoReturn:
            raise  # rich calls this while it handles the BrokenPipeError, which is ours to answer

    return Output(highlight=False, soft_wrap=True)


class Printer:
    """Prints results on standard output, line by line; nothing where quiet was asked for."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet

    def __call__(self, text: str = "") -> None:
        if not self._quiet:
            output().print(plain(text), markup=False)  # names of strangers' files may hold brackets, or control codes

    def json(self, content: object) -> None:
        """Plain values; NaN, which JSON lacks, as null."""
        sys.stdout.write(json.dumps(_finite(content), indent=2, allow_nan=False) + "\n")


def _finite(content: object) -> object:
    if isinstance(content, Mapping):
        return {str(key): _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


class _StoppedError(BaseException):
    """A signal that asks the process to end, raised so that every `finally` runs."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.kept = "nothing was written"

    @property
    def message(self) -> str:
        return f"{_STOPPED[signal.Signals(self.number).name]}: {self.kept}"


_STOPPED = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "the terminal was closed"}
_AGAIN_S = 0.25


@contextmanager
def _stopping_cleanly() -> Iterator[None]:
    """Raise `_StoppedError` on Ctrl-C and on requests to end, again and again until it has taken hold.

    Compiled code may swallow an exception that a signal's handler raises (Numba's compiler and Dr.Jit do), and the work
    would go on. While the exception is on its way, which cleans up, nothing disturbs it: neither the timer nor a second
    Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    stopped: list[int] = []

    def stop(number: int, _: object) -> None:
        if _on_its_way(sys.exception()):
            return
        stopped[:] = stopped or [number]
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
        raise _StoppedError(stopped[0])

    def unraisable(about: sys.UnraisableHookArgs) -> None:
        """Where Python can only report an exception, in a callback, ours need not be: the timer raises it again."""
        if not isinstance(about.exc_value, _StoppedError):
            hook(about)

    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    before = {}
    for name in (*_STOPPED, "SIGALRM"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP and no SIGALRM
        # A signal that the caller has switched off, as nohup does, stays off.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, stop)
    try:
        yield
    except Exception as error:
        if stopped:  # an import that was cut short fails in its own words
            raise _StoppedError(stopped[0]) from error
        raise
    finally:
        sys.unraisablehook = hook
        if stopped and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _on_its_way(error: BaseException | None) -> bool:
    """Whether a `_StoppedError` is being handled."""
    while error is not None and not isinstance(error, _StoppedError):
        error = error.__context__
    return error is not None


def _say(message: str) -> None:
    with suppress(OSError, ValueError):  # a closed terminal takes no message, nor does a full disk
        sys.stderr.write(message.rstrip() + "\n")
        sys.stderr.flush()


def fail(message: str, code: int) -> NoReturn:
    """Print an error and leave."""
    _say(message)
    raise SystemExit(code)


def _fail_of_output(failure: OSError) -> NoReturn:
    """Leave because standard output takes no more, as on a full disk."""
    got = failure.strerror or str(failure)
    error = OutputError("the output cannot be written", where="standard output", got=got)
    fail(f"error: {error}", error.exit_code)


@contextmanager
def errors_for_people(names: Callable[[], Mapping[str, str]] = dict) -> Iterator[None]:
    """Turn exceptions into messages and exit codes. FORESTGEN_DEBUG=1 shows tracebacks instead.

    Parameters
    ----------
    names : options by the parameters that errors name, see `option_names.names_of`.
    """
    if os.environ.get("FORESTGEN_DEBUG"):
        yield
        return
    try:
        with _stopping_cleanly():
            yield
            sys.stdout.flush()  # while a closed pipe can still be told from a bug
    except (typer.Exit, typer.Abort, _UsageError):
        raise  # typer's own way out: --version, a misspelt option
    except ForestgenError as error:
        fail(error.text("error: ", lambda one: in_options(one, names())), error.exit_code)
    except MemoryError:
        hint = "make images or the site smaller, or take fewer species or exemplars"
        fail(f"error: {ResourceError('memory ran out', hint=hint)}", ResourceError.exit_code)
    except _StoppedError as stopped:
        fail(stopped.message, 128 + stopped.number)
    except KeyboardInterrupt:
        fail(_StoppedError(signal.SIGINT).message, 130)
    except BrokenPipeError:
        # Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except Exception as error:  # noqa: BLE001 - the one place where a bug is caught, named as such, and reported
        if (failure := output_failure()) is not None:
            _fail_of_output(failure)
        fail(
            f"error: a bug in forestgen: {type(error).__name__}: {error}\n"
            "  try       the same command with FORESTGEN_DEBUG=1 shows the traceback for a report",
            INTERNAL_ERROR,
        )
    finally:
        redirect_failed_streams()


@contextmanager
def stops_keep(what: Callable[[], str]) -> Iterator[None]:
    """A block that leaves something behind when it is interrupted; `what` tells of it, in the message's words."""
    try:
        yield
    except _StoppedError as stopped:
        stopped.kept = what()
        raise
