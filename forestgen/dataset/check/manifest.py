"""Files that are listed and named: manifest.json's sums, and the names of classes and parts in three places."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from forestgen.core.parts import Part
from forestgen.dataset.check.check import dataset_check, frame_check
from forestgen.dataset.check.files import class_names, read_json, read_palette
from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.check.frame_data import CAMERA, EXR, INSTANCE, PLANTS, RECIPE, SEMANTIC, FrameData
from forestgen.dataset.check.merged import MANIFEST, Merged
from forestgen.dataset.safe_path import SafePath, load_json

_ALWAYS = (EXR, SEMANTIC, PLANTS, CAMERA, RECIPE, "preview.png", "overlay.png")
_PICTURES = (INSTANCE, SEMANTIC, "preview.png", "overlay.png")
_LEGEND = "classes.json"
_CLASSES, _PARTS = "forestgen/classes", "forestgen/parts"


@frame_check("files", "all files are there and readable", "")
def files(frame: FrameData) -> Iterator[Finding]:
    """All files of the frame are there and can be read."""
    for name in frame.task.listed:
        if not SafePath(frame.task.root, name).is_file():
            yield Finding(name, "the file is missing", expected="a file, as manifest.json lists it", image=frame.name)
    for name in _ALWAYS:
        if frame.file(name) not in frame.task.listed and not frame.has(name):
            yield frame.finding(name, "the file is missing", expected="a file in each frame's folder")
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
        raise UnreadableError(frame.finding(INSTANCE, "there is no instance.png", expected="one: all ids fit it"))


def _refused(read: Callable[[Any], object], what: Any) -> Iterator[Finding]:
    try:
        read(what)
    except UnreadableError as error:
        if error.finding.problem != "the file is missing":  # which is reported already
            yield error.finding


@dataset_check("manifest", "lists the frames and their files", MANIFEST, when=lambda _: True)
def listing(merged: Merged) -> Iterator[Finding]:
    """The manifest can be read, lists all frames, and the files beside the frames' folders are there."""
    listed = merged.manifest["files"]
    folders = {name.partition("/")[0] for name in listed if "/" in name}
    for name in merged.frames:
        if name not in folders:
            problem = "a frame's folder is not in the manifest"
            yield Finding(MANIFEST, problem, expected="a folder of the same run", got=name, image=name)
    for name in _shared_files(merged):
        if not SafePath(merged.root, name).is_file():
            yield Finding(name, "the file is missing", expected="a file, as manifest.json lists it")


def _shared_files(merged: Merged) -> list[str]:
    """Listed files that are not in a frame's folder."""
    frames = set(merged.frames)
    return [name for name in sorted(merged.listed) if name.partition("/")[0] not in frames]


@frame_check("hashes", "files are those that manifest.json lists", "", when=lambda frame: bool(frame.task.listed))
def frame_hashes(frame: FrameData) -> Iterator[Finding]:
    """SHA-256 of the frame's files."""
    for name in sorted(frame.task.listed):
        yield from _hash(frame.task.root, name, frame.task.listed[name], frame.name)


@dataset_check("shared hashes", "files are those that manifest.json lists", "", when=lambda _: True)
def shared_hashes(merged: Merged) -> Iterator[Finding]:
    """SHA-256 of the files beside the frames' folders."""
    for name in _shared_files(merged):
        yield from _hash(merged.root, name, merged.listed[name], "")


def _hash(root: Path, name: str, entry: Any, image: str) -> Iterator[Finding]:
    path = SafePath(root, name)
    try:
        size = path.size_bytes()
        if size != entry.get("bytes"):
            expected, got = f"{entry.get('bytes')} bytes", f"{size}"
            yield Finding(name, "the file's size is not manifest.json's", expected, got, image)
            return
        with path.open() as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        yield Finding(name, "the file cannot be read", got=error.strerror or str(error), image=image)
        return
    if digest != entry.get("sha256"):
        got = f"sha256 {digest}"
        yield Finding(name, "the file is not the one that manifest.json lists", f"{entry.get('sha256')}", got, image)


@dataset_check("classes.json", "names follow from the recipe", _LEGEND)
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
            problem = f"{key}: not the recipe's, or not semantic.png's"
            yield Finding(_LEGEND, problem, _text(expected), _text(content[key]))


@frame_check("names", "numbers have the recipe's names", SEMANTIC, when=lambda frame: _CLASSES in frame.exr_header)
def names(frame: FrameData) -> Iterator[Finding]:
    """The names inside the files are the recipe's classes, and the parts."""
    header, classes = frame.exr_header, _numbered(class_names(frame.recipe))
    texts = [(EXR, _CLASSES, header[_CLASSES], classes), (EXR, _PARTS, header.get(_PARTS), _part_names())]
    if frame.has(SEMANTIC):
        text = read_palette(frame.task.root, frame.file(SEMANTIC))[1].get("classes")
        texts.append((SEMANTIC, "the text classes", text, classes))
    for file, key, text, expected in texts:
        if text is None or load_json(text) != expected:
            yield frame.finding(file, f"{key}: not the names of the numbers", expected=_text(expected), got=str(text))


def _part_names() -> dict[str, Any]:
    return _numbered([part.name.lower() for part in Part])


def _numbered(values: Sequence[Any], first: int = 0) -> dict[str, Any]:
    return {str(number): value for number, value in enumerate(values, first)}


def _text(content: Any) -> str:
    return json.dumps(content)[:300]
