"""A data set's folder as checks read it, and checks of the files over all frames: what is listed, and what is named.

Names of classes and parts are in three places, which must agree.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.dataset.check.files import (
    Finding,
    UnreadableError,
    categories,
    class_names,
    finding,
    read_json,
    read_palette,
    read_recipe,
)
from forestgen.dataset.check.frame_data import (
    CAMERA,
    EXR,
    INSTANCE,
    PLANTS,
    RECIPE,
    SEMANTIC,
    FrameData,
    completed,
    frame_check,
)
from forestgen.dataset.safe_path import SafePath, is_frame, load_json

MANIFEST, _LEGEND = "manifest.json", "classes.json"
UNKNOWN = "?"  # a following frame that is not known
_SCHEMA = "forestgen-manifest/"
_ALWAYS = (EXR, SEMANTIC, PLANTS, CAMERA, RECIPE, "preview.png", "overlay.png")
_PICTURES = (INSTANCE, SEMANTIC, "preview.png", "overlay.png")
_CLASSES, _PARTS = "forestgen/classes", "forestgen/parts"


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
    """A split's folder; one that cannot be read, or holds no frames, raises `RecipeError`."""
    merged = Merged(root)
    try:
        if merged.frames:
            return merged
    except OSError as error:
        raise RecipeError(f"the folder cannot be read: {error.strerror}", where=str(root)) from error
    expected = "folders such as 000000-camera0"
    raise RecipeError("the folder holds no images of forestgen", where=str(root), expected=expected)


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
        for one, other in pairwise(name for _, name in sorted(way)):
            numbers = [name.rpartition("-")[2] for name in (one, other)]  # of names such as NAME-0000, NAME-0001, ...
            is_gap = all(map(str.isdecimal, numbers)) and int(numbers[1]) != int(numbers[0]) + 1
            following[one] = UNKNOWN if is_gap else other
    return following


@frame_check("files", "")
def files(frame: FrameData) -> Iterator[Finding]:
    """All files of the frame are there and can be read."""
    for name in frame.listed:
        if not SafePath(frame.root, name).is_file():
            yield finding("the file is missing", "a file, as manifest.json lists it", file=name)
    for name in _ALWAYS:
        if frame.file(name) not in frame.listed and not frame.has(name):
            yield finding("the file is missing", "a file in each frame's folder", file=frame.file(name))
    # Each of these reads a file and refuses one that is cut short, of another kind or of another size.
    for attribute in ("exr", "plants", "camera", "recipe"):
        yield from _refused(lambda name: getattr(frame, name), attribute)
    yield from _refused(_check_ids_fit, frame)
    for name in _PICTURES:
        if frame.has(name):
            yield from _refused(frame.picture, name)


def _check_ids_fit(frame: FrameData) -> None:
    """instance.png may be missing only where an id does not fit its 24 bits."""
    listed = frame.file(INSTANCE) in frame.listed
    if not frame.has(INSTANCE) and not listed and int(frame.instance.max(initial=0)) < 1 << 24:
        raise frame.refused(INSTANCE, "there is no instance.png", "one: all ids fit it")


def _refused(read: Callable[[Any], object], what: Any) -> Iterator[Finding]:
    try:
        read(what)
    except UnreadableError as error:
        if error.finding.problem != "the file is missing":  # which is reported already
            yield error.finding


@dataset_check("manifest", MANIFEST, when=lambda _: True)
def listing(merged: Merged) -> Iterator[Finding]:
    """The manifest can be read, lists all frames, and the files beside the frames' folders are there."""
    listed = merged.manifest["files"]
    folders = {name.partition("/")[0] for name in listed if "/" in name}
    for name in merged.frames:
        if name not in folders:
            yield finding("a frame's folder is not in the manifest", "a folder of the same run", name, image=name)
    for name in sorted(listed):
        if name.partition("/")[0] not in merged.frames and not SafePath(merged.root, name).is_file():
            yield finding("the file is missing", "a file, as manifest.json lists it", file=name)


@dataset_check("classes.json", _LEGEND)
def legend(merged: Merged) -> Iterator[Finding]:
    """Names follow from the recipe; colours are the first image's."""
    content = read_json(merged.root, _LEGEND)
    names = class_names(merged.recipe)
    try:
        colours, _ = read_palette(merged.root, f"{merged.frames[0]}/{SEMANTIC}")
        triples = _numbered([colours[3 * i : 3 * i + 3] for i in range(len(names))])
    except UnreadableError:  # which the frame's own check says
        triples = content["semantic_colours"]
    for key, expected in (
        ("semantic", _numbered(names)),
        ("semantic_colours", triples),
        ("part", _part_names()),
        ("categories", _numbered(merged.category_names, 1)),
    ):
        if content[key] != expected:
            yield finding(f"{key}: not the recipe's, or not semantic.png's", _text(expected), _text(content[key]))


@frame_check("names", SEMANTIC, when=lambda frame: _CLASSES in frame.exr_header)
def names(frame: FrameData) -> Iterator[Finding]:
    """The names inside the files are the recipe's classes, and the parts."""
    header, classes = frame.exr_header, _numbered(class_names(frame.recipe))
    texts = [(EXR, _CLASSES, header[_CLASSES], classes), (EXR, _PARTS, header.get(_PARTS), _part_names())]
    if frame.has(SEMANTIC):
        text = read_palette(frame.root, frame.file(SEMANTIC))[1].get("classes")
        texts.append((SEMANTIC, "the text classes", text, classes))
    for file, key, text, expected in texts:
        if text is None or load_json(text) != expected:
            yield finding(f"{key}: not the names of the numbers", _text(expected), text, file=frame.file(file))


def _part_names() -> dict[str, Any]:
    return _numbered([part.name.lower() for part in Part])


def _numbered(values: Sequence[Any], first: int = 0) -> dict[str, Any]:
    return {str(number): value for number, value in enumerate(values, first)}


def _text(content: Any) -> str:
    return json.dumps(content)[:300]
