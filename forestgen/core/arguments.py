"""What users give: arguments of calls, checked at once and named in errors, and text files."""

from __future__ import annotations

import errno
import os
import re
import unicodedata
from collections.abc import Mapping
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from forestgen.core.errors import AssetError, ForestgenError, OutputError, RecipeError

PathLike = str | os.PathLike[str]
MOST_SEEDS = 2**63 - 1
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+:/")  # a `Path` keeps one of two slashes; one letter is a drive of Windows
_LONGEST_NAME = 255  # bytes of a file's name, on all common file systems
_MOST_LEVELS = 40  # of lists and mappings within one another; a recipe's file has no more
_MOST_VALUES = 10_000_000


def shown(value: object) -> str:
    """A value for a message, of at most 100 characters, whatever it is."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - of a foreign class; of a number with too many digits, of too deep a list
        text = "a huge whole number" if isinstance(value, int) else f"a value of type {type(value).__name__}"
    return text if len(text) <= 100 else f"{text[:97]}..."


def path_of(value: Any, parameter: str, *, output: bool = False) -> Path:
    """The path that an argument names; `output`: something is written there.

    Raises
    ------
    RecipeError : this is no path, or no system can have a file there.
    OutputError : the name of an output is not UTF-8, has control characters or is the address of an object store.
    """
    text = _checked(value, parameter, OutputError if output else RecipeError, output=output)
    if output and isinstance(value, str) and is_address(text):
        expected = "a path on this machine: `render` and `batch` alone write to object stores"
        raise OutputError("this is an address", parameter=parameter, expected=expected, got=text[:60])
    return Path(text)


def is_address(path: PathLike) -> bool:
    """Whether a path is the address of an object store, such as s3://bucket/forests, which is no folder here."""
    return _ADDRESS.match(os.fspath(path)) is not None


def paths_of(values: Any, parameter: str, *, output: bool = False) -> list[Path]:
    """Several paths, or one alone. See `path_of`."""
    return [path_of(one, parameter, output=output) for one in listed(values, parameter, "paths")]


def address_of(value: Any, parameter: str) -> str:
    """The path of an output, or the address of an object store."""
    return _checked(value, parameter, OutputError, output=True)


def _checked(value: Any, parameter: str, error: type[ForestgenError], *, output: bool) -> str:
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise _wrong("this is no path", value, parameter, "a text or a pathlib.Path")
    expected = "a name of UTF-8 characters, none of them a control character" if output else "a file's or folder's name"
    wrong = any(unicodedata.category(one) in ("Cc", "Cs") for one in text) if output else "\0" in text
    try:
        parts = [os.fsencode(part) for part in Path(text).parts]
    except UnicodeEncodeError:
        wrong = True
    if not text or wrong:
        raise error("no file has such a name", parameter=parameter, expected=expected, got=f"{text!a:.100}")
    if "://" not in text and (any(len(part) > _LONGEST_NAME for part in parts) or _too_long(text)):
        got = f"{os.strerror(errno.ENAMETOOLONG)}: {len(text):,} characters, {text!r:.60}..."
        raise error("the name is too long", parameter=parameter, expected="a shorter one", got=got)
    return text


def _too_long(text: str) -> bool:
    try:
        os.lstat(text)
    except OSError as cause:
        return cause.errno == errno.ENAMETOOLONG
    return False


def listed(values: Any, parameter: str, what: str) -> list[Any]:
    """The entries of a list; a text or a path alone is a list of itself. Raises `RecipeError`."""
    if isinstance(values, str | os.PathLike):
        return [values]
    with suppress(TypeError):  # also of an array without dimensions, which has an __iter__
        if not isinstance(values, Mapping):
            return list(values)
    raise _wrong(f"this is no list of {what}", values, parameter, "a list")


def whole_of(value: Any, parameter: str, least: int, most: int) -> int:
    """A whole number from `least` to `most`; True and 1.0 are none. Raises `RecipeError`."""
    if _is_a(Integral, value) and least <= value <= most:
        return int(value)
    kind = "" if _is_a(Integral, value) else "a whole number, "
    raise _wrong("no such number", value, parameter, f"{kind}{least:,} to {most:,}")


