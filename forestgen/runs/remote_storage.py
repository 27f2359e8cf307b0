"""Storage in an object store: S3 and what speaks its language, or another that fsspec knows; and its lock.

Files are staged in this machine's temporary folder and uploaded; a store shows an object when all of it has arrived.
A frame's objects appear one by one, so it is the job's record, written last, that says that the frame is whole.
Credentials come from the environment of the process that writes: they are in no address, record or log, and travel to
no worker.

Uploads are tried again, and sizes compared. Nothing is kept of listings, since other machines write here: what asks for
many names asks once, by `names` or `files`, which take a request for each 1,000 names.

Object stores have no locks. The lock is an object that holds its owner and a count, which a living owner raises every
`BEAT_S` seconds. A run that finds the object watches it: if the count moves, it is refused; if it stands still for
`PATIENCE_S`, its owner is dead, and the lock is taken over. No clock is compared with another machine's.

Where the store offers it (Amazon S3, and most that speak its language today), the object is written only if there is
none: of two runs that start together one is refused at once. Elsewhere both may write, and each looks a moment later
whether the object is still its own: the last to write stays. A run that was cut off from the store for longer than the
others' patience finds another's name at its next beat, and `check` stops it. What two runs might do in the meantime is
write the same job's files; of one recipe they are the same bytes.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

from forestgen.core.errors import OutputError, output_error
from forestgen.runs import remote_store
from forestgen.runs.contract import StorageBackend
from forestgen.runs.records import TaskT, in_order
from forestgen.runs.storage import LocalStorage, refusal, this_process

_STAGING = "forestgen-staging-"
BEAT_S = 15.0
PATIENCE_S = 60.0
SETTLE_S = 2.0  # longer than a small object's way to the store
_REFUSED = ("PreconditionFailed", "ConditionalRequestConflict", "412", "409")
_NOT_OFFERED = ("NotImplemented", "501", "InvalidArgument", "InvalidRequest")


def storage_of(target: str) -> StorageBackend:
    """The storage of a data set: a folder's path, or a URL such as ``s3://bucket/forests``."""
    scheme, separator, rest = target.partition("://")
    if not separator:
        return LocalStorage(Path(target).absolute(), target)
    if scheme == "file":
        return LocalStorage(Path(rest).absolute(), target)
    return RemoteStorage(target)


