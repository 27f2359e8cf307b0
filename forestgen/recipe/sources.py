"""Where each key of a recipe was written: a file's line, or an override, `` `set='key=value'` ``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Keys = tuple[str | int, ...]


@dataclass(frozen=True)
class Place:
    """A file and line (from 1), or an override if `line` is None."""

    origin: str
    line: int | None = None

    def __str__(self) -> str:
        return self.origin if self.line is None else f"{self.origin}:{self.line}"


def dotted(keys: Keys) -> str:
    """``("cameras", 0, "size_px")`` as ``cameras.0.size_px``, the way overrides write it."""
    return ".".join(str(key) for key in keys)


@dataclass
class SourceMap:
    """Place of every key path. A path that was never written lies where its nearest ancestor lies."""

    places: dict[Keys, Place] = field(default_factory=dict)

    def place(self, keys: Keys) -> Place:
        """Place of the longest written beginning of `keys`."""
        for n in range(len(keys), 0, -1):
            if keys[:n] in self.places:
                return self.places[keys[:n]]
        return self.places.get((), Place("recipe"))

    def where(self, keys: Keys) -> str:
        """``file:line: a.b.c``, or only the place for the recipe as a whole."""
        place = self.place(keys)
        return f"{place}: {dotted(keys)}" if keys else str(place)

    def drop(self, prefix: Keys) -> None:
        """Forget `prefix` and all below it."""
        n = len(prefix)
        for keys in [keys for keys in self.places if keys[:n] == prefix]:
            del self.places[keys]

    def set(self, keys: Keys, place: Place) -> None:
        self.places[keys] = place

    def take(self, other: SourceMap, source: Keys, target: Keys) -> None:
        """Copy the places of `other` at and below `source` to `target`."""
        n = len(source)
        for keys, place in list(other.places.items()):
            if keys[:n] == source:
                self.places[target + keys[n:]] = place


def copied(value: Any) -> Any:
    """A copy of plain data, mappings and lists and what is in them, several times as fast as `copy.deepcopy`."""
    if type(value) is dict:
        return {key: copied(item) for key, item in value.items()}
    if type(value) is list:
        return [copied(item) for item in value]
    return value