def number_of(value: Any, parameter: str) -> float:
    """Any number, also NaN. Raises `RecipeError`."""
    if _is_a(Real, value):
        with suppress(OverflowError):  # of a whole number beyond all floats
            return float(value)
    raise _wrong("no such number", value, parameter, "a number")


def flag_of(value: Any, parameter: str) -> bool:
    """True or False; texts and numbers, which Python takes for either, are none. Raises `RecipeError`."""
    if not isinstance(value, bool):
        raise _wrong("this is neither yes nor no", value, parameter, "True or False")
    return value


def text_of(value: Any, parameter: str) -> str:
    """A text. Raises `RecipeError`."""
    if not isinstance(value, str):
        raise _wrong("this is no text", value, parameter, "a text")
    return value


def texts_of(values: Any, parameter: str) -> list[str]:
    """Several texts, or one alone. Raises `RecipeError`."""
    return [text_of(one, parameter) for one in listed(values, parameter, "texts")]


def _is_a(kind: type, value: Any) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _wrong(problem: str, value: Any, parameter: str, expected: str) -> RecipeError:
    return RecipeError(problem, parameter=parameter, expected=expected, got=shown(value))


def plain_copy(value: Any, where: str) -> Any:
    """A copy of lists and mappings, as lists and dicts; what else they hold is the same object.

    Raises `RecipeError` where they are nested too deeply, contain themselves, or mean too many values.
    """
    _measure(value, 0, where, {})
    return _copy(value)


def _measure(value: Any, depth: int, where: str, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Levels of a value, and how many values it means when what is shared is written out."""
    if not isinstance(value, Mapping | list | tuple):
        return 0, 1
    levels, count = known.get(id(value), (1, 1))
    if depth + levels > _MOST_LEVELS:
        raise RecipeError("nested too deeply", where=where, expected=f"at most {_MOST_LEVELS} levels", got="more")
    if id(value) not in known:
        for one in value.values() if isinstance(value, Mapping) else value:
            inside, number = _measure(one, depth + 1, where, known)
            levels, count = max(levels, 1 + inside), count + number
        known[id(value)] = levels, count
    if count > _MOST_VALUES:
        raise RecipeError("too many values", where=where, expected=f"at most {_MOST_VALUES:,}", got="more")
    return levels, count


def _copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copy(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        copies = [_copy(one) for one in value]
        return copies if isinstance(value, list) else tuple(copies)
    return value


def read_text(path: Path, what: str, *, most_bytes: int, error: type[ForestgenError] = AssetError) -> str:
    """The text of a file, UTF-8.

    Parameters
    ----------
    what : names the file in messages, such as "an L-system program".
    most_bytes : a larger file is refused.
    error : is raised for a file that is no such text.

    Raises
    ------
    AssetError : there is no such file, or it cannot be read.
    """
    where, expected = str(path), f"{what}, a text file"
    try:
        if path.is_dir():
            raise error("this is a folder", where=where, expected=expected, got="a folder")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
            size = max(len(data), os.fstat(file.fileno()).st_size)
    except FileNotFoundError as cause:
        raise AssetError("no such file", where=where, expected=expected) from cause
    except (OSError, ValueError) as cause:
        got = cause.strerror if isinstance(cause, OSError) else str(cause)
        raise AssetError("the file cannot be read", where=where, expected=expected, got=got) from cause
    if size > most_bytes:
        limit, got = f"at most {most_bytes / 1e6:g} MB", f"{size / 1e6:,.0f} MB"
        raise error(f"the file is too large for {what}", where=where, expected=limit, got=got)
    try:
        text = data.decode("utf-8-sig")
        control = re.search(r"[\x00-\x08\x0e-\x1f]", text)
        at = len(text[: control.start()].encode()) if control else None
    except UnicodeDecodeError as cause:
        at = cause.start
    if at is None:
        return text
    line, column = data.count(b"\n", 0, at) + 1, at - data.rfind(b"\n", 0, at)
    got, hint = f"byte 0x{data[at]:02x}", "save the file as UTF-8"
    raise error("this is not a text file", where=f"{path}:{line}:{column}", expected="UTF-8 text", got=got, hint=hint)
