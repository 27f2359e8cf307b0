"""Files of one command: all appear together when it ends well, or none does."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from forestgen.core.errors import OutputError
from forestgen.dataset.files import output_error, write_bytes


def check_writable(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise `OutputError` for a folder, for a file that may not be replaced, and where nobody may write.

    Links, pipes and devices are never replaced.
    """
    for path in paths:
        try:
            if path.is_dir():
                raise OutputError(
                    "the output is a folder", where=str(path), expected="a file", hint="choose another name"
                )
            if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
                expected, hint = "a new name, or a regular file: no link, pipe or device", "choose another name"
                raise OutputError("the output is no regular file", where=str(path), expected=expected, hint=hint)
            if path.exists() and not overwrite:
                raise OutputError("the file exists", where=str(path), hint="choose another name, or `overwrite=True`")
            folder = next(parent for parent in path.absolute().parents if parent.exists())
        except OSError as error:
            raise output_error(error, path) from error
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
        missing = [folder for folder in path.parents if not folder.exists()]
        self._made = missing + self._made
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(error, path) from error
        self._hidden[path] = hidden = path.with_name(f".{path.name}.partial-{os.getpid()}")
        try:
            write_bytes(hidden, content)
        except OutputError as error:
            cause = error.__cause__
            raise (output_error(cause, path) if isinstance(cause, OSError) else error) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        placed: list[Path] = []
        try:
            if kind is None:
                self._place(placed)
                return
        except BaseException:
            for path in placed:
                path.unlink(missing_ok=True)
            self._clear()
            raise
        self._clear()

    def _place(self, placed: list[Path]) -> None:
        check_writable(self._hidden, overwrite=self._overwrite)  # another process may have written there meanwhile
        for path, hidden in self._hidden.items():
            new = not path.exists()
            try:
                hidden.replace(path)
            except OSError as error:
                raise output_error(error, path) from error
            if new:
                placed.append(path)

    def _clear(self) -> None:
        for hidden in self._hidden.values():
            with suppress(OSError):
                hidden.unlink(missing_ok=True)
        for folder in self._made:
            with suppress(OSError):
                folder.rmdir()
