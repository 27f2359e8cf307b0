"""What dataset.json says of a data set; strange values left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class RecipeTold:
    """A recipe that images were drawn from."""

    file: str
    hash: str
    root_seed: str
    images: int  # that were asked for
    missing: tuple[tuple[int, int], ...]  # first and last image of each gap
    draws: Mapping[str, Any]  # key -> its distribution as written


@dataclass(frozen=True)
class Told:
    """The data set as it describes itself."""

    description: str = ""
    contributor: str = ""
    licence: str = ""
    splits: tuple[str, ...] = ()
    recipes: tuple[RecipeTold, ...] = ()
    made_with: tuple[str, ...] = ()  # versions, a text for each kind of machine
    bytes: int = 0  # of all files; 0: not known

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First and last image of each gap, over all recipes."""
        return [gap for recipe in self.recipes for gap in recipe.missing]

    @property
    def draws(self) -> dict[str, Any]:
        """Key -> distribution as written; of a key of several recipes the first one's."""
        return {key: value for recipe in reversed(self.recipes) for key, value in recipe.draws.items()}


def told_by_card(card: Mapping[str, Any]) -> Told:
    """From dataset.json."""
    licence = mapping(card.get("licence"))
    files = mapping(card.get("files")).values()
    return Told(
        description=str(card.get("description") or ""),
        contributor=str(card.get("contributor") or ""),
        licence=" ".join(str(licence[key]) for key in ("name", "url") if licence.get(key)),
        splits=tuple(str(name) for name in mapping(card.get("splits"))),
        recipes=tuple(_recipe(mapping(one)) for one in _items(card.get("recipes"))),
        made_with=tuple(_machine(mapping(one)) for one in _items(card.get("made_with"))),
        bytes=sum(_whole(mapping(one).get("bytes")) for one in files),
    )


def _recipe(told: Mapping[str, Any]) -> RecipeTold:
    gaps = [one for one in _items(told.get("missing")) if isinstance(one, list) and len(one) == 2]
    return RecipeTold(
        file=_text(told.get("file")),
        hash=_text(told.get("hash")),
        root_seed=_text(told.get("root_seed")),
        images=_whole(told.get("images")),
        missing=tuple((_whole(first), _whole(last)) for first, last in gaps),
        draws=mapping(told.get("draws")),
    )


def _machine(told: Mapping[str, Any]) -> str:
    platform = mapping(told.get("platform"))
    known = [f"{name} {version}" for name, version in sorted(mapping(told.get("packages")).items()) if version]
    python = [f"Python {told['python']}"] if told.get("python") else []
    where = " ".join(str(platform[key]) for key in ("system", "machine") if platform.get(key))
    return ", ".join([*filter(None, [where]), *python, *known])


def mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _whole(value: Any) -> int:
    return value if isinstance(value, int) and value >= 0 else 0


def gaps_text(gaps: list[tuple[int, int]], most: int = 12) -> str:
    """Gaps for people: 3, 17 to 19, ..."""
    named = [str(first) if first == last else f"{first} to {last}" for first, last in gaps[:most]]
    return ", ".join([*named, *(["..."] if len(gaps) > most else [])])
