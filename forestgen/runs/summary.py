"""How far a run is, and its report: text, and the files run/log.jsonl, run/summary.json and run/jobs.parquet.

The log has one JSON object a line, each on the disk when it has happened. Every line has `time` (ISO 8601, UTC) and
`event`: start, image_damaged, job_done, job_failed, worker_lost, progress, finish, stop; of a cluster also
worker_joined, worker_refused, waiting. A run that resumes appends to the log of those before it.
"""

from __future__ import annotations

import io
import json
import math
import os
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Protocol

from pydantic import ValidationError

from forestgen.core.errors import writing
from forestgen.core.figures import count, seconds, table_lines
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.files import make_folder
from forestgen.dataset.safe_path import load_json
from forestgen.runs.contract import RUN, Count, Done, Failed, JobRecord, Outcome, StorageBackend, Stored
from forestgen.runs.storage import LocalStorage

LOG = f"{RUN}/log.jsonl"
JOBS_TABLE = f"{RUN}/jobs.parquet"
SUMMARY = f"{RUN}/summary.json"
_UPLOAD_EVERY_S = 120.0  # to an object store, which appends to nothing
_MOST_NOTES, _MOST_STAGES = 5, 5
_WINDOW = 200  # the latest images, whose pace is reported
_SETTLED = 8  # images from which on that pace is worth more than the whole run's


@dataclass(frozen=True, repr=False)
class RunSummary:
    """A finished run."""

    target: str
    images: int  # asked for
    already: int  # done before this run
    made: int  # by this run
    failed: tuple[Failed, ...]  # given up: not in the data set
    missing: tuple[int, ...]  # numbers of images that were asked for and are not in the data set
    frames: int  # in the data set
    bytes: int  # of the data set
    report: str | None  # its path
    seconds: float
    images_per_hour: float | None = None  # of this run; None if it made none
    stages_s: Mapping[str, float] = field(default_factory=dict)  # of the workers, the longest first
    peak_memory_bytes: int = 0  # of the worker that took most
    notes: tuple[str, ...] = ()  # on the whole
    image_notes: tuple[str, ...] = ()  # on the images that this run has made
    last: JobRecord | None = None  # of the image that was finished last

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        done = f"{self.images - len(self.missing):,} of {count(self.images, 'image')} done"
        return f"<RunSummary {self.target}: {done}, {count(self.frames, 'frame')}>"

    def lines(self, *, verbose: bool = False) -> Iterator[str]:
        """For people; `verbose`: with all notes and stages."""
        if self.last is not None:
            yield from _image_lines(self, self.last)
        before = f", {self.already:,} of them before" if self.already else ""
        yield f"{self.images - len(self.missing):,} of {count(self.images, 'image')} done{before}"
        pace = "" if self.images_per_hour is None or self.made < 2 else f", {self.images_per_hour:,.0f} images an hour"
        yield f"{count(self.frames, 'frame')}, {self.bytes / 1e6:,.1f} MB in {seconds(self.seconds)}{pace}"
        notes = [*dict.fromkeys([*self.image_notes, *self.notes])]
        shown = notes if verbose else notes[:_MOST_NOTES]
        for note in shown:
            yield f"note: {note}"
        if len(notes) > len(shown):
            yield f"note: {len(notes) - len(shown)} more notes: `verbose` shows all"
        total = sum(self.stages_s.values())
        if total:
            stages = list(self.stages_s.items())[: None if verbose else _MOST_STAGES]
            yield "time: " + ", ".join(f"{name} {100 * spent / total:.0f} %" for name, spent in stages)
        yield f"files: {self.target}/"
        if self.last is not None and self.last.rows:
            folder = f"{self.target}/{self.last.rows[0]['folder']}"
            report = f", or at {self.report}" if self.report else ""
            yield f"look at {folder}/preview.png and {folder}/overlay.png{report}"
        elif self.report:
            yield f"look at {self.report}"


def _image_lines(summary: RunSummary, last: JobRecord) -> Iterator[str]:
    """The plants, the noise and the exemplars of the image that was finished last."""
    report = last.report
    counts: Mapping[str, int] = report.get("counts", {})
    if summary.made > 1:
        yield f"image {last.image}:"
    kinds = ", ".join(f"{number:,} {name}" for name, number in counts.items())
    dead = f", {report['dead']:,} of them dead" if report.get("dead") else ""
    seen = f"; {report.get('visible_plants', 0):,} of them in view"
    yield f"{count(sum(counts.values()), 'plant')} ({kinds}){dead}{seen}"
    errors = [row.get("relative_error") for row in last.rows]
    known = [100 * error for error in errors if error is not None and math.isfinite(error)]
    if known:
        least, most = f"{min(known):.2g}", f"{max(known):.2g}"
        yield f"noise: relative error {least if least == most else f'{least} to {most}'} % before denoising"
    yield from _size_errors(report.get("size_errors", []))


