"""This process and those that it starts: free memory, signals, standard streams, spawning without a script."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import types
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_CGROUP = Path("/sys/fs/cgroup")  # a container sees its own limits here
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGALRM")


def free_bytes() -> int:
    """Memory that is free on this machine, or in the container if that allows less."""
    import psutil

    machine = int(psutil.virtual_memory().available)
    container = _container_bytes(_CGROUP)
    return machine if container is None else min(machine, container)


def whole_bytes() -> int:
    """Memory of this machine, or of the container if that allows less; used memory counts too."""
    import psutil

    machine, container = int(psutil.virtual_memory().total), _limit_bytes(_CGROUP)
    return machine if container is None else min(machine, container)


def _limit_bytes(folder: Path) -> int | None:
    """The control group's limit, None without one."""
    try:
        return int((folder / "memory.max").read_text())
    except (OSError, ValueError):  # no control group, or "max"
        return None


def _container_bytes(folder: Path) -> int | None:
    """What the control group's limit leaves, None without a limit; cached files count as free."""
    limit = _limit_bytes(folder)
    if limit is None:
        return None
    try:
        used = int((folder / "memory.current").read_text())
        rows = (line.split() for line in (folder / "memory.stat").read_text().splitlines())
        cached = next((int(value) for name, value in rows if name == "inactive_file"), 0)
    except (OSError, ValueError):
        return None
    return max(0, limit - used + cached)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C and other requests to end until the block is done; for short blocks only.

    A compiled library may abort the whole process where Python would raise an exception, as Dr.Jit does during its
    import.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    numbers = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]  # Windows has the first two
    before = {number: signal.signal(number, lambda one, _: came.append(one)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None stands for a handler that Python did not install and cannot restore.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)


@contextmanager
def without_main() -> Iterator[None]:
    """Processes that multiprocessing spawns in this block do not run the caller's ``__main__`` again.

    It may be standard input, a notebook, or a script without a ``__main__`` guard. What is sent to such a process must
    be importable from a module.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


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
