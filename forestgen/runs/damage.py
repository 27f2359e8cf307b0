"""Finished images whose files are not as they were written: a run that resumes makes them again.

In a folder every file is read and compared with the SHA-256 of its image's record. In an object store, which keeps sums
of its own, one listing tells which objects are missing or have another size.

A thumbnail, or a map that the recipe names, is written again without rendering.
"""

from __future__ import annotations

import errno
import hashlib
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

from forestgen.core.errors import ForestgenError, OutputError
from forestgen.core.threads import cores
from forestgen.dataset.checksums import file_sum
from forestgen.dataset.safe_path import RefusedFileError, SafePath
from forestgen.dataset.thumbnails import FOLDER_NAME as THUMBNAILS
from forestgen.dataset.thumbnails import write_thumbnail
from forestgen.recipe.assets import MAPS
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import JobRecord, Place
from forestgen.runs.finish import recipe_part
from forestgen.runs.parallel import in_order
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import done_keys, records_of

_LEAST_THREADS = 8  # a network share answers slowly, but many requests at a time
_REPORT_EVERY_S = 10.0
_MOST_NAMED = 20
_GONE = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)


def damaged_images(
    place: Place, loaded: LoadedRecipe, images: range, stale: Collection[int], say: Callable[[str], None]
) -> dict[int, str]:
    """Image -> the first file that is damaged and how, of finished images; what can be restored is restored.

    Parameters
    ----------
    images : numbers of the images that are wanted.
    stale : those that are made again in any case: they are not checked.
    say : takes progress, and a sentence about each of the first damaged images.

    Raises
    ------
    OutputError : a file is there and must not be read.
    """
    total = len(done_keys(place))
    if not total:
        return {}
    checker = _Checker(place, loaded)
    records = (record for record in records_of(place) if record.image in images and record.image not in stale)
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

    def __init__(self, place: Place, loaded: LoadedRecipe) -> None:
        self._place, self._loaded = place, loaded
        self._sizes: dict[str, dict[str, int]] = {}  # folder -> path -> bytes, of an object store
        self._listing = Lock()
        self._shared: dict[tuple[str, str], str | None] = {}  # maps, which many images name: checked once

    def check(self, record: JobRecord) -> tuple[int, str | None]:
        """An image and its first problem."""
        return record.image, next(self._problems(record), None)

    def _problems(self, record: JobRecord) -> Iterator[str]:
        for path, listed in record.files.items():
            if not _is_map(record, path):
                problem = self._problem(path, listed)
                if problem is not None and not self._restored(record, path, listed):
                    yield f"{path} {problem}"
                continue
            key = path, str(listed["sha256"])
            if key not in self._shared:
                problem = self._problem(path, listed)
                if problem is not None:
                    if self._restored(record, path, listed):
                        problem = None
                    else:
                        self._place.remove(path)  # a worker writes it again only where there is none
                self._shared[key] = problem
            if self._shared[key] is not None:
                yield f"{path} {self._shared[key]}"

    def _problem(self, path: str, listed: Mapping[str, Any]) -> str | None:
        """What is wrong with a file; None if it is as it was written."""
        if isinstance(self._place, LocalPlace):
            return _local_problem(SafePath(self._place.root, path), listed)
        size = self._sizes_of(path.partition("/")[0]).get(path)
        if size is None:
            return "is missing"
        return None if size == listed["bytes"] else f"has {size:,} bytes instead of {listed['bytes']:,}"

    def _sizes_of(self, folder: str) -> dict[str, int]:
        with self._listing:
            if folder not in self._sizes:
                remote: Any = self._place
                self._sizes[folder] = remote.files(folder)
            return self._sizes[folder]

    def _restored(self, record: JobRecord, path: str, listed: Mapping[str, Any]) -> bool:
        """Whether the file could be written again without rendering."""
        content = None
        if path.startswith(f"{THUMBNAILS}/"):
            content = self._thumbnail(record, Path(path).stem)
        elif _is_map(record, path):
            content = self._maps.get(str(listed["sha256"]))
        if content is None or hashlib.sha256(content).hexdigest() != listed["sha256"]:
            return False
        self._place.write(path, content)
        return True

    def _thumbnail(self, record: JobRecord, frame: str) -> bytes | None:
        """A frame's thumbnail made from its preview."""
        preview = self._place.read(f"{record.split}/{frame}/preview.png")
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


def _is_map(record: JobRecord, path: str) -> bool:
    return path.startswith(f"{record.split}/{MAPS}/")


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
        raise OutputError(
            f"cannot read: {error.strerror or error}", where=str(file), hint="check the folder's permissions and disk"
        ) from error
