"""Errors meant for people.

    ForestgenError            exit code 1
    ├── RecipeError           2   the recipe or a command's argument is wrong
    │   └── RecipeErrors      2   several of these at once, and of AssetError and LsystemError
    ├── AssetError            2   a file that the recipe names is missing or unreadable
    ├── LsystemError          2   an L-system program is wrong, or asks for the impossible
    ├── ResourceError         3   this machine lacks memory or a library for the task
    ├── OutputError           4   a result cannot be written
    ├── RenderError           5   the renderer failed, or a calibration misses its bounds
    └── DatasetError          6   a data set's files are damaged or contradict each other

Every message says where, what was expected, what was got, and what to do. A KeyboardInterrupt is not an error of
ours: the command line turns it into exit code 130.
"""

from __future__ import annotations

import errno
import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, Self, TypeVar

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

MOST_SHOWN = 50
_PLACE = re.compile(r"^(?P<origin>.*?):(?P<line>\d+)(?::|$)")
P = ParamSpec("P")
T = TypeVar("T")


def plain(text: str) -> str:
    """Text that a terminal shows and does not obey: control characters as \\x1b and the like, lines kept."""
    if text.isprintable():
        return text
    return "".join(
        ascii(one)[1:-1] if one != "\n" and unicodedata.category(one) in ("Cc", "Cf", "Cs") else one for one in text
    )


