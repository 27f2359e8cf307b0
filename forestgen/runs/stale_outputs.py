"""Finished images that a run does not keep.

Those that are too many, or that the recipe would make otherwise now, are removed only after confirmation. Those whose
files are not as they were written are made again. In a folder every file is read and compared with the SHA-256 of its
image's record; in an object store, which keeps sums of its own, one listing shows which objects are missing or have
another size. A thumbnail, or a map that the recipe names, is written again without rendering.
"""

from __future__ import annotations

import errno
import hashlib
import reprlib
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

from forestgen.community.resume import differences
from forestgen.core.errors import ForestgenError, OutputError, RecipeError
from forestgen.core.threads import cores
from forestgen.dataset.check.files import UnreadableError
from forestgen.dataset.manifest import file_sum
from forestgen.dataset.png import THUMBNAILS, write_thumbnail
from forestgen.dataset.safe_path import RefusedFileError, SafePath
from forestgen.recipe.assets import MAPS
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import JobRecord, StorageBackend
from forestgen.runs.finish import recipe_part
from forestgen.runs.folder import images_in_frames, is_made_from
from forestgen.runs.records import done_keys, image_of_key, in_order, job_key, records_of
from forestgen.runs.storage import LocalStorage, unreadable_storage
from forestgen.runs.verify_index import plain_yaml

_MOST_CHANGES = 4  # that are named
_MANY = 1000  # images whose comparison takes long enough to say so
_LEAST_THREADS = 8  # a network share answers slowly, but many requests at a time
_REPORT_EVERY_S = 10.0
_MOST_NAMED = 20
_GONE = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)


@dataclass(frozen=True)
class ResumeDiff:
    """The finished images of a batch, as a run with another recipe or count would find them."""

    kept: int
    beyond: int  # whose numbers are not among the images that are wanted
    stale: frozenset[int]  # that the recipe, or these versions, would make otherwise now
    unrecorded: int = 0  # that have frames and no record, and that this run would not make again as they are
    changes: str = ""  # what the recipe says otherwise than the data set's own, as far as that is known

    @property
    def discarded(self) -> int:
        """How many would be thrown away."""
        return self.beyond + len(self.stale) + self.unrecorded

    def reasons(self) -> str:
        """Why, for people."""
        other = "made from another recipe, for another split, or by other versions"
        parts = [
            (self.beyond, "beyond the images that are asked for now"),
            (len(self.stale), other + (f" ({self.changes})" if self.changes else "")),
            (self.unrecorded, "that have lost their records, by which they are recognised"),
        ]
        return "; ".join(f"{number:,} {reason}" for number, reason in parts if number)


def resume_diff(
    storage: StorageBackend, loaded: LoadedRecipe, images: range, mark: str, versions: str, say: Callable[[str], None]
) -> ResumeDiff:
    """Compare the finished images with what is wanted now; removes nothing.

    `images`: numbers of the images that are wanted.
    `mark`, `versions`: see `folder.fingerprint`.
    `say`: called if it takes a while: of a recipe that has changed, each finished image is drawn again.
    """
    keys = done_keys(storage)
    mine = {image: key for key in keys if (image := image_of_key(key)) in images}
    recorded = {image_of_key(key) for key in keys}
    beyond = len(recorded - mine.keys())
    unrecorded = images_in_frames(storage, loaded.splits) - recorded
    if is_made_from(storage, mark):
        return ResumeDiff(len(mine), beyond, frozenset(), len(unrecorded.difference(images)))
    if len(mine) >= _MANY:
        say(f"comparing {len(mine):,} finished images with the recipe, which has changed")

    def key(image: int) -> str:
        """Of an image as it would be made now; "" if it cannot be drawn."""
        try:
            return job_key(loaded.draw(image - images.start), versions)
        except ForestgenError:
            return ""

    stale = frozenset(image for image in mine if key(image) not in keys)
    changes = _changes(storage, loaded) if stale else ""
    return ResumeDiff(len(mine) - len(stale), beyond, stale, len(unrecorded), changes)


def check_stale_outputs(found: ResumeDiff, where: str, *, agreed: bool) -> None:
    """Refuse to remove finished images without confirmation.

    Raises `RecipeError` if images would be removed and `agreed` is False.
    """
    if found.discarded and not agreed:
        problem = f"this would throw away {found.discarded:,} of {found.kept + found.discarded:,} finished images"
        expected = "the recipe, the numbers of images and the versions that the batch was begun with, or more images"
        hint = "`discard=True` agrees to it; or choose another folder"
        raise RecipeError(problem, where=where, expected=expected, got=found.reasons(), hint=hint)


def _changes(storage: StorageBackend, loaded: LoadedRecipe) -> str:
    """What the recipe says otherwise than recipe.yaml of the data set; "" where neither can tell."""
    try:
        before = plain_yaml((storage.read("recipe.yaml") or b"").decode(), "")
        now = plain_yaml(recipe_part(loaded, ()).yaml, "")
    except (ForestgenError, UnreadableError, UnicodeDecodeError):
        return ""
    for content in (before, now):
        content.pop("images", None)
        content.pop("first_image", None)
    found = sorted(differences(before, now), key=lambda one: one.key)
    more = f"; {len(found) - _MOST_CHANGES} more" if len(found) > _MOST_CHANGES else ""
    named = (
        f"{one.key:.60} was {reprlib.repr(one.before)}, is now {reprlib.repr(one.now)}" for one in found[:_MOST_CHANGES]
    )
    return "; ".join(named) + more