def _size_errors(errors: Sequence[Mapping[str, Any]]) -> list[str]:
    """How well the exemplars stand for the plants: root mean squares of relative errors."""
    if not errors:
        return []
    rows = [("species", "plants", "exemplars", "rms size error", "rms crown width error", "rms diameter error")]
    for one in errors:
        rms = (
            "-" if one[name] is None else f"{100 * one[name]:.1f} %"  # no plant of its kind has it
            for name in ("radius_rms", "crown_width_rms", "dbh_rms")
        )
        rows.append((one["species"], f"{one['plants']:,}", f"{one['exemplars']:,}", *rms))
    return table_lines(rows)


def write_summary(storage: StorageBackend, summary: RunSummary) -> None:
    """Write run/summary.json."""
    names = ("images", "already", "made", "failed", "missing", "frames", "bytes", "peak_memory_bytes", "notes")
    plain = {name: getattr(summary, name) for name in names}
    plain |= {"failed": [one.job.image for one in summary.failed], "total_s": summary.seconds}
    plain["timings_s"] = dict(summary.stages_s)
    storage.write(SUMMARY, (json.dumps(plain, indent=1) + "\n").encode())


class Log:
    """run/log.jsonl; elsewhere than in a folder a copy of it, which is put there anew every two minutes."""

    def __init__(self, storage: StorageBackend) -> None:
        self._storage = storage
        self._local = isinstance(storage, LocalStorage)
        self._file: IO[bytes] | None = None
        self._path = Path()
        self._uploaded_s = time.monotonic()

    def __enter__(self) -> Log:
        before = b"" if self._local else self._storage.read(LOG) or b""
        if isinstance(self._storage, LocalStorage):
            self._path = self._storage.root / LOG
            make_folder(self._path.parent)
        else:
            self._path = Path(tempfile.mkdtemp(prefix="forestgen-log-")) / "log.jsonl"
        with writing(self._path):
            # To follow a link of an untrusted data set would change a file elsewhere.
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            self._file = os.fdopen(os.open(self._path, flags, 0o666), "ab+")
            self._file.write(before)
            if self._file.seek(0, os.SEEK_END) > 0:
                self._file.seek(-1, os.SEEK_END)
                if self._file.read(1) != b"\n":  # a run that was killed has left half a line
                    self._file.write(b"\n")
                    self._file.flush()
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            with suppress(OSError):  # a full disk was reported when the line was written
                self._file.close()
        if not self._local:
            self._path.unlink(missing_ok=True)
            self._path.parent.rmdir()

    def event(self, name: str, **fields: Any) -> None:
        """Append a line. Raises `OutputError` when it cannot be written."""
        assert self._file is not None
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": name, **fields}
        with writing(self._path):
            self._file.write((json.dumps(line, ensure_ascii=False) + "\n").encode())
            self._file.flush()
        if not self._local and time.monotonic() - self._uploaded_s > _UPLOAD_EVERY_S:
            self.upload()

    def upload(self) -> None:
        """Put the log where the data set is, if that is no folder of this machine."""
        if not self._local:
            self._uploaded_s = time.monotonic()
            self._storage.write(LOG, self._path.read_bytes())

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


def job_fields(outcome: Outcome) -> dict[str, Any]:
    """The fields of a `job_done`, or of a `job_failed` but for `will_retry`."""
    fields: dict[str, Any] = {"image": outcome.job.image, "split": outcome.job.split}
    if isinstance(outcome, Done):
        fields |= {**vars(outcome.run), "frames": len(outcome.record.rows)}
        fields["timings_s"] = {name: round(spent, 4) for name, spent in outcome.run.timings_s.items()}
    else:
        fields |= {name: getattr(outcome, name) for name in ("attempt", "kind", "message", "seconds", "worker")}
    return {**fields, "seconds": round(fields["seconds"], 4)}