class ForestgenError(Exception):
    """Base of all errors that a user can cause and fix.

    Texts name a parameter between backticks, such as `` `overwrite=True` ``; the command line shows its option instead.

    Parameters
    ----------
    problem : one sentence: what is wrong.
    where : file, line and key, such as ``stand.yaml:12: site.size_m``.
    parameter : in place of `where`: the parameter of a call whose value is wrong, ``count`` or ``workers=8``.
    expected, got : what a valid value looks like, and the value found.
    hint : what to do about it.
    """

    code = "forestgen"  # the kind of error, for programs
    exit_code = 1  # of the command line

    def __init__(
        self,
        problem: str,
        *,
        where: str | None = None,
        parameter: str | None = None,
        expected: str | None = None,
        got: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.where = parameter if where is None else where
        self.parameter = parameter
        self.expected = expected
        self.got = got
        self.hint = hint
        super().__init__(str(self))

    def at(self, where: str) -> Self:
        """The same error at another place, for one of code that does not know it."""
        return type(self)(self.problem, where=where, expected=self.expected, got=self.got, hint=self.hint)

    @property
    def place(self) -> str | None:
        """Where it is: file, line and key, or the parameter of a call."""
        return self.where

    @property
    def errors(self) -> tuple[ForestgenError, ...]:
        """The error itself; of `RecipeErrors`, each of them."""
        return (self,)

    def text(self, prefix: str = "", message: Callable[[ForestgenError], str] = str) -> str:
        """The message behind a word such as ``error: ``."""
        return f"{prefix}{message(self)}"

    def __str__(self) -> str:
        head = f"{self.where}: {self.problem}" if self.where else self.problem
        rows = [("expected", self.expected), ("got", self.got), ("try", self.hint)]
        return plain("\n".join([head, *(f"  {name:<9} {text}" for name, text in rows if text)]))


class RecipeError(ForestgenError):
    """The recipe, an override or a command's argument is wrong."""

    code, exit_code = "recipe", 2


class RecipeErrors(RecipeError):  # noqa: N818 - a group
    """Several errors of one recipe, in the order of its file; its own fields are those of the first error."""

    def __init__(self, errors: Sequence[ForestgenError]) -> None:
        self._errors = tuple(errors)
        first = self._errors[0]
        super().__init__(first.problem, where=first.where, expected=first.expected, got=first.got, hint=first.hint)
        self.parameter = first.parameter

    @property
    def errors(self) -> tuple[ForestgenError, ...]:
        return self._errors

    def text(self, prefix: str = "", message: Callable[[ForestgenError], str] = str) -> str:
        """All errors, each with the prefix, and their number."""
        shown = [error.text(prefix, message) for error in self._errors[:MOST_SHOWN]]
        if len(self._errors) > MOST_SHOWN:
            shown.append(f"... and {len(self._errors) - MOST_SHOWN} more")
        return "\n\n".join([*shown, f"{len(self._errors)} errors"])

    def __str__(self) -> str:
        return self.text()

    def __reduce__(self) -> tuple[Any, ...]:
        return RecipeErrors, (self._errors,)


class AssetError(ForestgenError):
    """A file that the recipe names is missing or unreadable."""

    code, exit_code = "asset", 2


class LsystemError(ForestgenError):
    """An L-system program is wrong, or asks for the impossible when it runs."""

    code, exit_code = "lsystem", 2


class ResourceError(ForestgenError):
    """This machine lacks the memory or the library that the task needs."""

    code, exit_code = "resource", 3


class OutputError(ForestgenError):
    """A result cannot be written."""

    code, exit_code = "output", 4


def output_error(error: OSError, path: Path | None = None) -> OutputError:
    """`error` as an `OutputError` that names the path, the reason and what to do."""
    where = (error.filename2 or error.filename) if path is None else path  # of a copy, where it should have gone
    problem = f"cannot write: {error.strerror or error}"
    hint = _REMEDIES.get(error.errno or 0, "check the folder, or choose another")
    return OutputError(problem, where=None if where is None else str(where), hint=hint)


@contextmanager
def writing(path: Path, problem: str = "", hint: str | None = None) -> Iterator[None]:
    """In this block, an `OSError` becomes an `OutputError` that names the path and what to do; see `output_error`."""
    try:
        yield
    except OSError as error:
        if not problem:
            raise output_error(error, path) from error
        remedy = hint or _REMEDIES.get(error.errno or 0)
        raise OutputError(problem, where=str(path), got=error.strerror or str(error), hint=remedy) from error


class RenderError(ForestgenError):
    """The renderer failed."""

    code, exit_code = "render", 5


class DatasetError(ForestgenError):
    """A data set's files are damaged or contradict each other."""

    code, exit_code = "dataset", 6


class ErrorList:
    """Errors of a recipe's independent checks, at most one a place, to be raised together.

    Parameters
    ----------
    origin : the recipe's file as errors name it; its errors come first.
    """

    def __init__(self, origin: str) -> None:
        self.origin = origin
        self.found: list[ForestgenError] = []

    def __bool__(self) -> bool:
        return bool(self.found)

    @property
    def places(self) -> set[str]:
        """Where the errors are."""
        return {error.where for error in self.found if error.where}

    def add(self, *errors: ForestgenError) -> None:
        """Add errors, except those at places that had errors before."""
        known = self.places
        single = (one for error in errors for one in error.errors)
        self.found += [one for one in single if one.where is None or one.where not in known]

    def attempt(self, check: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T | None:
        """The result of a check, or None if the recipe fails it."""
        try:
            return check(*arguments, **keywords)
        except (RecipeError, AssetError, LsystemError) as error:
            self.add(error)
            return None

    def raise_all(self) -> None:
        """Raise the only error, or all of them in the order of the file; nothing where there is none."""
        if len(self.found) == 1:
            raise self.found[0]
        if self.found:
            places = [_place(error) for error in self.found]
            origins = list(dict.fromkeys([self.origin, *(origin for origin, _ in places)]))
            order = sorted(range(len(places)), key=lambda k: (origins.index(places[k][0]), places[k][1]))
            raise RecipeErrors([self.found[k] for k in order]) from self.found[order[0]]


def _place(error: ForestgenError) -> tuple[str, int]:
    """File and line of an error; line 0 where it names none."""
    where = error.where or ""
    match = _PLACE.match(where)
    return (match["origin"], int(match["line"])) if match else (where.partition(": ")[0], 0)
