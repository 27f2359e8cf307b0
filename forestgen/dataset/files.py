"""Small files in memory, then on disk: failures to write name the path, the reason and a remedy."""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from forestgen.core.errors import OutputError

_REMEDIES = {
    errno.ENOSPC: "free some space, or choose a folder on another disk",
    errno.EDQUOT: "your quota is used up: delete something, or choose a folder on another disk",
    errno.EACCES: "choose a folder that you may write to",
    errno.EPERM: "choose a folder that you may write to",
    errno.EROFS: "the file system is read-only: choose a folder on another",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOTDIR: "a part of the path is a file: choose another path",
    errno.EBUSY: "the folder is in use or a mount point: choose a folder inside it",
    errno.EIO: "the disk or the network share failed: choose a folder on another",
    errno.EFBIG: "the file system cannot hold a file this large: choose a folder on another",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
}
STORAGE_ERRNOS = frozenset(_REMEDIES)


def output_error(error: OSError, path: Path | None = None) -> OutputError:
    """`error` as an `OutputError` that names the path, the reason and what to do."""
    where = (error.filename2 or error.filename) if path is None else path  # of a copy, where it should have gone
    return OutputError(
        f"cannot write: {error.strerror or error}",
        where=None if where is None else str(where),
        hint=_REMEDIES.get(error.errno or 0, "check the folder, or choose another"),
    )


@contextmanager
def disk_errors() -> Iterator[None]:
    """In this block, an `OSError` of a disk that is full or failing becomes an `OutputError`."""
    try:
        yield
    except OSError as error:
        if error.errno not in STORAGE_ERRNOS:
            raise
        raise output_error(error) from error


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, if they are missing; a failure raises `OutputError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(error, folder) from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file; a failure raises `OutputError`."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise output_error(error, path) from error


def write_json(path: Path, content: Any) -> None:
    """Write JSON with sorted keys; NaN and infinities, which JSON lacks, raise `ValueError`."""
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False)
    write_bytes(path, (text + "\n").encode())
