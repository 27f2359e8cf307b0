"""Text files from strangers."""

from __future__ import annotations

import re
from pathlib import Path

from forestgen.core.errors import AssetError, ForestgenError


def read_text(path: Path, what: str, *, most_bytes: int, error: type[ForestgenError]) -> str:
    """The text of a file, UTF-8.

    Parameters
    ----------
    what : names the file in messages, such as "an L-system program".
    most_bytes : refuse a larger file before it is read.
    error : of this type is raised for what is no such text.

    Raises
    ------
    AssetError : there is no such file, or it cannot be read.
    """
    try:
        if path.is_dir():
            raise error("this is a folder", where=str(path), expected=f"{what}, a text file")
        if not path.is_file():
            raise AssetError("no such file", where=str(path), expected=f"{what}, a text file")
        size = path.stat().st_size
        if size > most_bytes:
            raise error(
                f"the file is too large for {what}",
                where=str(path),
                expected=f"at most {most_bytes / 1e6:g} MB",
                got=f"{size / 1e6:,.0f} MB",
            )
        data = path.read_bytes()
    except OSError as cause:
        raise AssetError(
            "the file cannot be read", where=str(path), expected=f"{what}, a text file", got=cause.strerror
        ) from cause
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise _not_text(path, data, cause.start, error) from cause
    control = re.search(r"[\x00-\x08\x0e-\x1f]", text)
    if control:
        raise _not_text(path, data, len(text[: control.start()].encode()), error)
    return text


def _not_text(path: Path, data: bytes, at: int, error: type[ForestgenError]) -> ForestgenError:
    line, column = data.count(b"\n", 0, at) + 1, at - data.rfind(b"\n", 0, at)
    return error(
        "this is not a text file",
        where=f"{path}:{line}:{column}",
        expected="text in UTF-8",
        got=f"byte 0x{data[at]:02x}",
    )
