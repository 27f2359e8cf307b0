"""What all formats share: the shard of a frame, the file over all frames, and its pictures' places.

A shard is a JSON file in the frame's folder. A merge reads one shard at a time, in the order of the folders' names, and
writes its file from front to back, so memory holds one frame. The file appears under its name when it is complete.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, get_args, get_origin

from forestgen.core.errors import OutputError, output_error
from forestgen.dataset.files import write_bytes
from forestgen.dataset.safe_path import SafePath, load_json
from forestgen.dataset.settings import DatasetSettings

_REMEDY = "a worker may have stopped early: make this frame again"


def json_text(content: Any) -> str:
    """JSON on one line with sorted keys; NaN and infinities, which JSON lacks, raise `ValueError`."""
    return json.dumps(content, sort_keys=True, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def finite(value: float) -> float | None:
    """The number, or None, JSON's null, where it is NaN or infinite: unknown."""
    return float(value) if math.isfinite(value) else None


def write_shard(path: Path, content: Mapping[str, Any]) -> None:
    """Write a frame's share of a format; a failure raises `OutputError`."""
    write_bytes(path, (json_text(content) + "\n").encode())


def read_shard(path: Path, types: Mapping[str, type]) -> dict[str, Any]:
    """A frame's share of a format; a file that is missing, cut short, or none of this format raises `OutputError`.

    `types` are those of the values that it must hold, by key: dict, int, list[dict], list[str].
    """
    try:
        content = load_json(read_bytes(path))
    except ValueError as error:
        raise damaged(path, str(error)) from error
    for key, kind in types.items():
        value: Any = content.get(key) if isinstance(content, dict) else None
        items = [get_origin(item) or item for item in get_args(kind)]
        is_one = isinstance(value, get_origin(kind) or kind)
        if not is_one or not all(isinstance(one, item) for item in items for one in value):
            texts = {"expected": f"{key}: {kind}", "got": json_text(content)[:80], "hint": _REMEDY}
            raise OutputError("a frame's labels are not of this format", where=str(path), **texts)
    return dict(content)


def read_bytes(path: Path) -> bytes:
    """A frame's share of a format as it is; one that is missing or cannot be read raises `OutputError`."""
    try:
        return SafePath(path.parent, path.name).read()
    except FileNotFoundError as error:
        raise OutputError("a frame lacks its share of the labels", where=str(path), hint=_REMEDY) from error
    except OSError as error:
        raise OutputError(f"cannot read: {error.strerror or error}", where=str(path), hint=_REMEDY) from error


def damaged(path: Path, got: str | None = None) -> OutputError:
    """The error of a share that is there and is no whole one."""
    return OutputError("a frame's labels are cut short or damaged", where=str(path), got=got, hint=_REMEDY)


def in_order(folders: Iterable[Path | str]) -> list[str]:
    """Names of the frames' folders, sorted, each once."""
    return sorted({Path(folder).name for folder in folders})


def numbering(settings: DatasetSettings) -> dict[str, list[str]]:
    """What numbers the categories, for a shard: the species, and the category of each where it is another."""
    species = list(settings.species_names)
    categories = [settings.category_names[index] for index in settings.species_category]
    return {"species": species} if categories == species else {"species": species, "categories": categories}


def read_frame(path: Path, types: Mapping[str, type], settings: DatasetSettings) -> dict[str, Any]:
    """As `read_shard`, of a frame whose `numbering` must be the data set's."""
    shard = read_shard(path, {**types, "species": list[str]})
    wanted = numbering(settings)
    for key, what in (("species", "species"), ("categories", "labels.classes")):
        expected, got = wanted.get(key, wanted["species"]), shard.get(key, shard["species"])
        if got != expected:
            texts = {"expected": ", ".join(expected), "got": ", ".join(map(str, got))}
            raise OutputError(f"frames of one dataset must share their {what}", where=str(path), **texts)
    return shard


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[str]]:
    """A text file to write, which takes its name when all is written; after a failure nothing is left of it."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("w", encoding="utf-8", newline="\n") as stream:
            yield stream
        partial.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise output_error(error, path) from error
        raise


def write_list(stream: IO[str], items: Iterable[Any]) -> None:
    """Write items as they come as a JSON list, one a line."""
    start = "["
    for item in items:
        stream.write(start + "\n" + json_text(item))
        start = ","
    stream.write("[]" if start == "[" else "\n]")


def place(source: Path, target: Path) -> None:
    """Give a file a second place: a hard link, or a copy where the file system has no links; see `OutputError`."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        if not source.is_file():
            raise OutputError("a frame lacks a file", where=str(source), hint=_REMEDY)
        try:
            os.link(source, target)
        except OSError:
            shutil.copyfile(source, target)
    except OSError as error:
        raise output_error(error, target) from error
