"""One run at a time in a folder: a lock of the operating system's, which a process that dies gives back."""

from __future__ import annotations

import getpass
import json
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from forestgen.core.errors import OutputError
from forestgen.dataset.files import make_folder, output_error, write_bytes
from forestgen.dataset.safe_path import SafePath

LOCK_FILES = _LOCK, _HOLDER = "lock", "holder.json"  # the latter says who holds the lock


class LocalLock:
    """See `contract.Lock`. Folders that it has made, and in which nothing else is at its end, go with it.

    Parameters
    ----------
    folder : the hidden folder of the data set, made if it is missing.
    where : the data set's place, for messages.
    say : told where the file system keeps no locks.
    """

    def __init__(self, folder: Path, where: str, say: Callable[[str], None]) -> None:
        self._folder, self._where, self._say = folder, where, say
        self._lock: Any = None
        self._made: list[Path] = []  # the innermost first

    def __enter__(self) -> LocalLock:
        from filelock import FileLock, Timeout

        self._made = [folder for folder in (self._folder, *self._folder.parents) if not os.path.lexists(folder)]
        make_folder(self._folder)
        for name in (_LOCK, _HOLDER):
            _refuse_link(self._folder / name)
        self._lock = FileLock(self._folder / _LOCK, timeout=0)
        try:
            self._lock.acquire()
        except Timeout:
            raise refusal(self._where, _holder(self._folder)) from None
        except NotImplementedError:
            self._lock = None
            self._say(f"{self._where}: this file system keeps no locks: see that no other run writes there")
        except OSError as error:
            raise output_error(error, self._folder) from error
        write_bytes(self._folder / _HOLDER, json.dumps({"owner": own_name(), "since": started()}).encode())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with suppress(OSError):
            (self._folder / _HOLDER).unlink(missing_ok=True)
            if self._made and [path.name for path in self._folder.iterdir()] == [_LOCK]:
                (self._folder / _LOCK).unlink()
        if self._lock is not None:
            self._lock.release()
        for folder in self._made:
            with suppress(OSError):  # something else lies there
                folder.rmdir()

    def check(self) -> None:
        """Nobody takes a lock of the operating system's away."""


def _refuse_link(path: Path) -> None:
    """What would be written through a link, or wait in a pipe, is refused: the data set may be a stranger's."""
    if os.path.lexists(path) and not SafePath(path.parent, path.name).is_file():
        raise OutputError("this is no plain file", where=str(path), hint="remove it")


def refusal(where: str, holder: str) -> OutputError:
    """What the second run is told."""
    return OutputError(
        "another run writes there",
        where=where,
        got=holder,
        hint="wait for it, stop it, or choose another place",
    )


def own_name() -> str:
    """Who this process is, for people."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user may have no name
        user = "?"
    return f"{user} on {platform.node()}, process {os.getpid()}"


def started() -> str:
    """When this process was started, UTC."""
    import psutil

    return datetime.fromtimestamp(psutil.Process().create_time(), UTC).isoformat(timespec="seconds")


def _holder(folder: Path) -> str:
    try:
        content = SafePath(folder, _HOLDER).read_json()
        return f"{content['owner']}, since {content['since']}"
    except (OSError, ValueError, KeyError, TypeError):  # it is just being written
        return "a run that has just begun"
