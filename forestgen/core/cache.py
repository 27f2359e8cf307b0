"""Results that can be made again: kept in memory, kept on disk, and the hash of the code that made them.

A disk cache's entry is named by the hash of all that it depends on, so an entry never goes stale. It begins with the
hash of its name and the checksum of its content: an entry that was cut short, changed or misplaced counts as missing.
A failure (a folder without write permission, a full disk, another program's file) only costs making the result again.

Any number of processes may read, write and trim one folder. An entry is written under a temporary name and renamed
when it is complete, so a reader finds the old entry, the new one, or none; on a network file system too, as far as it
renames files atomically.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shutil
import stat
import struct
import sys
import tempfile
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from forestgen.core import __version__
from forestgen.core.registry import Registration, registrations

T = TypeVar("T")

SOURCES = (".py", ".lark")
TABLES = (".csv", ".npz", ".yaml")
PACKAGE = Path(__file__).parents[1]
ENVIRONMENT = "FORESTGEN_CACHE"  # a folder of one's own; empty: no cache
_SUFFIX, _PARTIAL = ".entry", ".partial"
_ABANDONED_S = 3600.0  # a partial entry this old belongs to a process that died
_SHARE_KEPT = 0.9  # of the most bytes, when the oldest entries go
_LEAST_FREE_BYTES = 1_000_000_000  # of the disk
_MAGIC = b"fgentry1"
_HEAD = struct.Struct("<8s32sQI12x")  # magic, hash of the key, bytes of content, their CRC-32; 64 bytes, for alignment


class BoundedCache(Generic[T]):
    """The values asked for last, up to `most_bytes` in all; a value that is larger than that is never kept."""

    def __init__(self, most_bytes: int, bytes_of: Callable[[T], int]) -> None:
        self.most_bytes = most_bytes
        self._bytes_of = bytes_of
        self._kept: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of `key`, made if it is not kept."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        value = make()
        with self._lock:
            self._kept[key] = value
            total = sum(self._bytes_of(one) for one in self._kept.values())
            while total > self.most_bytes:
                total -= self._bytes_of(self._kept.popitem(last=False)[1])
        return value

    def clear(self) -> None:
        """Drop all values."""
        with self._lock:
            self._kept.clear()

    def __len__(self) -> int:
        return len(self._kept)


def cache_root() -> Path | None:
    """The user's cache folder for forestgen, which may not exist yet; None if there is none."""
    chosen = os.environ.get(ENVIRONMENT)
    if chosen is not None:
        return Path(chosen).absolute() if chosen else None
    try:
        home = Path.home()
    except RuntimeError:  # a user without a home
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "forestgen" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "forestgen"
    named = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(named) if Path(named).is_absolute() else home / ".cache") / "forestgen"


@dataclass(frozen=True)
class DiskCache:
    """Entries by key, in one folder."""

    folder: Path
    most_bytes: int  # the entries used longest ago go beyond this

    def read(self, key: str) -> NDArray[np.uint8] | None:
        """The entry's bytes in memory of their own, None if there is no such entry, or none that is whole."""
        path = self._path(key)
        try:
            data = _file_bytes(path)
        except (OSError, MemoryError):
            return None
        content = data[_HEAD.size :]
        if data[: _HEAD.size].tobytes() != _head(key, content):
            self.drop(key)
            return None
        with suppress(OSError):
            os.utime(path)  # just used
        return content

    def write(self, key: str, data: bytes) -> bool:
        """Keep an entry, complete or not at all; False if that is not possible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if shutil.disk_usage(self.folder).free < _LEAST_FREE_BYTES + len(data):
                return False
            number, name = tempfile.mkstemp(dir=self.folder, suffix=_PARTIAL)
            try:
                with os.fdopen(number, "wb") as file:
                    file.write(_head(key, data))
                    file.write(data)
                Path(name).replace(self._path(key))
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
        except OSError:
            return False
        return True

    def drop(self, key: str) -> None:
        """Remove an entry that turned out to be unreadable."""
        with suppress(OSError):
            self._path(key).unlink(missing_ok=True)

    def trim(self) -> None:
        """Remove the entries used longest ago until the rest fits, and what dead processes left behind."""
        entries = self._entries()
        total = sum(size for _, size, _ in entries)
        if total > self.most_bytes:
            for _, size, path in sorted(entries, key=lambda entry: entry[0]):
                with suppress(OSError):
                    path.unlink(missing_ok=True)
                total -= size
                if total <= _SHARE_KEPT * self.most_bytes:
                    break
        for used, _, path in self._entries(_PARTIAL):
            if time.time() - used > _ABANDONED_S:
                with suppress(OSError):
                    path.unlink(missing_ok=True)

    def size_bytes(self) -> tuple[int, int]:
        """Number of entries and their bytes on disk."""
        entries = self._entries()
        return len(entries), sum(size for _, size, _ in entries)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}{_SUFFIX}"

    def _entries(self, suffix: str = _SUFFIX) -> list[tuple[float, int, Path]]:
        """Time of last use, bytes and path of each entry."""
        found = []
        try:
            with os.scandir(self.folder) as rows:
                for row in rows:
                    if row.name.endswith(suffix):
                        with suppress(OSError):  # another process may just have removed it
                            about = row.stat()
                            found.append((about.st_mtime, about.st_size, Path(row.path)))
        except OSError:
            return []
        return found


def _file_bytes(path: Path) -> NDArray[np.uint8]:
    """A plain file's bytes; a pipe or a device in its place is refused, and not waited for."""
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(number, "rb") as file:
        if not stat.S_ISREG(os.fstat(number).st_mode):
            raise OSError("not a plain file")
        return np.fromfile(file, dtype=np.uint8)