def damaged_images(
    storage: StorageBackend, loaded: LoadedRecipe, images: range, stale: Collection[int], say: Callable[[str], None]
) -> dict[int, str]:
    """Image -> the first file that is damaged and how, of finished images; what can be restored is restored.

    `images`: numbers of the images that are wanted.
    `stale`: those that are made again in any case: they are not checked.
    `say`: takes progress, and a sentence about each of the first damaged images.

    Raises `OutputError`: a file is there and must not be read.
    """
    total = len(done_keys(storage))
    if not total:
        return {}
    checker = _Checker(storage, loaded)
    records = (record for record in records_of(storage) if record.image in images and record.image not in stale)
    found: dict[int, str] = {}
    reported_s = time.monotonic()
    with ThreadPoolExecutor(max(_LEAST_THREADS, cores()), "damage") as pool:
        for number, (image, problem) in enumerate(in_order(pool, checker.check, records), start=1):
            if problem is not None:
                found[image] = problem
                if len(found) <= _MOST_NAMED:
                    say(f"image {image} is made again: {problem}")
            if time.monotonic() - reported_s > _REPORT_EVERY_S:
                reported_s = time.monotonic()
                say(f"checking finished images: {number:,} of {total:,}")
    if len(found) > _MOST_NAMED:
        say(f"{len(found) - _MOST_NAMED:,} more damaged images are made again: run/log.jsonl names all")
    return found


class _Checker:
    """Compares files with records, from several threads."""

    def __init__(self, storage: StorageBackend, loaded: LoadedRecipe) -> None:
        self._storage, self._loaded = storage, loaded
        self._sizes: dict[str, dict[str, int]] = {}  # folder -> path -> bytes, of an object store
        self._listing = Lock()
        self._shared: dict[tuple[str, str], str | None] = {}  # maps, which many images name: checked once

    def check(self, record: JobRecord) -> tuple[int, str | None]:
        """An image and its first problem."""
        for path, listed in record.files.items():
            key = path, str(listed["sha256"])
            is_map = path.startswith(f"{record.split}/{MAPS}/")
            if key in self._shared:
                problem = self._shared[key]
            else:
                problem = self._problem(path, listed)
                if problem is not None and self._restored(record, path, listed, is_map):
                    problem = None
                if is_map:
                    if problem is not None:
                        self._storage.remove(path)  # a worker writes it again only where there is none
                    self._shared[key] = problem
            if problem is not None:
                return record.image, f"{path} {problem}"
        return record.image, None

    def _problem(self, path: str, listed: Mapping[str, Any]) -> str | None:
        """What is wrong with a file; None if it is as it was written."""
        if isinstance(self._storage, LocalStorage):
            return _local_problem(SafePath(self._storage.root, path), listed)
        folder = path.partition("/")[0]
        with self._listing:
            if folder not in self._sizes:
                self._sizes[folder] = {found: size for found, size, _ in self._storage.found(folder)}
        size = self._sizes[folder].get(path)
        if size is None:
            return "is missing"
        return None if size == listed["bytes"] else f"has {size:,} bytes instead of {listed['bytes']:,}"

    def _restored(self, record: JobRecord, path: str, listed: Mapping[str, Any], is_map: bool) -> bool:
        """Whether the file could be written again without rendering."""
        content = None
        if path.startswith(f"{THUMBNAILS}/"):
            content = self._thumbnail(record, Path(path).stem)
        elif is_map:
            content = self._maps.get(str(listed["sha256"]))
        if content is None or hashlib.sha256(content).hexdigest() != listed["sha256"]:
            return False
        self._storage.write(path, content)
        return True

    def _thumbnail(self, record: JobRecord, frame: str) -> bytes | None:
        """A frame's thumbnail made from its preview."""
        preview = self._storage.read(f"{record.split}/{frame}/preview.png")
        if preview is None:
            return None
        with TemporaryDirectory(prefix="forestgen-thumbnail-") as folder:
            (Path(folder) / "preview.png").write_bytes(preview)
            try:
                write_thumbnail(Path(folder), Path(folder) / "small.jpg")
            except OutputError:
                return None
            return (Path(folder) / "small.jpg").read_bytes()

    @cached_property
    def _maps(self) -> dict[str, bytes]:
        """SHA-256 -> content of the maps that the recipe names."""
        try:
            maps = recipe_part(self._loaded, ()).maps.values()
        except ForestgenError:  # a map has changed: the images' own jobs report that
            return {}
        return {hashlib.sha256(content).hexdigest(): content for content in maps}


def _local_problem(file: SafePath, listed: Mapping[str, Any]) -> str | None:
    try:
        size = file.size_bytes()
        if size != listed["bytes"]:
            return f"has {size:,} bytes instead of {listed['bytes']:,}"
        return None if file_sum(file) == listed["sha256"] else "has other content than was written"
    except (RefusedFileError, IsADirectoryError):
        return "is no regular file"
    except OSError as error:
        if error.errno in _GONE:
            return "is missing"
        if error.errno == errno.EIO:
            return "cannot be read from its disk"
        raise unreadable_storage(error, file) from error
