"""Arguments of calls: what is no path, no number, or out of range is told at once, by the parameter's name."""

from __future__ import annotations

import errno
import math
import os
import unicodedata
from collections.abc import Mapping
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from forestgen.core.errors import ForestgenError, OutputError, RecipeError

PathLike = str | os.PathLike[str]
MOST_SEEDS = 2**63 - 1
_LONGEST_NAME = 255  # bytes of a file's name, on all common file systems
_MOST_LEVELS = 40  # of lists and mappings within one another; a recipe's file has no more
_MOST_VALUES = 10_000_000


def shown(value: object) -> str:
    """A value for a message, of at most 100 characters, whatever it is."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - of a stranger's class; of a number with too many digits, of too deep a list
        text = "a huge whole number" if isinstance(value, int) else f"a value of type {type(value).__name__}"
    return text if len(text) <= 100 else f"{text[:97]}..."


def path_of(value: Any, parameter: str, *, output: bool = False) -> Path:
    """The path that an argument names.

    Parameters
    ----------
    parameter : its name.
    output : whether something is written there: the name must then be UTF-8 without control characters.

    Raises
    ------
    RecipeError : this is no path, or no system can have a file there.
    OutputError : the latter, of an output.
    """
    return Path(_checked(value, parameter, OutputError if output else RecipeError, output=output))


def paths_of(values: Any, parameter: str, *, output: bool = False) -> list[Path]:
    """Several paths; one alone is welcome. See `path_of`."""
    return [path_of(one, parameter, output=output) for one in listed(values, parameter, "paths")]


def address_of(value: Any, parameter: str) -> str:
    """The same of an output that may be the address of an object store."""
    return _checked(value, parameter, OutputError, output=True)


def _checked(value: Any, parameter: str, error: type[ForestgenError], *, output: bool) -> str:
    try:
        text = os.fspath(value)
    except TypeError:
        text = None
    if not isinstance(text, str):
        raise RecipeError("this is no path", parameter=parameter, expected="a text or a pathlib.Path", got=shown(value))
    expected = "a name of UTF-8 characters, none of them a control character" if output else "a file's or folder's name"
    wrong = any(unicodedata.category(one) in ("Cc", "Cs") for one in text) if output else "\0" in text
    if not text or wrong or not _encodes(text):
        raise error("no file has such a name", parameter=parameter, expected=expected, got=f"{text!a:.100}")
    if "://" not in text and _too_long(text):
        got = f"{os.strerror(errno.ENAMETOOLONG)}: {len(text):,} characters, {text!r:.60}..."
        raise error("the name is too long", parameter=parameter, expected="a shorter one", got=got)
    return text


def _too_long(text: str) -> bool:
    if any(len(os.fsencode(part)) > _LONGEST_NAME for part in Path(text).parts):
        return True
    try:
        os.lstat(text)
    except OSError as cause:
        return cause.errno == errno.ENAMETOOLONG
    return False


def _encodes(text: str) -> bool:
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return False
    return True


def listed(values: Any, parameter: str, what: str) -> list[Any]:
    """The entries of a list; a text or a path alone is a list of itself. Raises `RecipeError`."""
    if isinstance(values, str | os.PathLike):
        return [values]
    try:
        if not isinstance(values, Mapping):
            return list(values)
    except TypeError:  # also of an array without dimensions, which has an __iter__
        pass
    raise RecipeError(f"this is no list of {what}", parameter=parameter, expected="a list", got=shown(values))


def whole_of(value: Any, parameter: str, least: int, most: int) -> int:
    """A whole number from `least` to `most`; True and 1.0 are none. Raises `RecipeError`."""
    if _is_a(Integral, value) and least <= value <= most:
        return int(value)
    raise _no_number(value, parameter, least, most, "a whole number, ")


def number_of(value: Any, parameter: str, least: float = -math.inf, most: float = math.inf) -> float:
    """A number from `least` to `most`, which NaN is not; without these any number. Raises `RecipeError`."""
    if _is_a(Real, value) and (least <= value <= most or least == -most == -math.inf):
        with suppress(OverflowError):  # of a whole number beyond all floats
            return float(value)
    raise _no_number(value, parameter, least, most, "")


def flag_of(value: Any, parameter: str) -> bool:
    """True or False; texts and numbers, which Python takes for either, are none. Raises `RecipeError`."""
    if not isinstance(value, bool):
        raise RecipeError("this is neither yes nor no", parameter=parameter, expected="True or False", got=shown(value))
    return value


def _is_a(kind: type, value: Any) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _no_number(value: Any, parameter: str, least: float, most: float, kind: str) -> RecipeError:
    whole = _is_a(Integral, value)
    low, high = (f"{one:,}" if isinstance(one, int) else f"{one:,.6g}" for one in (least, most))
    expected = f"{'' if whole else kind}{low} to {high}" if math.isfinite(least + most) else "a number"
    return RecipeError("no such number", parameter=parameter, expected=expected, got=shown(value))


def text_of(value: Any, parameter: str) -> str:
    """A text. Raises `RecipeError`."""
    if not isinstance(value, str):
        raise RecipeError("this is no text", parameter=parameter, expected="a text", got=shown(value))
    return value


def texts_of(values: Any, parameter: str) -> list[str]:
    """Several texts; one alone is welcome. Raises `RecipeError`."""
    return [text_of(one, parameter) for one in listed(values, parameter, "texts")]


def plain_copy(value: Any, where: str) -> Any:
    """A copy of lists and mappings, as lists and dicts; what else they hold is the same object.

    Raises
    ------
    RecipeError : they hold one another too deeply, or themselves, or mean too many values.
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
    if isinstance(value, list):
        return [_copy(one) for one in value]
    return tuple(_copy(one) for one in value) if isinstance(value, tuple) else value
