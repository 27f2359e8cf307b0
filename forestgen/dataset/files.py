"""Small files in memory, then on disk, one by one or all together: failures name the path, the reason and a remedy."""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from forestgen.core.arguments import flag_of
from forestgen.core.errors import STORAGE_ERRNOS, OutputError, output_error, writing


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
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file; a failure raises `OutputError`."""
    with writing(path):
        path.write_bytes(content)


def write_json(path: Path, content: Any) -> None:
    """Write JSON with sorted keys; NaN and infinities, which JSON lacks, raise `ValueError`."""
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False)
    write_bytes(path, (text + "\n").encode())


def check_writable(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise `OutputError` for a folder, for a file that may not be replaced, and where nobody may write.

    Links, pipes and devices are never replaced.
    """
    for path in paths:
        other = "choose another name"
        with writing(path):
            if path.is_dir():
                raise OutputError("the output is a folder", where=str(path), expected="a file", hint=other)
            if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
                expected = "a new name, or a regular file: no link, pipe or device"
                raise OutputError("the output is no regular file", where=str(path), expected=expected, hint=other)
            if not flag_of(overwrite, "overwrite") and path.exists():
                raise OutputError("the file exists", where=str(path), hint=f"{other}, or `overwrite=True`")
            folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
            reason = errno.EACCES if folder.is_dir() else errno.ENOTDIR
            raise output_error(OSError(reason, os.strerror(reason)), path)


class FileSet:
    """Context manager: files are written under hidden names, and renamed when all are complete.

    On any failure, Ctrl-C included, the hidden files go, and the folders that were made for them.

    `overwrite`: replace files that exist.
    """

    def __init__(self, *, overwrite: bool) -> None:
        self._overwrite = overwrite
        self._hidden: dict[Path, Path] = {}  # by the name that it will have
        self._made: list[Path] = []  # folders, the innermost first

    def __enter__(self) -> FileSet:
        return self

    def write(self, path: Path, content: bytes) -> None:
        """Write one file.

        Raises `OutputError`: it exists and may not be replaced, or cannot be written.
        """
        check_writable([path], overwrite=self._overwrite)
        self._made = [folder for folder in path.parents if not folder.exists()] + self._made
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._hidden[path] = path.with_name(f".{path.name}.partial-{os.getpid()}")
            self._hidden[path].write_bytes(content)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._place()
        finally:
            for hidden in self._hidden.values():
                with suppress(OSError):
                    hidden.unlink(missing_ok=True)
            for folder in self._made:
                with suppress(OSError):  # it holds what was written
                    folder.rmdir()

    def _place(self) -> None:
        """Rename all files; where one cannot be, those that were new go again."""
        check_writable(self._hidden, overwrite=self._overwrite)  # another process may have written there meanwhile
        with ExitStack() as undo:
            for path, hidden in self._hidden.items():
                new = not path.exists()
                with writing(path):
                    hidden.replace(path)
                if new:
                    undo.callback(path.unlink, missing_ok=True)
            undo.pop_all()
