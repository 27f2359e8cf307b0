"""Files of a data set that anybody may have made: what is read lies in the data set's folder.

Names of files come from a stranger's tables, JSON files and folders. A `SafePath` keeps such a name apart from the data
set's folder, and every read goes through it: the name is a relative path without ``..``, no part of it is a symbolic
link (the data set's folder itself may be one), and the file is a regular one, no pipe and no device. What is refused
raises `RefusedFileError`, an `OSError`, so that whoever reads treats it as any other file that cannot be read.

Largest files that are read in one piece:

| file | at most |
|---|---|
| JSON outside of the frames' folders: manifest.json, what a format has over all images | 8 GB |
| other texts: .json, .yaml, .txt, .md | 64 MB |
| all others: pictures, tables, maps | 16 GB |

and in no case more than the free memory. No file is larger than 64 GB. JSON has at most 100 levels, numbers of at most
40 digits and below 1e100, and whole characters.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from forestgen.core.errors import DatasetError, RecipeError
from forestgen.core.processes import free_bytes

_MB, _GB = 10**6, 10**9
_MOST_BYTES = 64 * _GB  # of any file
_TEXTS = (".json", ".yaml", ".yml", ".txt", ".md")
_SHARE_OF_MEMORY = 0.8
_MOST_LEVELS = 100
_MOST_DIGITS, _LARGEST = 40, 1e100
_MOST_CELLS = 200_000_000  # of a table that is read in one piece
_DRIVE = re.compile(r"[A-Za-z]:")
_FRAME = re.compile(r"[0-9]{6,18}-[A-Za-z0-9][A-Za-z0-9_-]{0,79}")
_SPLIT = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_TOO_DEEP = f"nested too deeply: more than {_MOST_LEVELS} levels"
_HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")
_REMEDY = "forestgen verify finds what is damaged, the command that made the data set makes it again with `resume=True`"
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))


class RefusedFileError(OSError):
    """A file of a data set that is not read, for what it is or where it lies."""

    def __init__(self, reason: str) -> None:
        super().__init__(errno.EINVAL, reason)

    def __str__(self) -> str:
        return str(self.strerror)


@dataclass(frozen=True)
class SafePath:
    """A file or folder of a data set, which may not be there."""

    root: Path  # the data set's folder
    name: str = ""  # below it, with forward slashes; "" the folder itself

    def __truediv__(self, name: str) -> SafePath:
        return SafePath(self.root, f"{self.name}/{name}" if self.name else name)

    def __str__(self) -> str:
        return f"{self.root}/{self.name}" if self.name else str(self.root)

    def located(self) -> Path:
        """The path, for libraries that take no stream.

        A name that leads out of the data set, or has a link in it, raises `RefusedFileError`; a missing one `OSError`.
        """
        return self._found()[0]

    def is_file(self) -> bool:
        """Whether this is a file that can be opened."""
        return stat.S_ISREG(self._mode())

    def is_folder(self) -> bool:
        return stat.S_ISDIR(self._mode())

    def names(self) -> list[str]:
        """What lies in the folder, sorted; nothing where there is no such folder. Raises as `located` does."""
        try:
            path, status = self._found()
        except (FileNotFoundError, NotADirectoryError):
            return []
        return sorted(one.name for one in path.iterdir()) if stat.S_ISDIR(status.st_mode) else []

    def size_bytes(self) -> int:
        """Of a file; raises what `open` raises."""
        path, status = self._found()
        _check_regular(path, status)
        return status.st_size

    def open(self) -> BufferedReader:
        """The file as a stream; raises as `located` does, and for a pipe, a device, or more than 64 GB."""
        path, status = self._found()
        _check_regular(path, status)  # before it is opened: to open a device can move it
        stream = os.fdopen(os.open(path, _FLAGS), "rb")
        try:
            _check_regular(path, os.fstat(stream.fileno()))
        except OSError:
            stream.close()
            raise
        return stream

    def read(self) -> bytes:
        """All bytes, of a file that is not larger than this module's table says; raises what `open` raises."""
        name = self.name.lower()
        most = 64 * _MB if name.endswith(_TEXTS) else 16 * _GB
        if name.endswith(".json") and not any(map(is_frame, self.name.split("/"))):
            most = 8 * _GB
        with self.open() as stream:
            size_bytes = os.fstat(stream.fileno()).st_size
            size = f"{size_bytes / _MB:,.0f} MB"
            if size_bytes > most:
                raise RefusedFileError(f"the file is too large: {size}, at most {most / _MB:,.0f} MB")
            if size_bytes > 64 * _MB and size_bytes > _SHARE_OF_MEMORY * free_bytes():
                raise RefusedFileError(f"the file is larger than the free memory: {size}")
            return stream.read(size_bytes)

    def read_json(self) -> Any:
        """The content of a JSON file; raises what `read` and `load_json` raise."""
        return load_json(self.read())

    def _mode(self) -> int:
        try:
            return self._found()[1].st_mode
        except (OSError, ValueError):
            return 0

    def _found(self) -> tuple[Path, os.stat_result]:
        parts, path = _parts(self.name), self.root
        status = path.stat()
        for part in parts:
            path = path / part
            status = path.lstat()
            if stat.S_ISLNK(status.st_mode):
                raise RefusedFileError("a link in a data set is not followed")
        return path, status