class _JobDone(Stored):
    """A `job_done` of the log, in the order of the table's columns; the disk or a hand may have damaged one."""

    image: Count
    split: str
    attempt: Count
    worker: str
    seconds: float
    peak_memory_bytes: Count
    frames: Count
    timings_s: dict[str, float]
    time: str


def write_jobs_table(storage: StorageBackend, lines: Iterable[Mapping[str, Any]], images: range) -> None:
    """Write run/jobs.parquet: a row an image, what the log's last sound `job_done` says of it.

    `lines`: of the log.
    `images`: numbers of the batch's images.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    last: dict[int, dict[str, Any]] = {}
    for line in lines:
        with suppress(ValidationError):
            if line.get("event") == "job_done" and (one := _JobDone.model_validate(line)).image in images:
                row = one.model_dump(exclude={"time"})
                last[one.image] = {**row, "timings_s": list(one.timings_s.items()), "finished": one.time}
    kinds: dict[str, Any] = {
        **{name: pa.int64() for name in ("image", "attempt", "peak_memory_bytes", "frames")},
        **{"seconds": pa.float64(), "timings_s": pa.map_(pa.string(), pa.float64())},
    }
    names = [*_JobDone.model_fields, "finished"]
    columns = pa.schema([(name, kinds.get(name, pa.string())) for name in names if name != "time"])
    buffer = io.BytesIO()
    pq.write_table(pa.Table.from_pylist([last[image] for image in sorted(last)], columns), buffer)
    storage.write(JOBS_TABLE, buffer.getvalue())


@dataclass
class ProgressTracker:
    """Counts of a run. Images that an earlier run has made are done, but say nothing about the pace."""

    total: int  # images of the batch
    workers: int = 0
    already: int = 0  # done before this run
    made: int = 0  # by this run
    failed: int = 0  # given up
    retried: int = 0  # attempts that failed and were followed by another
    stages_s: dict[str, float] = field(default_factory=dict)  # of the images made, by stage
    started_s: float = field(default_factory=time.monotonic)
    _times: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    @property
    def done(self) -> int:
        return self.already + self.made

    @property
    def left(self) -> int:
        return self.total - self.done - self.failed

    def count(self, timings_s: Mapping[str, float]) -> None:
        """An image was made."""
        self.made += 1
        self._times.append(time.monotonic())
        for stage, spent in timings_s.items():
            self.stages_s[stage] = self.stages_s.get(stage, 0.0) + spent

    @property
    def images_per_hour(self) -> float | None:
        """Pace of the latest images; None before the first one."""
        if not self._times:
            return None
        if len(self._times) >= _SETTLED and self._times[-1] > self._times[0]:
            return 3600 * (len(self._times) - 1) / (self._times[-1] - self._times[0])
        return 3600 * self.made / max(1e-3, self._times[-1] - self.started_s)

    @property
    def seconds_left(self) -> float | None:
        """At this pace; None before the first image."""
        pace = self.images_per_hour
        return None if pace is None else 3600 * self.left / pace

    @property
    def longest_stages_s(self) -> dict[str, float]:
        """Seconds of each stage, the longest first."""
        return dict(sorted(self.stages_s.items(), key=lambda stage: -stage[1]))

    def shares(self) -> dict[str, float]:
        """Part of the workers' time that each stage takes, the largest first."""
        total = sum(self.stages_s.values())
        return {name: seconds / total for name, seconds in self.longest_stages_s.items() if total > 0}

    def as_event(self) -> dict[str, Any]:
        """The fields of a log's `progress`."""
        return {
            "done": self.done,
            "total": self.total,
            "failed": self.failed,
            "images_per_hour": self.images_per_hour,
            "seconds_left": self.seconds_left,
            "stage_shares": self.shares(),
        }


class Display(Progress, Protocol):
    """What shows a call's progress: the stages of the image in work, the counts of a run, and lines that stay."""

    tracker: ProgressTracker | None  # of the run that is shown, None before it has begun

    def running(self) -> AbstractContextManager[object]:
        """What is shown while its block runs."""

    def say(self, text: str) -> None:
        """A sentence worth a line."""

    def show(self, tracker: ProgressTracker) -> None:
        """The counts, every second or so; the same object every time."""


class SilentDisplay(Silent):
    """Shows nothing."""

    tracker: ProgressTracker | None = None

    def running(self) -> AbstractContextManager[object]:
        return nullcontext(self)

    def say(self, text: str) -> None:
        pass

    def show(self, tracker: ProgressTracker) -> None:
        self.tracker = tracker
