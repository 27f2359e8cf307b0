"""The data set to pack: its splits, the frames that its index.parquet lists, and their classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError, RecipeError
from forestgen.dataset.index import INDEX_NAME, whole_index
from forestgen.dataset.index_values import plain_rows
from forestgen.dataset.legend import FILE_NAME as CLASSES_FILE
from forestgen.dataset.legend import read_legend
from forestgen.dataset.pack.channels import read_json
from forestgen.dataset.safe_path import SafePath

LAST_FILE = "dataset.json"  # that a run writes


@dataclass(frozen=True)
class Split:
    """A part of the data set."""

    name: str
    folder: SafePath
    frames: tuple[str, ...]  # names of the frames' folders, sorted


@dataclass(frozen=True)
class Source:
    """A data set that was found to be one."""

    root: Path
    splits: tuple[Split, ...]
    classes: Mapping[str, Any]  # classes.json, the same in all splits
    index: Any  # pyarrow.Table of index.parquet, a few hundred bytes a frame
    row_numbers: Mapping[str, int]  # frame -> row of the index

    @property
    def frames(self) -> int:
        return sum(len(split.frames) for split in self.splits)

    def row(self, frame: str) -> dict[str, Any]:
        """A frame's row of the index."""
        return plain_rows(self.index.slice(self.row_numbers[frame], 1), self.root / INDEX_NAME)[0]


def open_source(root: Path, splits: Sequence[str] = ()) -> Source:
    """Look at a data set before it is packed.

    Parameters
    ----------
    root : its folder, which `Dataset` has checked.
    splits : those to pack, by default all.

    Raises
    ------
    DatasetError : a file of it is missing or damaged.
    RecipeError : the data set has no such split.
    """
    index = whole_index(root / INDEX_NAME)
    names = list(zip(index["split"].to_pylist(), index["frame"].to_pylist(), strict=True))
    told = read_json(SafePath(root, LAST_FILE)).get("splits")
    order = list(told) if isinstance(told, dict) else []  # the recipe's
    frames: dict[str, list[str]] = {}
    for split, frame in names:
        frames.setdefault(split, []).append(frame)
    for name in splits:
        if name not in frames:
            raise RecipeError(
                "the data set has no such split",
                parameter="splits",
                expected="of " + ", ".join(sorted(frames)),
                got=name,
            )
    chosen = sorted(set(splits) or frames, key=lambda name: (order.index(name) if name in order else len(order), name))
    found = tuple(Split(name, SafePath(root, name), tuple(sorted(frames[name]))) for name in chosen)
    if not found:
        raise DatasetError("the data set has no frame", where=str(root))
    numbers = {frame: number for number, (_, frame) in enumerate(names)}
    return Source(root, found, _common_classes(found), index, numbers)


def _common_classes(splits: Sequence[Split]) -> dict[str, Any]:
    classes = read_legend(splits[0].folder)
    for split in splits[1:]:
        if read_json(split.folder / CLASSES_FILE) != classes:
            raise DatasetError(
                "splits differ in the numbers of their classes",
                where=str(split.folder / CLASSES_FILE),
                expected=f"the same as in {splits[0].name}",
                hint="pack them one by one, with `splits`",
            )
    return classes
