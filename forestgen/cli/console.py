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

Errors name parameters of Python's calls, and the command line shows its options instead: an error has its `parameter`;
in its words a parameter stands between backticks, `` `overwrite=True` ``.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, cast

import typer

from forestgen.core.errors import ForestgenError, OutputError, ResourceError, plain
from forestgen.core.processes import output_failure, redirect_failed_streams
from forestgen.core.registry import explained_bug

if TYPE_CHECKING:
    from rich.console import Console

NOTHING_WRITTEN = "nothing was written"
_QUOTED = re.compile(r"`([a-z][a-z0-9_]*(?:='.*?'|=[^'`][^`]*)?)`", re.DOTALL)
#: Of other commands than the one that fails, such as that which made a data set.
_ELSEWHERE = {
    "resume": "--resume",
    "workers": "--workers",
    "split": "--split",
    "set": "--set",
    "allow_folders": "forestgen --allow-folder",  # before the command's name
}
_SOURCE = {"source": "RECIPE", "sources": "DIR..."}  # arguments by the names that they have in Python
# The base of all errors of the command line's syntax, which typer does not export.
_UsageError: type[Exception] = cast("type[Exception]", typer.BadParameter.__base__)


def output() -> Console:
    """Where results are printed: standard output, without colours of its own choosing, without wrapping."""
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
            output().print(plain(text), markup=False)  # names of files may hold brackets or control codes

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

    def __init__(self, number: int, kept: str = NOTHING_WRITTEN) -> None:
        self.number, self.kept = number, kept


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
        if stopped:  # an import that was cut short, or a loop of Dr.Jit's, fails in its own words
            raise _StoppedError(stopped[0], _kept(error)) from error
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


def fail(message: str, code: int) -> NoReturn:
    """Print an error and leave."""
    with suppress(OSError, ValueError):  # a closed terminal takes no message, nor does a full disk
        sys.stderr.write(message.rstrip() + "\n")
        sys.stderr.flush()
    raise SystemExit(code)


def _has_working_folder() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return False
    return True


@contextmanager
def errors_for_people(names: Callable[[], Mapping[str, str]] = dict) -> Iterator[None]:
    """Turn exceptions into messages and exit codes. FORESTGEN_DEBUG=1 shows tracebacks instead.

    `names`: options by the parameters that errors name, see `names_of`.
    """
    if os.environ.get("FORESTGEN_DEBUG"):
        yield
        return
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that lacks a character shows a question mark
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
    except (_StoppedError, KeyboardInterrupt) as error:
        number = error.number if isinstance(error, _StoppedError) else signal.SIGINT
        fail(f"{_STOPPED[signal.Signals(number).name]}: {_kept(error)}", 128 + number)
    except BrokenPipeError:
        # Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except Exception as error:  # noqa: BLE001 - the one place where a bug is caught, named as such, and reported
        if isinstance(error, FileNotFoundError) and not _has_working_folder():
            gone = OutputError("the working folder does not exist any more", hint="change to a folder that does")
            fail(f"error: {gone}", OutputError.exit_code)
        if (failure := output_failure()) is not None:  # such as a full disk
            got = failure.strerror or str(failure)
            fail(
                f"error: {OutputError('the output cannot be written', where='standard output', got=got)}",
                OutputError.exit_code,
            )
        fail(
            f"error: {explained_bug(error)}\n"
            "  try       the same command with FORESTGEN_DEBUG=1 shows the traceback for a report",
            70,
        )
    finally:
        redirect_failed_streams()


@contextmanager
def stops_keep(what: Callable[[], str]) -> Iterator[None]:
    """A block that leaves something behind when it is interrupted; `what` is the text about it."""
    try:
        yield
    except BaseException as error:  # also an error that compiled code has made of a stop
        error.kept = what()  # type: ignore[attr-defined]
        raise


def _kept(error: BaseException) -> str:
    return str(getattr(error, "kept", NOTHING_WRITTEN))


def names_of(command: Any) -> dict[str, str]:
    """Parameter in Python -> option or argument of a command; several values are one name, `splits` and --split."""
    found = {}
    for one in command.params:
        if isinstance(one, typer.core.TyperArgument):
            found[one.name] = one.metavar or str(one.name).upper()
            continue
        option = next((name for name in one.opts if name.startswith("--")), one.opts[0])
        name = option.removeprefix("--").replace("-", "_")
        found |= {one.name: option, name: option, f"{name}s": option}
    return found


def in_options(error: ForestgenError, names: Mapping[str, str]) -> str:
    """The text of one error with options in place of parameters; what it got is a user's and stays.

    `names`: of the command, see `names_of`.
    """
    known = {**_ELSEWHERE, **_SOURCE, **names}

    def option(parameter: str) -> str | None:
        """``workers=8`` as ``--workers 8``; None if there is no such option."""
        name, _, value = parameter.partition("=")
        if name not in known or value in ("", "True"):
            return known.get(name)
        value = value[1:-1] if value.startswith("'") else value
        return f"{known[name]} '{value}'" if " " in value else f"{known[name]} {value}"

    def words(text: str | None) -> str | None:
        return text and _QUOTED.sub(lambda found: option(found[1]) or found[0], text)

    where = words(error.where)
    if error.parameter is not None:
        where = option(error.parameter) or error.parameter
    problem = words(error.problem) or ""
    expected, hint = words(error.expected), words(error.hint)
    return str(ForestgenError(problem, where=where, expected=expected, got=error.got, hint=hint))
