"""manifest.json: every file that it lists is there and has its bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from forestgen.dataset.check.finding import Finding, UnreadableError
from forestgen.dataset.check.frame_data import CAMERA, EXR, INSTANCE, PLANTS, RECIPE, SEMANTIC, FrameData
from forestgen.dataset.check.merged import MANIFEST, Merged
from forestgen.dataset.safe_path import SafePath

_ALWAYS = (EXR, SEMANTIC, PLANTS, CAMERA, RECIPE, "preview.png", "overlay.png")
_PICTURES = (INSTANCE, SEMANTIC, "preview.png", "overlay.png")


def files(frame: FrameData) -> Iterator[Finding]:
    """All files of the frame are there and can be read."""
    for name in frame.task.listed:
        if not SafePath(frame.task.root, name).is_file():
            yield Finding(name, "the file is missing", expected="a file, as manifest.json lists it", image=frame.name)
    for name in _ALWAYS:
        if frame.file(name) not in frame.task.listed and not frame.has(name):
            yield frame.finding(name, "the file is missing", expected="a file in each frame's folder")
    # Each of these reads a file and refuses one that is cut short, of another kind or of another size.
    yield from _refused(lambda: frame.exr)
    yield from _refused(lambda: frame.plants)
    yield from _refused(lambda: frame.camera)
    yield from _refused(lambda: frame.recipe)
    yield from _refused(lambda: _wide_ids(frame))
    for name in _PICTURES:
        if frame.has(name):
            yield from _refused(lambda name=name: frame.picture(name))


def _wide_ids(frame: FrameData) -> None:
    """instance.png may be missing only where an id does not fit its 24 bits."""
    listed = frame.file(INSTANCE) in frame.task.listed
    if not frame.has(INSTANCE) and not listed and int(frame.instance.max(initial=0)) < 1 << 24:
        raise UnreadableError(frame.finding(INSTANCE, "there is no instance.png", expected="one: all ids fit it"))


def _refused(read: Any) -> Iterator[Finding]:
    try:
        read()
    except UnreadableError as error:
        if error.finding.problem != "the file is missing":  # which is said already
            yield error.finding


def listing(merged: Merged) -> Iterator[Finding]:
    """The manifest can be read, lists all frames, and the files beside the frames' folders are there."""
    listed = merged.manifest["files"]
    folders = {name.partition("/")[0] for name in listed if "/" in name}
    for name in merged.frames:
        if name not in folders:
            problem = "a frame's folder is not in the manifest"
            yield Finding(MANIFEST, problem, expected="a folder of the same run", got=name, image=name)
    for name in shared_files(merged):
        if not SafePath(merged.root, name).is_file():
            yield Finding(name, "the file is missing", expected="a file, as manifest.json lists it")


def shared_files(merged: Merged) -> list[str]:
    """Listed files that are not in a frame's folder."""
    frames = set(merged.frames)
    return [name for name in sorted(merged.listed) if name.partition("/")[0] not in frames]


def frame_hashes(frame: FrameData) -> Iterator[Finding]:
    """SHA-256 of the frame's files."""
    for name in sorted(frame.task.listed):
        yield from _hash(frame.task.root, name, frame.task.listed[name], frame.name)


def shared_hashes(merged: Merged) -> Iterator[Finding]:
    """SHA-256 of the files beside the frames' folders."""
    for name in shared_files(merged):
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
