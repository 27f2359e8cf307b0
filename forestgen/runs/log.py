"""run/log.jsonl: what happened, one JSON object a line, each on the disk when it has happened.

Every line has `time` (ISO 8601, UTC) and `event`: start, image_damaged, job_done, job_failed, worker_lost, progress,
finish, stop; of a cluster also worker_joined, worker_refused, waiting. A run that resumes appends to the log of those
before it.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from forestgen.dataset.files import make_folder, output_error
from forestgen.dataset.safe_path import load_json
from forestgen.runs.contract import RUN, Done, Failed, Place
from forestgen.runs.places import LocalPlace

LOG = f"{RUN}/log.jsonl"
_UPLOAD_EVERY_S = 120.0  # to an object store, which appends to nothing


class Log:
    """Context manager; of a folder's log it appends to the file itself, elsewhere to a copy that is put there anew."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._local = isinstance(place, LocalPlace)
        self._file: IO[bytes] | None = None
        self._path = Path()
        self._uploaded_s = time.monotonic()

    def __enter__(self) -> Log:
        before = b"" if self._local else self._place.read(LOG) or b""
        if isinstance(self._place, LocalPlace):
            self._path = self._place.root / LOG
            make_folder(self._path.parent)
        else:
            self._path = Path(tempfile.mkdtemp(prefix="forestgen-log-")) / "log.jsonl"
        try:
            # To append to what a link in a stranger's data set points at would change a file elsewhere.
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            self._file = os.fdopen(os.open(self._path, flags, 0o666), "ab+")
            self._file.write(before)
            self._end_torn_line(self._file)
        except OSError as error:
            raise output_error(error, self._path) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._file is not None:
            with suppress(OSError):  # of a full disk: the line that it has no room for was told when it was written
                self._file.close()
        if not self._local:
            self._path.unlink(missing_ok=True)
            self._path.parent.rmdir()

    def event(self, name: str, **fields: Any) -> None:
        """Append a line. Raises `OutputError` when it cannot be written."""
        assert self._file is not None
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": name, **fields}
        try:
            self._file.write((json.dumps(line, ensure_ascii=False) + "\n").encode())
            self._file.flush()
        except OSError as error:
            raise output_error(error, self._path) from error
        if not self._local and time.monotonic() - self._uploaded_s > _UPLOAD_EVERY_S:
            self.upload()

    def upload(self) -> None:
        """Put the log where the data set is, if that is no folder of this machine."""
        if not self._local:
            self._uploaded_s = time.monotonic()
            self._place.write(LOG, self._path.read_bytes())

    def lines(self) -> Iterator[dict[str, Any]]:
        """All events so far, those of earlier runs too; a line that a killed run left half-written is passed over."""
        with self._path.open("rb") as stream:
            for text in stream:
                try:
                    line = load_json(text)
                except ValueError:
                    continue
                if isinstance(line, dict):
                    yield line

    @staticmethod
    def _end_torn_line(stream: IO[bytes]) -> None:
        """A run that was killed may have left half a line; the next one begins below it."""
        if stream.seek(0, 2) == 0:
            return
        stream.seek(-1, 2)
        if stream.read(1) != b"\n":
            stream.write(b"\n")
            stream.flush()


def done_fields(done: Done) -> dict[str, Any]:
    """The fields of a `job_done`."""
    run = done.run
    return {
        "image": done.job.image,
        "split": done.job.split,
        "attempt": run.attempt,
        "seconds": round(run.seconds, 4),
        "timings_s": {name: round(seconds, 4) for name, seconds in run.timings_s.items()},
        "peak_memory_bytes": run.peak_memory_bytes,
        "worker": run.worker,
        "frames": len(done.record.rows),
    }


def failed_fields(failed: Failed) -> dict[str, Any]:
    """The fields of a `job_failed`, but `will_retry`."""
    return {
        "image": failed.job.image,
        "split": failed.job.split,
        "attempt": failed.attempt,
        "kind": failed.kind,
        "message": failed.message,
        "seconds": round(failed.seconds, 4),
        "worker": failed.worker,
    }
