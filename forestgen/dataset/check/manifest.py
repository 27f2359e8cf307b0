"""Files that are listed and named: manifest.json's list, and the names of classes and parts in three places."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from forestgen.core.parts import Part
from forestgen.dataset.check.files import Finding, UnreadableError, class_names, finding, read_json, read_palette
from forestgen.dataset.check.frame_data import (
    CAMERA,
    EXR,
    INSTANCE,
    PLANTS,
    RECIPE,
    SEMANTIC,
    FrameData,
    frame_check,
)
from forestgen.dataset.check.merged import MANIFEST, Merged, dataset_check
from forestgen.dataset.safe_path import SafePath, load_json

_ALWAYS = (EXR, SEMANTIC, PLANTS, CAMERA, RECIPE, "preview.png", "overlay.png")
_PICTURES = (INSTANCE, SEMANTIC, "preview.png", "overlay.png")
_LEGEND = "classes.json"
_CLASSES, _PARTS = "forestgen/classes", "forestgen/parts"


@frame_check("files", "")
def files(frame: FrameData) -> Iterator[Finding]:
    """All files of the frame are there and can be read."""
    for name in frame.task.listed:
        if not SafePath(frame.task.root, name).is_file():
            yield finding("the file is missing", "a file, as manifest.json lists it", file=name)
    for name in _ALWAYS:
        if frame.file(name) not in frame.task.listed and not frame.has(name):
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
    listed = frame.file(INSTANCE) in frame.task.listed
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
        text = read_palette(frame.task.root, frame.file(SEMANTIC))[1].get("classes")
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
