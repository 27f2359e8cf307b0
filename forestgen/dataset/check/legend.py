"""classes.json, and the names in semantic.png and frame.exr: the recipe's, and the parts'."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from forestgen.core.parts import Part
from forestgen.dataset.check.files import read_json, read_palette
from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.check.frame_data import EXR, SEMANTIC, FrameData
from forestgen.dataset.check.merged import Merged
from forestgen.dataset.check.recipe import class_names
from forestgen.dataset.safe_path import load_json

FILE = "classes.json"
_CLASSES, _PARTS = "forestgen/classes", "forestgen/parts"


def has_legend(merged: Merged) -> bool:
    return merged.has(FILE)


def legend(merged: Merged) -> Iterator[Finding]:
    """Names follow from the recipe; colours are the first image's."""
    content = read_json(merged.root, FILE)
    names = class_names(merged.recipe)
    try:
        colours, _ = read_palette(merged.root, f"{merged.frames[0]}/{SEMANTIC}")
        triples = _numbered([colours[3 * i : 3 * i + 3] for i in range(len(names))])
    except UnreadableError:  # which the frame's own check says
        triples = content["semantic_colours"]
    for key, expected in (
        ("semantic", _numbered(names)),
        ("semantic_colours", triples),
        ("part", _numbered([part.name.lower() for part in Part])),
        ("categories", _numbered(merged.category_names, 1)),
    ):
        if content[key] != expected:
            yield Finding(FILE, f"{key}: not the recipe's, or not semantic.png's", _text(expected), _text(content[key]))


def has_names(frame: FrameData) -> bool:
    return _CLASSES in frame.exr_header


def names(frame: FrameData) -> Iterator[Finding]:
    """The names inside the files are the recipe's classes, and the parts."""
    classes = _numbered(class_names(frame.recipe))
    told = [(EXR, _CLASSES, frame.exr_header[_CLASSES], classes)]
    told.append((EXR, _PARTS, frame.exr_header.get(_PARTS), _numbered([part.name.lower() for part in Part])))
    if frame.has(SEMANTIC):
        told.append((SEMANTIC, "the text classes", _picture_text(frame), classes))
    for file, key, text, expected in told:
        if text is None or load_json(text) != expected:
            yield frame.finding(file, f"{key}: not the names of the numbers", expected=_text(expected), got=str(text))


def _picture_text(frame: FrameData) -> str | None:
    return read_palette(frame.task.root, frame.file(SEMANTIC))[1].get("classes")


def _numbered(values: Sequence[Any], first: int = 0) -> dict[str, Any]:
    return {str(number): value for number, value in enumerate(values, first)}


def _text(content: Any) -> str:
    return json.dumps(content)[:300]
