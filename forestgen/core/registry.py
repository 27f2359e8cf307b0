"""Names of interchangeable parts, each a lazy dotted path: a listing imports nothing heavy."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping
from typing import Any

from forestgen.core.errors import RecipeError


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

    def ids(self) -> list[str]:
        return sorted(self._entries)

    def describe(self, name: str) -> str:
        return self._entries[name][1]

    def load(self, name: str, *, where: str | None = None) -> Any:
        """The object behind `name`; an unknown name raises `RecipeError` that lists the valid ones."""
        if name not in self._entries:
            near = difflib.get_close_matches(name, self._entries, n=1)
            raise RecipeError(
                f"unknown {self.kind}",
                where=where,
                expected="one of " + ", ".join(self.ids()),
                got=repr(name),
                hint=f"did you mean {near[0]!r}?" if near else None,
            )
        module, _, attribute = self._entries[name][0].partition(":")
        return getattr(importlib.import_module(module), attribute)
