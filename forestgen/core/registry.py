"""Names of interchangeable parts, each a lazy dotted path: a listing imports nothing heavy.

`register` adds parts of other packages. Worker processes get what was registered by `registrations`, and what is kept
on disk depends on the code of registered parts too (`forestgen.core.code_hash`).
"""

from __future__ import annotations

import difflib
import importlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from forestgen.core.errors import RecipeError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_registered: list[Registration] = []
_registries: dict[str, Registry] = {}  # by kind


@dataclass(frozen=True)
class Registration:
    """A part of another package."""

    kind: str  # name of the registry
    name: str
    path: str  # module:attribute
    description: str


def registrations() -> tuple[Registration, ...]:
    """All that `Registry.register` was called for in this process."""
    return tuple(_registered)


def register_again(parts: Iterable[Registration]) -> None:
    """Register in a worker process what was registered in the process that started it."""
    for one in parts:
        if one.kind in _registries:
            _registries[one.kind].register(one.name, one.path, one.description)
        elif one not in _registered:
            _registered.append(one)  # its registry takes it when it is made


class Registry:
    """Maps an id to an object named ``module:attribute`` that is imported when it is first asked for.

    Parameters
    ----------
    kind : what the entries are, for messages, such as "community model".
    entries : id -> (dotted path, one line of description).
    """

    def __init__(self, kind: str, entries: Mapping[str, tuple[str, str]]) -> None:
        self.kind = kind
        self._entries = dict(entries)
        self._entries |= {one.name: (one.path, one.description) for one in _registered if one.kind == kind}
        _registries[kind] = self

    def __iter__(self) -> Iterator[str]:
        """Ids in the order in which they were entered."""
        return iter(tuple(self._entries))

    def ids(self) -> list[str]:
        return sorted(self._entries)

    def describe(self, name: str) -> str:
        return self._entries[name][1]

    def register(self, name: str, path: str, description: str) -> None:
        """Add a part.

        Parameters
        ----------
        name : that recipes use.
        path : ``module:attribute``, imported when the part is first used.
        description : one line.

        Raises
        ------
        RecipeError : the name is taken, or no name.
        """
        entry = Registration(self.kind, name, path, description)
        if entry in _registered:
            return
        if not _NAME.fullmatch(name):
            expected = "letters, digits and underscores, a letter first"
            raise RecipeError(f"no name for a {self.kind}", parameter="name", expected=expected, got=repr(name))
        if name in self._entries:
            problem = f"there is a {self.kind} of this name already"
            raise RecipeError(problem, parameter="name", expected="another name", got=repr(name))
        self._entries[name] = (path, description)
        _registered.append(entry)

    def load(self, name: str, *, where: str | None = None) -> Any:
        """The object behind `name`; an unknown name raises `RecipeError` that lists the valid ones."""
        self.check(name, where=where)
        module, _, attribute = self._entries[name][0].partition(":")
        return getattr(importlib.import_module(module), attribute)

    def check(self, name: str, *, where: str | None = None) -> None:
        """Raise `RecipeError` for an unknown name; imports nothing."""
        if name not in self._entries:
            near = difflib.get_close_matches(name, self._entries, n=1)
            raise RecipeError(
                f"unknown {self.kind}",
                where=where,
                expected="one of " + ", ".join(self.ids()),
                got=repr(name),
                hint=f"did you mean {near[0]!r}?" if near else None,
            )
