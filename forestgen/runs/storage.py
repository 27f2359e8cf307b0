"""Where a data set lies: a folder of this machine, with its lock, or an object store (remote_storage.py).

In a folder, work is staged in ``.forestgen/staging``, on the same file system, and renamed into place: a name shows a
whole file or frame, or nothing. Files reach the disk before they get their names, and file systems keep the order of
names; so no power cut, and no quota that a network share reports late, leaves a record without its files.
"""

from __future__ import annotations

import getpass
import json
import os
import platform
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError, OutputError, output_error, writing
from forestgen.dataset.files import make_folder, write_bytes
from forestgen.dataset.safe_path import RefusedFileError, SafePath, is_inside, unreadable
from forestgen.runs.contract import HIDDEN

LOCK_FILES = _LOCK, _HOLDER = "lock", "holder.json"  # the latter says who holds the lock
STAGING = f"{HIDDEN}/staging"
_SYNCED_AT_ONCE = 16


@dataclass(frozen=True)
class LocalStorage:
    """A folder; see `contract.StorageBackend`."""

    root: Path
    shown: str = ""  # as the user wrote it

    @property
    def name(self) -> str:
        return self.shown or str(self.root)

    def lock(self, say: Callable[[str], None] = lambda _: None) -> LocalLock:
        """A context manager that keeps other runs out of here."""
        return LocalLock(self.root / HIDDEN, self.name, say)

    def staging(self) -> Path:
        folder = self._hidden("job")
        with writing(folder):
            folder.mkdir()
        return folder

    def discard(self, staging: Path) -> None:
        shutil.rmtree(staging, ignore_errors=True)

    def put_folder(self, source: Path, target: str) -> None:
        final = self._path(target)
        with writing(final):
            _sync([path for path in source.rglob("*") if path.is_file()])
            final.parent.mkdir(parents=True, exist_ok=True)
            self.remove(target)
            source.rename(final)

    def put_file(self, source: Path, target: str) -> None:
        final = self._path(target)
        with writing(final):
            _sync([source])
            final.parent.mkdir(parents=True, exist_ok=True)
            source.replace(final)

    def write(self, target: str, content: bytes) -> None:
        staged = self._hidden("file")
        try:
            with writing(self._path(target)):
                staged.write_bytes(content)
                self.put_file(staged, target)
        finally:
            staged.unlink(missing_ok=True)

    def read(self, path: str) -> bytes | None:
        file = SafePath(self.root, path)
        with _reading(file), suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return file.read()
        return None

    def exists(self, path: str) -> bool:
        return self._path(path).exists()

    def size_bytes(self, path: str) -> int | None:
        file = SafePath(self.root, path)
        return file.size_bytes() if file.is_file() else None

    def names(self, folder: str) -> list[str]:
        found = SafePath(self.root, folder)
        with _reading(found):
            return found.names()

    def found(self, folder: str) -> Iterator[tuple[str, int, int]]:
        yield from files_below(self.root, folder)

    def remove(self, path: str) -> None:
        """See `contract.StorageBackend`; a folder loses its name at once, then its content."""
        found = self._path(path)
        if not os.path.lexists(found):
            return
        with writing(found):
            if not found.is_dir() or found.is_symlink():
                found.unlink()
                return
            aside = self._hidden("removed")
            found.rename(aside)
            shutil.rmtree(aside, ignore_errors=True)  # what stays is cleared with the staging folder

    def clear_staging(self) -> None:
        shutil.rmtree(self._path(STAGING), ignore_errors=True)

    def _path(self, relative: str) -> Path:
        """A path below the root, in folders that are no links: data sets and recipes may be untrusted."""
        above = SafePath(self.root, relative.rpartition("/")[0])
        try:
            if relative and not is_inside(relative):
                raise RefusedFileError("the path leaves the data set's folder")
            with suppress(FileNotFoundError, NotADirectoryError):
                above.located()
        except RefusedFileError as error:
            raise DatasetError(str(error), where=self.name, got=repr(relative)) from error
        return self.root / relative

    def _hidden(self, kind: str) -> Path:
        """A name for work in progress that nothing has."""
        folder = self._path(f"{STAGING}/x").parent
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{kind}-{os.getpid()}-{secrets.token_hex(6)}"


