"""A check of the files over all frames, and a data set's folder as checks read it: the frames, the manifest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from forestgen.core.errors import RecipeError
from forestgen.dataset.check.files import Finding, UnreadableError, categories, read_json, read_recipe
from forestgen.dataset.check.frame_data import CAMERA, completed
from forestgen.dataset.safe_path import check_folder, is_frame

MANIFEST = "manifest.json"
UNKNOWN = "?"  # a following frame that is not known
_SCHEMA = "forestgen-manifest/"


@dataclass(frozen=True)
class Merged:
    """A data set's folder."""

    root: Path
    _lists: dict[str, dict[str, Any]] = field(default_factory=dict, repr=False)  # file -> content

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Folders of frames, those that are there and those that the manifest lists, sorted."""
        there = {path.name for path in self.root.iterdir() if is_frame(path.name) and path.is_dir()}
        listed = {name.partition("/")[0] for name in self.listed if "/" in name}
        return tuple(sorted(there | {name for name in listed if is_frame(name)}))

    @cached_property
    def listed(self) -> dict[str, dict[str, Any]]:
        """The manifest's files: path -> bytes and sha256; none where there is no manifest to read."""
        try:
            return dict(self.manifest["files"])
        except UnreadableError:
            return {}

    @cached_property
    def manifest(self) -> dict[str, Any]:
        manifest = read_json(self.root, MANIFEST)
        if not isinstance(manifest, dict) or not str(manifest.get("schema", "")).startswith(_SCHEMA):
            raise UnreadableError(Finding(MANIFEST, "this is no manifest of forestgen", expected=f"schema {_SCHEMA}1"))
        files = manifest.get("files")
        if not isinstance(files, dict) or not all(isinstance(entry, dict) for entry in files.values()):
            expected = "files: path -> bytes, sha256"
            raise UnreadableError(Finding(MANIFEST, "the manifest lists no files", expected=expected))
        return manifest

    def has(self, name: str) -> bool:
        """Whether a file is there, or should be."""
        return name in self.listed or os.path.lexists(self.root / name)

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What the first frame's drawn recipe says of labels; all frames agree on classes and species."""
        for name in self.frames[:-1]:
            try:
                return read_recipe(self.root, f"{name}/recipe.yaml")
            except UnreadableError:  # which the frame's own check names
                continue
        return read_recipe(self.root, f"{self.frames[-1]}/recipe.yaml")

    @property
    def category_names(self) -> list[str]:
        """Of instances, in order, by the recipe."""
        return categories(self.recipe)[0]

    def lists(self, file: str, *keys: str) -> dict[str, Any]:
        """A JSON mapping with lists of mappings under `keys`, read once."""
        if file not in self._lists:
            content = read_json(self.root, file)
            if not isinstance(content, dict):
                raise UnreadableError(Finding(file, "this is no data set's description", expected="a JSON mapping"))
            for key in keys:
                values = content.get(key)
                if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
                    problem = f"{key} is missing or no list"
                    raise UnreadableError(Finding(file, problem, expected="a list of mappings"))
            self._lists[file] = content
        return self._lists[file]


@dataclass(frozen=True)
class DatasetCheck:
    """An invariant of the files over all images."""

    name: str
    file: str  # that it is about
    applies: Callable[[Merged], bool]
    find: Callable[[Merged], Iterator[Finding]]

    def findings(self, merged: Merged) -> Iterator[Finding]:
        """What is wrong with a data set."""
        return completed(self.find(merged), self.name, self.file)


def dataset_check(
    name: str, file: str, when: Callable[[Merged], bool] | None = None
) -> Callable[[Callable[[Merged], Iterator[Finding]]], DatasetCheck]:
    """Turn a function into a `DatasetCheck` of data sets that have `file`, or for which `when` is true."""
    return lambda find: DatasetCheck(name, file, when or (lambda merged: merged.has(file)), find)


def folder_of(path: Any) -> str:
    """The frame's folder of a file's path."""
    return str(path).partition("/")[0]


def open_dataset(root: Path) -> Merged:
    """The folder of a data set; any other folder raises `RecipeError` with what it seems to be."""
    check_folder(root, "the folder of a split")
    merged = Merged(root)
    try:
        frames = merged.frames
        inside = sorted(path.name for path in root.iterdir() if (path / MANIFEST).is_file())
    except OSError as error:
        raise RecipeError(f"the folder cannot be read: {error.strerror}", where=str(root)) from error
    if frames:
        return merged
    raise RecipeError(
        "the folder holds no images of forestgen",
        where=str(root),
        expected="folders such as 000000-camera0, as in the folder of a split",
        got=_what_is_there(merged, inside),
        hint=f"{root / inside[0]}" if inside else None,
    )


def _what_is_there(merged: Merged, inside: list[str]) -> str:
    if (merged.root / "frame.exr").is_file():
        return "the folder of one frame: give the folder above it"
    if merged.listed:
        return "a forestgen output without images"
    if inside:
        return f"a folder of outputs, such as {inside[0]}"
    count = sum(1 for _ in merged.root.iterdir())
    return "nothing" if count == 0 else f"{count} other files or folders"


def following_frames(root: Path, frames: Sequence[str]) -> dict[str, str]:
    """Frame -> the sequence's next, for frames whose camera.json names a sequence; by image, then by time.

    Where a camera.json of an image cannot be read, what follows the others that seem last is `UNKNOWN`, and so is what
    follows a frame whose neighbour by number is not there.
    """
    members: dict[tuple[str, str], list[tuple[float, str]]] = {}
    unsure: set[str] = set()
    for frame in frames:
        image = frame.partition("-")[0]
        try:
            camera = read_json(root, f"{frame}/{CAMERA}")
            sequence = camera.get("sequence")
            if sequence is not None:
                time_s = float(camera.get("time_s", 0.0))
                members.setdefault((image, str(sequence)), []).append((time_s, frame))
        except (UnreadableError, AttributeError, TypeError, ValueError):
            unsure.add(image)
    following = {frame: UNKNOWN for frame in frames if frame.partition("-")[0] in unsure}
    for way in members.values():
        pairs = pairwise(name for _, name in sorted(way))
        following |= {one: UNKNOWN if _is_gap(one, other) else other for one, other in pairs}
    return following


def _is_gap(one: str, other: str) -> bool:
    """Whether numbers are left out between two frames' names, NAME-0000, NAME-0001, ..."""
    numbers = [name.rpartition("-")[2] for name in (one, other)]
    return all(map(str.isdecimal, numbers)) and int(numbers[1]) != int(numbers[0]) + 1
