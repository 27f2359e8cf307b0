"""SHA256SUMS: a line a file, as `sha256sum -c SHA256SUMS` reads it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from forestgen.core.errors import DatasetError
from forestgen.dataset.files import output_error
from forestgen.dataset.safe_path import SafePath, is_inside

SUMS_NAME = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")
_LONGEST_LINE = 8192  # bytes


def write_sums(path: Path, sums: Iterable[tuple[str, str]]) -> None:
    """Write path and SHA-256, hexadecimal, of each file, in the order given; a failure raises `OutputError`."""
    try:
        with path.open("w", encoding="utf-8", newline="\n") as stream:
            stream.writelines(f"{digest}  {name}\n" for name, digest in sums)
    except OSError as error:
        raise output_error(error, path) from error


def read_sums(path: Path, refused: Callable[[DatasetError], None] | None = None) -> Iterator[tuple[str, str]]:
    """Path and SHA-256 of each file that is listed; a file that is missing raises `DatasetError`.

    `refused` takes the error of each line of another form, and the other lines are read; None: the first one raises.
    """
    try:
        with SafePath(path.parent, path.name).open() as stream:
            lines = (line.decode("utf-8") for line in iter(lambda: stream.readline(_LONGEST_LINE), b""))
            for number, line in enumerate(lines, start=1):
                match = _LINE.fullmatch(line.rstrip("\n"))
                if match is None or not line.endswith("\n") or not is_inside(match[2]):
                    error = DatasetError(
                        "this line is no checksum",
                        where=f"{path}:{number}",
                        expected="64 hexadecimal digits, two blanks and a path below the data set's folder",
                        got=repr(line[:80]),
                    )
                    if refused is None:
                        raise error
                    refused(error)
                else:
                    yield match[2], match[1]
    except (OSError, ValueError) as error:  # ValueError: bytes that are no UTF-8
        raise DatasetError("the checksums cannot be read", where=str(path), got=str(error)) from error


def file_sum(path: Path | SafePath) -> str:
    """SHA-256, hexadecimal, of a file."""
    with path.open() if isinstance(path, SafePath) else path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
