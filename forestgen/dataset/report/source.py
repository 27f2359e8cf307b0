"""All that a report is made from: the data set's own files, and how its runs went. Strange values are left out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from forestgen.core.errors import RecipeError
from forestgen.dataset.index import INDEX_NAME
from forestgen.dataset.legend import FILE_NAME as LEGEND_NAME
from forestgen.dataset.png import class_palette
from forestgen.dataset.report.frames import Frames, no_frames, read_frames
from forestgen.dataset.report.run_log import RunLog, read_run
from forestgen.dataset.safe_path import SafePath, check_folder

_CARD_NAME, _RUN_NAME = "dataset.json", "run"
_RECIPE_TEXTS = ("file", "hash", "root_seed")


@dataclass(frozen=True)
class Legend:
    """Names and colours of the masks' classes."""

    classes: tuple[str, ...] = ()  # by number
    colours: dict[str, str] = field(default_factory=dict)  # class -> #rrggbb
    categories: tuple[str, ...] = ()  # of instances

    def colour(self, name: str) -> str:
        """Of a class, or of a species that is one; "" for others: the page's own."""
        return self.colours.get(name, "")


@dataclass(frozen=True)
class RecipeMetadata:
    """A recipe that images were drawn from."""

    file: str
    hash: str
    root_seed: str
    images: int  # that were asked for
    missing: tuple[tuple[int, int], ...]  # first and last image of each gap
    draws: Mapping[str, Any]  # key -> its distribution as written


@dataclass(frozen=True)
class Metadata:
    """The data set as dataset.json describes it."""

    description: str
    contributor: str
    licence: str
    splits: tuple[str, ...]
    recipes: tuple[RecipeMetadata, ...]
    made_with: tuple[str, ...]  # versions, a text for each kind of machine
    bytes: int  # of all files; 0: not known

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First and last image of each gap, over all recipes."""
        return [gap for recipe in self.recipes for gap in recipe.missing]

    @property
    def draws(self) -> dict[str, Any]:
        """Key -> distribution as written; of a key of several recipes the first one's."""
        return {key: value for recipe in reversed(self.recipes) for key, value in recipe.draws.items()}


@dataclass(frozen=True)
class Source:
    """A data set's folder, read."""

    folder: Path
    frames: Frames
    legend: Legend
    splits: tuple[str, ...]  # in the data set's order
    metadata: Metadata
    run: RunLog | None
    notes: tuple[str, ...] = ()  # of what could not be read


def open_source(folder: Path) -> Source:
    """Read a data set, finished or not.

    Raises
    ------
    RecipeError : there is no such folder, or it holds no data set.
    DatasetError : its index is damaged.
    """
    check_folder(folder, "a folder that forestgen render, batch or merge wrote")
    notes: list[str] = []
    card = _read_json(SafePath(folder, _CARD_NAME), notes)
    if os.path.lexists(folder / INDEX_NAME):
        frames = read_frames(folder / INDEX_NAME)
    elif card or (folder / _RUN_NAME).is_dir():
        frames = no_frames()
        notes.append("index.parquet is missing: the run has not ended, and can be resumed.")
    else:
        hint = "name a folder that forestgen render, batch or merge wrote"
        raise RecipeError("this is no data set of forestgen", where=str(folder), hint=hint)
    metadata = _metadata(card)
    splits = tuple(dict.fromkeys([*metadata.splits, *sorted(set(frames.split))]))
    return Source(folder, frames, _read_legend(folder, splits, notes), splits, metadata, read_run(folder), tuple(notes))


def _read_legend(folder: Path, splits: tuple[str, ...], notes: list[str]) -> Legend:
    """classes.json of the first split that has one: all splits have the same."""
    path = next((path for split in splits if (path := SafePath(folder, split) / LEGEND_NAME).is_file()), None)
    content = {} if path is None else _read_json(path, notes)
    names = _in_order(content.get("semantic"))
    colours = dict(zip(names, class_palette(len(names)).tolist(), strict=True))
    for key, rgb in _mapping(content.get("semantic_colours")).items():
        if _is_number(key) and int(key) < len(names) and _is_colour(rgb):
            colours[names[int(key)]] = rgb
    hexadecimal = {name: "#{:02x}{:02x}{:02x}".format(*rgb) for name, rgb in colours.items()}
    return Legend(names, hexadecimal, _in_order(content.get("categories")))


def _in_order(numbered: Any) -> tuple[str, ...]:
    if not isinstance(numbered, dict) or not all(map(_is_number, numbered)):
        return ()
    return tuple(str(numbered[key]) for key in sorted(numbered, key=int))


def _is_number(key: str) -> bool:
    return key.isdecimal() and len(key) < 10


def _is_colour(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(isinstance(v, int) and 0 <= v < 256 for v in value)


def _read_json(path: SafePath, notes: list[str]) -> dict[str, Any]:
    try:
        content = path.read_json()
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError):
        content = None
    if not isinstance(content, dict):
        notes.append(f"{path.name.rpartition('/')[2]} cannot be read.")
        return {}
    return content


def _metadata(card: Mapping[str, Any]) -> Metadata:
    licence = _mapping(card.get("licence"))
    return Metadata(
        description=str(card.get("description") or ""),
        contributor=str(card.get("contributor") or ""),
        licence=" ".join(str(licence[key]) for key in ("name", "url") if licence.get(key)),
        splits=tuple(str(name) for name in _mapping(card.get("splits"))),
        recipes=tuple(_recipe(_mapping(one)) for one in _items(card.get("recipes"))),
        made_with=tuple(_machine(_mapping(one)) for one in _items(card.get("made_with"))),
        bytes=sum(_whole(_mapping(one).get("bytes")) for one in _mapping(card.get("files")).values()),
    )


def _recipe(card: Mapping[str, Any]) -> RecipeMetadata:
    file, recipe_hash, root_seed = ("" if card.get(key) is None else str(card[key]) for key in _RECIPE_TEXTS)
    gaps = [one for one in _items(card.get("missing")) if isinstance(one, list) and len(one) == 2]
    missing = tuple((_whole(first), _whole(last)) for first, last in gaps)
    images, draws = _whole(card.get("images")), _mapping(card.get("draws"))
    return RecipeMetadata(file, recipe_hash, root_seed, images, missing, draws)


def _machine(card: Mapping[str, Any]) -> str:
    platform, packages = _mapping(card.get("platform")), _mapping(card.get("packages"))
    where = " ".join(str(platform[key]) for key in ("system", "machine") if platform.get(key))
    python = f"Python {card['python']}" if card.get("python") else ""
    versions = [f"{name} {version}" for name, version in sorted(packages.items()) if version]
    return ", ".join(filter(None, [where, python, *versions]))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _whole(value: Any) -> int:
    return value if isinstance(value, int) and value >= 0 else 0
