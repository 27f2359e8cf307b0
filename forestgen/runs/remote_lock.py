"""One run at a time in an object store, which has no locks.

The lock is an object that holds its owner and a count, which a living owner raises every `BEAT_S` seconds. A run that
finds the object watches it: if the count moves, it is refused; if it stands still for `PATIENCE_S`, its owner is dead,
and the lock is taken over. No clock is compared with another machine's.

Where the store offers it (Amazon S3, and most that speak its language today), the object is written only if there is
none: of two runs that start together one is refused at once. Elsewhere both may write, and each looks a moment later
whether the object is still its own: the last to write stays. A run that was cut off from the store for longer than the
others' patience finds another's name at its next beat, and `check` stops it. What two runs might do in the meantime is
write the same job's files; of one recipe they are the same bytes.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from forestgen.core.errors import OutputError
from forestgen.runs.remote_store import storage_errors, store_code
from forestgen.runs.storage import refusal, this_process

BEAT_S = 15.0
PATIENCE_S = 60.0
SETTLE_S = 2.0  # longer than a small object's way to the store
_REFUSED = ("PreconditionFailed", "ConditionalRequestConflict", "412", "409")
_NOT_OFFERED = ("NotImplemented", "501", "InvalidArgument", "InvalidRequest")


class RemoteLock:
    """Holds the lock; see `contract.Lock`.

    Parameters
    ----------
    store : fsspec's file system.
    key : of the lock's object.
    where : the data set's address, for messages.
    say : takes a sentence when there is something to wait for.
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
        with storage_errors(self._where):
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
        """Raise `OutputError` if another run has taken the lock over; asks nobody, so it costs nothing."""
        if self._lost:
            raise OutputError(
                "the lock of the data set was lost: this run could not reach the store, or another took over",
                where=self._where,
                got=self._lost,
                hint="see that no other run writes there, then `resume=True`",
            )

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
            if store_code(error) in _REFUSED:
                raise self._refusal(self._read()) from error
            if store_code(error) not in _NOT_OFFERED:
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
