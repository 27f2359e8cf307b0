"""A data set's place in an object store: S3 and what speaks its language, or another that fsspec knows.

Files are staged in this machine's temporary folder and uploaded; a store shows an object when all of it has arrived.
A frame's objects appear one by one, so it is the job's record, written last, that says that the frame is whole.
Credentials come from the environment of the process that writes: they are in no address, record or log, and travel to
no worker.

Uploads are tried again, and sizes compared. Nothing is kept of listings, since other machines write here: what asks for
many names asks once, by `names` or `files`, which take a request for each 1,000 names.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from forestgen.core.errors import OutputError
from forestgen.dataset.files import output_error
from forestgen.runs.remote_lock import RemoteLock
from forestgen.runs.remote_store import (
    CONNECTIONS,
    check_url,
    file_system,
    persistently,
    put_checked,
    storage_errors,
    store_code,
)

T = TypeVar("T")
S = TypeVar("S")

_STAGING = "forestgen-staging-"
_AHEAD = 4 * CONNECTIONS  # transfers that wait their turn


@dataclass(frozen=True)
class RemoteStorage:
    """`StorageBackend` in an object store.

    Parameters
    ----------
    url : such as ``s3://bucket/prefix``.

    Raises
    ------
    OutputError
        When the address cannot be one, or its package is missing.
    """

    url: str

    def __post_init__(self) -> None:
        file_system(check_url(self.url))

    @property
    def name(self) -> str:
        """As the user wrote it."""
        return self.url

    def lock(self, say: Callable[[str], None] = lambda _: None) -> RemoteLock:
        """A context manager that keeps other runs out of here."""
        return RemoteLock(self._store, self._key(".forestgen/lock"), self.url, say)

    def staging(self) -> Path:
        """A new empty folder in this machine's temporary folder (TMPDIR)."""
        try:
            _clear_leftovers(os.getpid())
            return Path(tempfile.mkdtemp(prefix=f"{_STAGING}{os.getpid()}-"))
        except OSError as error:
            raise output_error(error, Path(tempfile.gettempdir())) from error

    def discard(self, staging: Path) -> None:
        """Remove a staging folder."""
        shutil.rmtree(staging, ignore_errors=True)

    def put_folder(self, source: Path, target: str) -> None:
        """Upload a folder; what else lay at the target is removed."""
        self.upload(source, target)
        kept = {f"{target}/{path}" for path in _files_below(source)}
        self.remove_all([path for path in self.files(target) if path not in kept])

    def put_file(self, source: Path, target: str) -> None:
        """Upload a file."""
        put_checked(self._store, source, self._key(target), self._where(target))

    def write(self, target: str, content: bytes) -> None:
        """Write a small file."""
        put_checked(self._store, content, self._key(target), self._where(target))

    def read(self, path: str) -> bytes | None:
        """A file's bytes; None if there is none."""

        def get() -> bytes | None:
            try:
                return bytes(self._store.cat_file(self._key(path)))
            except (FileNotFoundError, IsADirectoryError) as error:
                _raise_if_no_bucket(error)
                return None

        return persistently(get, self._where(path))

    def exists(self, path: str) -> bool:
        """Whether there is a file, or a folder with a file in it."""
        with storage_errors(self._where(path)):
            return bool(self._store.exists(self._key(path)))

    def size_bytes(self, path: str) -> int | None:
        """Of a file; None if there is none."""
        with storage_errors(self._where(path)):
            try:
                found = self._store.info(self._key(path))
            except FileNotFoundError as error:
                _raise_if_no_bucket(error)
                return None
            return int(found["size"]) if found["type"] == "file" else None

    def names(self, folder: str) -> list[str]:
        """Names of what lies in a folder, sorted."""
        with storage_errors(self._where(folder)):
            try:
                found = self._store.ls(self._key(folder), detail=False)
            except (FileNotFoundError, NotADirectoryError) as error:
                _raise_if_no_bucket(error)
                return []
        own = self._key(folder).rstrip("/")
        return sorted({PurePosixPath(path).name for path in found if path.rstrip("/") != own})

    def files(self, folder: str = "") -> dict[str, int]:
        """Path below the data set's folder -> size in bytes, of all files below a folder; by path."""
        root = self._key("").rstrip("/") + "/"
        with storage_errors(self._where(folder)):
            try:
                found = self._store.find(self._key(folder), detail=True)
            except FileNotFoundError as error:
                _raise_if_no_bucket(error)
                return {}
        return {path.removeprefix(root): int(one["size"]) for path, one in sorted(found.items())}

    def found(self, folder: str) -> Iterator[tuple[str, int, int]]:
        return ((path, size, 0) for path, size in self.files(folder).items())

    def clear_staging(self) -> None:
        """Nothing: each process clears its own staging folders, and those of dead ones."""

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with all in it."""
        self.remove_all(self.files(path))

    def remove_all(self, paths: Collection[str]) -> None:
        """Remove many files, in a request for each 1,000."""
        if paths:
            persistently(lambda: self._store.rm([self._key(path) for path in paths]), self.url)

    def fetch(self, paths: Iterable[str], folder: Path) -> None:
        """Download files to ``folder/PATH``.

        Raises
        ------
        OutputError
            When one is not there, or does not arrive whole.
        """

        def get(path: str) -> None:
            target = folder / path
            key = self._key(path)  # refuses a path that leads out of the folder
            with storage_errors(self._where(path)):
                target.parent.mkdir(parents=True, exist_ok=True)
            persistently(lambda: self._store.get_file(key, str(target)), self._where(path))

        _at_once(get, paths)

    def upload(self, folder: Path, target: str = "", skip: Collection[str] = ()) -> None:
        """Upload all files below a folder but those whose relative path is in `skip`; nothing is removed."""
        left_out = set(skip)
        pairs = [path for path in _files_below(folder) if path not in left_out]
        _at_once(lambda path: self.put_file(folder / path, f"{target}/{path}" if target else path), pairs)

    def link(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Give files, (path, new path), a second place; the store copies them, nothing passes through here."""

        def copy(pair: tuple[str, str]) -> None:
            source, target = (self._key(path) for path in pair)
            persistently(lambda: self._store.cp_file(source, target), self._where(pair[1]))

        _at_once(copy, pairs)

    @property
    def _store(self) -> Any:
        return file_system(self.url.partition("://")[0])

    def _key(self, path: str) -> str:
        """A path below the data set's folder as the store names it."""
        if path and not _stays_inside(path):
            raise OutputError("a path leads out of the data set's folder", where=self.url, got=path)
        root = str(self._store._strip_protocol(self.url)).rstrip("/")
        return f"{root}/{path}" if path else root

    def _where(self, path: str) -> str:
        return f"{self.url.rstrip('/')}/{path}" if path else self.url


def _stays_inside(path: str) -> bool:
    return not any(part in ("", ".", "..") for part in path.split("/")) and "\\" not in path


def _raise_if_no_bucket(error: BaseException) -> None:
    """A missing file is an answer; a missing bucket is a mistake."""
    if store_code(error) == "NoSuchBucket":
        raise error


def _files_below(folder: Path) -> list[str]:
    """Paths of a folder's files, relative to it, with forward slashes, sorted."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _at_once(task: Callable[[S], None], items: Iterable[S]) -> None:
    """Do a task for each item, several at once; the first failure is raised, and what has not begun is left."""
    with ThreadPoolExecutor(CONNECTIONS) as pool:
        waiting: deque[Future[None]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(task, item))
                if len(waiting) >= _AHEAD:
                    waiting.popleft().result()
            for future in waiting:
                future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@cache
def _clear_leftovers(_process: int) -> None:
    """Remove the staging folders of this user's dead processes; once a process."""
    import psutil

    for folder in Path(tempfile.gettempdir()).glob(f"{_STAGING}*"):
        process = folder.name.removeprefix(_STAGING).partition("-")[0]
        if process.isdecimal() and not psutil.pid_exists(int(process)):
            shutil.rmtree(folder, ignore_errors=True)