def _parts(name: str) -> list[str]:
    """Names of the folders on the way and of the file."""
    parts = name.split("/") if name else []
    outwards = any(part in ("", "..") for part in parts) or _DRIVE.match(name)
    if outwards or "\\" in name or any(ord(one) < 32 for one in name):
        raise RefusedFileError("the path leaves the data set's folder")
    return [part for part in parts if part != "."]


def is_inside(name: Any) -> bool:
    """Whether a value can name a file of a data set: a relative path that leads nowhere else."""
    try:
        return isinstance(name, str) and len(_parts(name)) == name.count("/") + 1 and bool(name.encode())
    except (RefusedFileError, UnicodeEncodeError):
        return False


def is_frame(name: Any) -> bool:
    """Whether a value can be the name of a frame's folder, such as 000000-camera0."""
    return isinstance(name, str) and _FRAME.fullmatch(name) is not None


def is_split(name: Any) -> bool:
    """Whether a value can be a split's name."""
    return isinstance(name, str) and _SPLIT.fullmatch(name) is not None


def _check_regular(path: Path, status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder", str(path))
    if not stat.S_ISREG(status.st_mode):
        raise RefusedFileError("this is a pipe, a device or a socket")
    if status.st_size > _MOST_BYTES:  # it may hold nothing but holes, and take no room on a disk
        raise RefusedFileError(f"the file is too large: {status.st_size / _GB:,.0f} GB")


def load_json(content: bytes | str) -> Any:
    """JSON within the bounds of this module's description; anything else raises `ValueError`."""
    text = content if isinstance(content, str) else content.decode("utf-8")
    try:
        value = json.loads(text, parse_constant=_number, parse_int=_number, parse_float=_number)
        _check_levels(value, _MOST_LEVELS)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    if _HALF_CHARACTER.search(text):
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    return value


def _check_levels(value: Any, most: int) -> None:
    if most < 0:
        raise ValueError(_TOO_DEEP)
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        if isinstance(one, dict | list):
            _check_levels(one, most - 1)


def _number(text: str) -> int | float:
    if len(text) > _MOST_DIGITS or not abs(float(text)) < _LARGEST:
        raise ValueError(f"{text[:40]}: no number, or a number of more than {_MOST_DIGITS} digits, or from 1e100 on")
    return int(text) if text.lstrip("-").isdigit() else float(text)


def check_cells(rows: int, columns: int) -> None:
    """Refuse a table that memory may not hold: a few bytes can stand for any number of equal rows."""
    if rows * columns > _MOST_CELLS:
        raise RefusedFileError(f"the table is too large: {rows:,} rows of {columns:,} columns")


def read_parquet(path: SafePath) -> Any:
    """A Parquet file as a `pyarrow.Table`; one that is too large raises what `check_cells` raises."""
    import pyarrow.parquet as pq

    with path.open() as stream, pq.ParquetFile(stream) as file:
        check_cells(file.metadata.num_rows, file.metadata.num_columns)
        return file.read()


def check_folder(root: Path, expected: str) -> None:
    """Refuse what is no folder of this machine, with a `RecipeError`: a wrong name, not a damaged data set."""
    if not root.is_dir():
        problem = "this is a file" if root.exists() else "there is no such folder"
        raise RecipeError(problem, where=str(root), expected=expected)


def unreadable(path: SafePath | Path, error: Exception, hint: str = _REMEDY) -> DatasetError:
    """The error of a file that raised `error` when it was read."""
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return DatasetError("a file of the data set is missing", where=str(path), hint=hint)
    problem = f"cannot read: {getattr(error, 'strerror', None) or one_line(error)}"
    return DatasetError(problem, where=str(path), hint=hint)


@contextmanager
def reading(path: SafePath, failed: Callable[[SafePath, Exception], Exception] = unreadable) -> Iterator[SafePath]:
    """A file that is read in this block, by any library; what that raises becomes the error that `failed` makes."""
    import pyarrow as pa
    from PIL.Image import DecompressionBombError

    kinds = (OSError, ValueError, TypeError, SyntaxError, RuntimeError, MemoryError)  # of Pillow and OpenEXR too
    try:
        yield path
    except (*kinds, pa.ArrowException, DecompressionBombError) as error:
        raise failed(path, error) from error


def read_object(path: SafePath) -> dict[str, Any]:
    """An object of JSON; a file that is missing, damaged or none raises `DatasetError`."""
    with reading(path):
        content = path.read_json()
        if not isinstance(content, dict):
            raise ValueError("this is no JSON object")
        return content


def one_line(error: Exception) -> str:
    """What went wrong, the same in every process."""
    from PIL import UnidentifiedImageError

    if isinstance(error, UnidentifiedImageError):  # its text names the stream, with a number that changes
        return "this is no PNG"
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_input=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"[:200]
    return " ".join(str(error).split())[:200] or type(error).__name__