def _head(key: str, content: bytes | NDArray[np.uint8]) -> bytes:
    """What an entry of this key and content begins with."""
    name = hashlib.blake2b(key.encode(), digest_size=32).digest()
    checksum = zlib.crc32(memoryview(content))  # type: ignore[arg-type]  # NumPy's types do not tell of buffers
    return _HEAD.pack(_MAGIC, name, len(content), checksum)


def code_hash(
    parts: tuple[str, ...], packages: tuple[str, ...], tables: tuple[Path, ...] = (), without: tuple[str, ...] = ()
) -> str:
    """Hash, hexadecimal, of all that shapes a kind of results besides their inputs.

    It covers the versions of forestgen and Python, the machine's kind, and the files of parts that other packages have
    registered.

    Parameters
    ----------
    parts : folders and files of the package, such as ``community`` and ``pipeline.py``; any change in them counts.
    packages : that they compute with; their versions count.
    tables : folders of tables that they read.
    without : folders and files of the parts that do not shape the results.
    """
    return _code_hash(parts, packages, tables, without, registrations())


@cache
def _code_hash(
    parts: tuple[str, ...],
    packages: tuple[str, ...],
    tables: tuple[Path, ...],
    without: tuple[str, ...],
    registered: tuple[Registration, ...],
) -> str:
    digest = hashlib.blake2b(digest_size=20)
    versions = [version(name) for name in packages]
    digest.update(repr((__version__, platform.machine(), platform.python_version(), versions)).encode())
    for path in source_files(parts, without):
        _add(digest, PACKAGE, path)
    for folder in tables:
        for path in _files(folder, TABLES):
            _add(digest, folder, path)
    for one in registered:
        spec = importlib.util.find_spec(one.path.partition(":")[0])
        digest.update(f"\n{one.kind} {one.name} {one.path}\n".encode())
        if spec is not None and spec.origin is not None:
            _add(digest, Path(spec.origin).parent, Path(spec.origin))
    return digest.hexdigest()


def source_files(parts: tuple[str, ...], without: tuple[str, ...] = ()) -> list[Path]:
    """The files that `code_hash` reads of the package's parts."""
    left_out = [PACKAGE / one for one in without]
    found = (path for part in parts for path in _files(PACKAGE / part, SOURCES))
    return [path for path in found if not any(path.is_relative_to(one) for one in left_out)]


def _files(part: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """A file, or those of a folder, however deep, sorted."""
    if part.is_file():
        yield part
        return
    yield from sorted(path for path in part.rglob("*") if path.suffix in suffixes and path.is_file())


def _add(digest: hashlib.blake2b, root: Path, path: Path) -> None:
    """Name, size and content of a file."""
    content = path.read_bytes()
    digest.update(f"\n{path.relative_to(root).as_posix()} {len(content)}\n".encode())
    digest.update(content)
