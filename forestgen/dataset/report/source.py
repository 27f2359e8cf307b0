"""All that a report is made from, opened: the data set's own files, and how its runs went."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from forestgen.core.errors import RecipeError
from forestgen.dataset.index import INDEX_NAME
from forestgen.dataset.legend import FILE_NAME as LEGEND_NAME
from forestgen.dataset.png import class_palette
from forestgen.dataset.report.frames import Frames, frames_of, read_frames
from forestgen.dataset.report.run_log import RunLog, read_run
from forestgen.dataset.report.told import Told, mapping, told_by_card
from forestgen.dataset.safe_path import SafePath, check_folder

CARD_NAME, RUN_NAME = "dataset.json", "run"


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
class Source:
    """A data set's folder, read."""

    folder: Path
    frames: Frames
    legend: Legend
    splits: tuple[str, ...]  # in the data set's order
    told: Told  # of itself
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
    card = _read_json(SafePath(folder, CARD_NAME), notes)
    if os.path.lexists(folder / INDEX_NAME):
        frames = read_frames(folder / INDEX_NAME)
    elif card or (folder / RUN_NAME).is_dir():
        frames = frames_of([])
        notes.append("index.parquet is missing: the run has not ended, and can be resumed.")
    else:
        hint = "name a folder that forestgen render, batch or merge wrote"
        raise RecipeError("this is no data set of forestgen", where=str(folder), hint=hint)
    told = told_by_card(card)
    splits = tuple(dict.fromkeys([*told.splits, *sorted(set(frames.split))]))
    return Source(folder, frames, read_legend(folder, splits, notes), splits, told, read_run(folder), tuple(notes))


def read_legend(folder: Path, splits: tuple[str, ...], notes: list[str]) -> Legend:
    """classes.json of the first split that has one: all splits have the same."""
    for split in splits:
        path = SafePath(folder, split) / LEGEND_NAME
        if path.is_file():
            return _legend(_read_json(path, notes))
    return Legend()


def _legend(content: dict[str, Any]) -> Legend:
    names = _in_order(content.get("semantic"))
    colours = {}
    for key, rgb in mapping(content.get("semantic_colours")).items():
        if _is_number(key) and int(key) < len(names) and _is_colour(rgb):
            colours[names[int(key)]] = "#{:02x}{:02x}{:02x}".format(*rgb)
    for name, rgb in zip(names, class_palette(len(names)).tolist(), strict=True):
        colours.setdefault(name, "#{:02x}{:02x}{:02x}".format(*rgb))
    return Legend(names, colours, _in_order(content.get("categories")))


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
