"""A folder of results that can be made again: bounded, shared by processes, and never in the way.

An entry's name is the hash of all that it depends on, so an entry never goes stale. It begins with the hash of its name
and the checksum of its content: what is cut short, changed or misplaced is not there. Whatever fails here (a folder
that cannot be written to, a full disk, another's file) costs the time of making the result again, and no more.

Any number of processes may read, write and trim one folder. An entry is written under a name of its own and renamed
when it is whole, so a reader finds the old, the new, or none; on a network file system too, as far as that renames
files at once.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import struct
import sys
import tempfile
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ENVIRONMENT = "FORESTGEN_CACHE"  # a folder of one's own; empty: no cache
_SUFFIX, _PARTIAL = ".entry", ".partial"
_ABANDONED_S = 3600.0  # a partial entry this old belongs to a process that died
_SHARE_KEPT = 0.9  # of the most bytes, when the oldest entries go
_LEAST_FREE_BYTES = 1_000_000_000  # of the disk
_MAGIC = b"fgentry1"
_HEAD = struct.Struct("<8s32sQI12x")  # magic, hash of the key, bytes of content, their CRC-32; 64 bytes, for alignment


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