@dataclass(frozen=True)
class RemoteStorage:
    """`StorageBackend` in an object store; raises `OutputError` for no address of one, or if its package is missing."""

    url: str  # such as s3://bucket/prefix

    def __post_init__(self) -> None:
        remote_store.file_system(remote_store.check_url(self.url))

    @property
    def name(self) -> str:
        return self.url

    def lock(self, say: Callable[[str], None] = lambda _: None) -> RemoteLock:
        return RemoteLock(self._store, self._key(".forestgen/lock"), self.url, say)

    def staging(self) -> Path:
        try:
            _clear_leftovers(os.getpid())
            return Path(tempfile.mkdtemp(prefix=f"{_STAGING}{os.getpid()}-"))
        except OSError as error:
            raise output_error(error, Path(tempfile.gettempdir())) from error

    def discard(self, staging: Path) -> None:
        shutil.rmtree(staging, ignore_errors=True)

    def put_folder(self, source: Path, target: str) -> None:
        self.upload(source, target)
        kept = {f"{target}/{path}" for path in _files_below(source)}
        self.remove_all([path for path in self.files(target) if path not in kept])

    def put_file(self, source: Path, target: str) -> None:
        remote_store.put_checked(self._store, source, self._key(target), self._where(target))

    def write(self, target: str, content: bytes) -> None:
        remote_store.put_checked(self._store, content, self._key(target), self._where(target))

    def read(self, path: str) -> bytes | None:
        content = remote_store.persistently(
            lambda: _or_none(lambda: self._store.cat_file(self._key(path))), self._where(path)
        )
        return None if content is None else bytes(content)

    def exists(self, path: str) -> bool:
        return bool(self._asked(self._store.exists, path))

    def size_bytes(self, path: str) -> int | None:
        found = self._asked(self._store.info, path) or {}
        return int(found["size"]) if found.get("type") == "file" else None

    def names(self, folder: str) -> list[str]:
        own, found = self._key(folder).rstrip("/"), self._asked(self._store.ls, folder, detail=False) or []
        return sorted({PurePosixPath(path).name for path in found if path.rstrip("/") != own})

    def files(self, folder: str = "") -> dict[str, int]:
        """Path below the data set's folder -> size in bytes, of all files below a folder; by path."""
        root, found = self._key("").rstrip("/") + "/", self._asked(self._store.find, folder, detail=True) or {}
        return {path.removeprefix(root): int(one["size"]) for path, one in sorted(found.items())}

    def found(self, folder: str) -> Iterator[tuple[str, int, int]]:
        return ((path, size, 0) for path, size in self.files(folder).items())

    def clear_staging(self) -> None:
        """Nothing: each process clears its own staging folders, and those of dead ones."""

    def remove(self, path: str) -> None:
        self.remove_all(self.files(path))

    def remove_all(self, paths: Collection[str]) -> None:
        """Remove many files, in a request for each 1,000."""
        if paths:
            remote_store.persistently(lambda: self._store.rm([self._key(path) for path in paths]), self.url)

    def fetch(self, paths: Iterable[str], folder: Path) -> None:
        """Download files to ``folder/PATH``; `OutputError` if one is not there, or does not arrive whole."""

        def get(path: str) -> None:
            key, target = self._key(path), folder / path  # the former refuses a path that leads out of the folder
            with remote_store.storage_errors(self._where(path)):
                target.parent.mkdir(parents=True, exist_ok=True)
            remote_store.persistently(lambda: self._store.get_file(key, str(target)), self._where(path))

        _at_once(get, paths)

    def upload(self, folder: Path, target: str = "") -> None:
        """Upload all files below a folder; nothing is removed."""
        _at_once(
            lambda path: self.put_file(folder / path, f"{target}/{path}" if target else path), _files_below(folder)
        )

    def link(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Give files, (path, new path), a second place; the store copies them, nothing passes through here."""

        def copy(pair: tuple[str, str]) -> None:
            source, target = (self._key(path) for path in pair)
            remote_store.persistently(lambda: self._store.cp_file(source, target), self._where(pair[1]))

        _at_once(copy, pairs)

    @property
    def _store(self) -> Any:
        return remote_store.file_system(self.url.partition("://")[0])

    def _asked(self, question: Callable[..., Any], path: str, **options: Any) -> Any:
        """What the store answers about a path; None if nothing is there."""
        with remote_store.storage_errors(self._where(path)):
            return _or_none(lambda: question(self._key(path), **options))

    def _key(self, path: str) -> str:
        """A path below the data set's folder as the store names it."""
        if any(part in ("", ".", "..") for part in path.split("/") if path) or "\\" in path:
            raise OutputError("a path leads out of the data set's folder", where=self.url, got=path)
        root = str(self._store._strip_protocol(self.url)).rstrip("/")
        return f"{root}/{path}" if path else root

    def _where(self, path: str) -> str:
        return f"{self.url.rstrip('/')}/{path}" if path else self.url


def _or_none(answer: Callable[[], Any]) -> Any:
    """An answer, None where a file is missing; a missing bucket is a mistake."""
    try:
        return answer()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        if remote_store.store_code(error) == "NoSuchBucket":
            raise
        return None


def _files_below(folder: Path) -> list[str]:
    """Paths of a folder's files, relative to it, with forward slashes, sorted."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _at_once(task: Callable[[TaskT], None], items: Iterable[TaskT]) -> None:
    """Do a task for each item, several at once; the first failure is raised, and what has not begun is left."""
    with ThreadPoolExecutor(remote_store.CONNECTIONS) as pool:
        try:
            for _ in in_order(pool, task, items):
                pass
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


class RemoteLock:
    """Holds the lock; see `contract.Lock`.

    `store`: fsspec's file system.
    `key`: of the lock's object.
    `where`: the data set's address, for messages.
    `say`: takes a sentence when there is something to wait for.
    """

    beat_s, patience_s, settle_s = BEAT_S, PATIENCE_S, SETTLE_S

    def __init__(self, store: Any, key: str, where: str, say: Callable[[str], None]) -> None:
        self._store, self._key, self._where, self._say = store, key, where, say
        self._token = secrets.token_hex(8)
        self._count = 0
        self._ended = threading.Event()
        self._lost = ""  # to whom
        self._thread = threading.Thread(target=self._keep, name="forestgen-lock", daemon=True)

    def __enter__(self) -> RemoteLock:
        with remote_store.storage_errors(self._where):
            self._take()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(timeout=self.patience_s)
        with suppress(Exception):  # the next run takes it over, a minute later
            if not self._lost and self._owner() == self._token:
                self._store.rm_file(self._key)

    def check(self) -> None:
        """Raise `OutputError` if another run has taken the lock over; makes no request."""
        if self._lost:
            problem = "the lock of the data set was lost: this run could not reach the store, or another took over"
            hint = "see that no other run writes there, then `resume=True`"
            raise OutputError(problem, where=self._where, got=self._lost, hint=hint)

    def _take(self) -> None:
        found = self._read()
        if found is not None:
            self._watch(found)
        self._write(create=found is None)
        self._ended.wait(self.settle_s)
        if self._owner() != self._token:
            raise self._refusal(self._read())

    def _watch(self, found: bytes) -> None:
        """Return when the owner of the lock that was found is dead; raise `OutputError` when it lives."""
        self._say(
            f"{self._where}: another run was here ({_described(found)}): "
            f"waiting {self.patience_s:.0f} s to see whether it lives"
        )
        end = time.monotonic() + self.patience_s
        while time.monotonic() < end:
            self._ended.wait(min(self.beat_s, max(0.05, end - time.monotonic())))
            now = self._read()
            if now is None:
                return
            if now != found:
                raise self._refusal(now)

    def _write(self, *, create: bool = False) -> None:
        self._count += 1
        content = {"token": self._token, "count": self._count, **this_process()}
        data = json.dumps(content, sort_keys=True).encode()
        if not create:
            self._store.pipe_file(self._key, data)
            return
        try:
            self._store.pipe_file(self._key, data, mode="create")
        except FileExistsError as error:
            raise self._refusal(self._read()) from error
        except Exception as error:
            if remote_store.store_code(error) in _REFUSED:
                raise self._refusal(self._read()) from error
            if remote_store.store_code(error) not in _NOT_OFFERED:
                raise
            self._store.pipe_file(self._key, data)

    def _keep(self) -> None:
        """Raise the count until the end; stop when the lock is another's, or could not be kept for too long."""
        kept = time.monotonic()
        while not self._ended.wait(self.beat_s):
            try:
                if self._owner() != self._token:
                    self._lost = _described(self._read())
                    return
                self._write()
                kept = time.monotonic()
            except Exception as error:  # noqa: BLE001 - a thread that dies of it would keep no lock
                if time.monotonic() - kept > self.patience_s:
                    self._lost = f"no contact with the store: {error}"
                    return

    def _read(self) -> bytes | None:
        try:
            return bytes(self._store.cat_file(self._key))
        except FileNotFoundError:
            return None

    def _owner(self) -> str:
        return str(_content(self._read()).get("token", ""))

    def _refusal(self, found: bytes | None) -> OutputError:
        return refusal(self._where, _described(found))


def _content(found: bytes | None) -> dict[str, Any]:
    try:
        content = json.loads(found or b"{}")
    except ValueError:  # cut short
        return {}
    return content if isinstance(content, dict) else {}


def _described(found: bytes | None) -> str:
    content = _content(found)
    return f"{content.get('owner', 'an unknown run')}, since {content.get('since', 'an unknown time')}"