def files_below(root: Path, folder: str = "") -> Iterator[tuple[str, int, int]]:
    """Path relative to `root`, size in bytes and inode of each file below a folder of it."""
    waiting = [folder] if not folder or SafePath(root, folder).is_folder() else []
    while waiting:
        inside = waiting.pop()
        with suppress(FileNotFoundError, NotADirectoryError), os.scandir(root / inside) as entries:
            for entry in entries:  # a link is no file of the data set, whatever it leads to: its size is none
                path = f"{inside}/{entry.name}" if inside else entry.name
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(path)
                else:
                    status = entry.stat(follow_symlinks=False)
                    yield path, status.st_size if stat.S_ISREG(status.st_mode) else -1, status.st_ino


@contextmanager
def _reading(path: SafePath) -> Iterator[None]:
    """What is there and cannot be read, as an error that names `path`."""
    try:
        yield
    except RefusedFileError as error:
        raise unreadable(path, error, "a data set's files lie in its own folder: copy it without links") from error
    except OSError as error:
        raise unreadable_storage(error, path) from error


def unreadable_storage(error: OSError, where: object) -> OutputError:
    """What is there and cannot be read."""
    hint = "check the folder's permissions and disk"
    return OutputError(f"cannot read: {error.strerror or error}", where=str(where), hint=hint)


def _sync(files: Sequence[Path]) -> None:
    """Wait until files are on the disk: many at a time, or each would wait for a turn of its own."""

    def sync(file: Path) -> None:
        with file.open("rb+") as stream:
            os.fsync(stream.fileno())

    with ThreadPoolExecutor(min(_SYNCED_AT_ONCE, max(1, len(files)))) as threads:
        list(threads.map(sync, files))


class LocalLock:
    """A lock of the operating system's, which a process that dies gives back; see `contract.Lock`.

    It is a file in the hidden folder of the data set. Folders that it makes are removed at its end if they are empty.
    """

    def __init__(self, folder: Path, where: str, say: Callable[[str], None]) -> None:
        self._folder, self._where, self._say = folder, where, say
        self._lock: Any = None
        self._made: list[Path] = []  # the innermost first

    def __enter__(self) -> LocalLock:
        from filelock import FileLock, Timeout

        self._made = [folder for folder in (self._folder, *self._folder.parents) if not os.path.lexists(folder)]
        make_folder(self._folder)
        for name in LOCK_FILES:  # the data set may be untrusted: its links and pipes are not written through
            if os.path.lexists(self._folder / name) and not SafePath(self._folder, name).is_file():
                raise OutputError("this is no plain file", where=str(self._folder / name), hint="remove it")
        self._lock = FileLock(self._folder / _LOCK, timeout=0)
        try:
            self._lock.acquire()
        except Timeout:
            raise refusal(self._where, self._holder()) from None
        except NotImplementedError:
            self._lock = None
            self._say(f"{self._where}: this file system keeps no locks: see that no other run writes there")
        except OSError as error:
            raise output_error(error, self._folder) from error
        write_bytes(self._folder / _HOLDER, json.dumps(this_process()).encode())
        return self

    def __exit__(self, *_: object) -> None:
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
        """Nothing to do: a lock of the operating system cannot be lost."""

    def _holder(self) -> str:
        try:
            content = SafePath(self._folder, _HOLDER).read_json()
            return f"{content['owner']}, since {content['since']}"
        except (OSError, ValueError, KeyError, TypeError):  # it is just being written
            return "a run that has just begun"


def refusal(where: str, holder: str) -> OutputError:
    """The error of the second run."""
    hint = "wait for it, stop it, or choose another place"
    return OutputError("another run writes there", where=where, got=holder, hint=hint)


def this_process() -> dict[str, str]:
    """Who holds a lock, for people: this process, and since when, UTC."""
    import psutil

    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user may have no name
        user = "?"
    since = datetime.fromtimestamp(psutil.Process().create_time(), UTC).isoformat(timespec="seconds")
    return {"owner": f"{user} on {platform.node()}, process {os.getpid()}", "since": since}
