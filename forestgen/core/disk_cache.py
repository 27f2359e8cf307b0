"""A folder of results that can be made again: bounded, shared by processes, and never in the way.

An entry's name is the hash of all that it depends on, so an entry never goes stale. Whatever fails here (a folder that
cannot be written to, a full disk, an entry cut short) costs the time of making the result again, and no more.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
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
        """The entry's bytes in memory of their own, None if there is no such entry."""
        path = self._path(key)
        try:
            data = np.fromfile(path, dtype=np.uint8)
        except (OSError, MemoryError):
            return None
        with suppress(OSError):
            os.utime(path)  # just used
        return data

    def write(self, key: str, data: bytes) -> bool:
        """Keep an entry, complete or not at all; False if that is not possible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if shutil.disk_usage(self.folder).free < _LEAST_FREE_BYTES + len(data):
                return False
            number, name = tempfile.mkstemp(dir=self.folder, suffix=_PARTIAL)
            try:
                with os.fdopen(number, "wb") as file:
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
        """Number of entries and their bytes."""
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
