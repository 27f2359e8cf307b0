"""How a batch went, from run/log.jsonl and run/jobs.parquet: a line and a job at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from forestgen.dataset.safe_path import SafePath, check_cells, load_json

LOG, JOBS = "run/log.jsonl", "run/jobs.parquet"
_LONGEST_LINE = 1_000_000  # bytes
MOST_MESSAGES = 40  # different ones that are kept
_MOST_CHARACTERS = 600  # of a message
_MOST_IMAGES = 12  # named beside a message
_MOST_ATTEMPTS = 10_000  # of which the images are remembered


@dataclass
class Failure:
    """Attempts that ended with one message."""

    kind: str
    message: str
    attempts: int = 0
    images: dict[int, int] = field(default_factory=dict)  # image -> its last attempt that ended so


@dataclass
class RunLog:
    """What the logs of all runs on a data set say together."""

    lines: int = 0  # of the log that could be read
    runs: int = 0
    failures: list[Failure] = field(default_factory=list)
    failed_attempts: int = 0
    unlisted_attempts: int = 0  # with messages beyond `MOST_MESSAGES`
    workers_lost: int = 0
    damaged_lines: int = 0
    running_s: float = 0.0  # from the start of each run to its last line
    finished_s: list[float] = field(default_factory=list)  # running time at the end of each job, in order
    job_s: list[float] = field(default_factory=list)  # what each job took
    stage_s: dict[str, float] = field(default_factory=dict)  # over all jobs
    peak_memory_bytes: list[float] = field(default_factory=list)  # of each job's worker
    workers: set[str] = field(default_factory=set)
    done: set[int] = field(default_factory=set)  # images

    @property
    def images_per_hour(self) -> float | None:
        """Over all runs; None if the log does not tell."""
        return 3600.0 * len(self.finished_s) / self.running_s if self.running_s > 0 and self.finished_s else None

    @property
    def given_up(self) -> list[int]:
        """Images with failed attempts and none that succeeded."""
        return sorted({image for one in self.failures for image in one.images} - self.done)


def read_run(folder: Path) -> RunLog | None:
    """All that is known of the runs on a data set; None where it has no run/ folder. What is damaged is counted."""
    lines, table = SafePath(folder, LOG), SafePath(folder, JOBS)
    if not lines.is_file() and not table.is_file():
        return None
    log = RunLog()
    jobs: dict[int, Mapping[str, Any]] = {}
    _Lines(log, jobs).read(lines)
    for row in _job_rows(table, log):
        if (image := _whole(row.get("image"))) is not None:
            jobs[image] = row
    for image in sorted(jobs):
        _add_job(log, jobs[image])
    log.done.update(jobs)
    return log


class _Lines:
    """The log, line by line."""

    def __init__(self, log: RunLog, jobs: dict[int, Mapping[str, Any]]) -> None:
        self._log, self._jobs = log, jobs
        self._failures: dict[tuple[str, str], Failure] = {}
        self._before_s = 0.0  # running time of the earlier runs
        self._start_s: float | None = None  # of this run, of the clock
        self._take = {"start": self._started, "job_done": self._job_done, "job_failed": self._job_failed,
                      "worker_lost": self._worker_lost}  # fmt: skip

    def read(self, path: SafePath) -> None:
        try:
            with path.open() as lines:
                for line in iter(lambda: lines.readline(_LONGEST_LINE), b""):
                    if line.strip():
                        self._line(line)
        except OSError:
            return  # there is none; jobs.parquet tells the rest
        self._log.failures = sorted(self._failures.values(), key=lambda one: (-one.attempts, one.kind, one.message))

    def _line(self, line: bytes) -> None:
        event = _event(line)
        if event is None:
            self._log.damaged_lines += 1
            return
        self._log.lines += 1
        take = self._take.get(str(event["event"]))
        at_s = _seconds_of(event.get("time"))
        if event["event"] == "start":
            self._before_s, self._start_s = self._log.running_s, at_s
        if at_s is not None:
            self._start_s = at_s if self._start_s is None else self._start_s
            self._log.running_s = max(self._log.running_s, self._before_s + at_s - self._start_s)
        if take is not None:
            take(event)

    def _started(self, _: Mapping[str, Any]) -> None:
        self._log.runs += 1

    def _job_done(self, event: Mapping[str, Any]) -> None:
        image = _whole(event.get("image"))
        if image is None:
            self._log.damaged_lines += 1
            return
        self._log.finished_s.append(self._log.running_s)
        self._jobs[image] = event

    def _worker_lost(self, _: Mapping[str, Any]) -> None:
        self._log.workers_lost += 1

    def _job_failed(self, event: Mapping[str, Any]) -> None:
        self._log.failed_attempts += 1
        key = str(event.get("kind", "?"))[:40], str(event.get("message", ""))[:_MOST_CHARACTERS]
        if key not in self._failures and len(self._failures) >= MOST_MESSAGES:
            self._log.unlisted_attempts += 1
            return
        failure = self._failures.setdefault(key, Failure(*key))
        failure.attempts += 1
        image = _whole(event.get("image"))
        if image is not None and (image in failure.images or self._log.failed_attempts <= _MOST_ATTEMPTS):
            failure.images[image] = _whole(event.get("attempt")) or 1


def named_images(failure: Failure) -> tuple[list[int], int]:
    """The images to name beside a failure, and how many more there are."""
    images = sorted(failure.images)
    return images[:_MOST_IMAGES], max(0, len(images) - _MOST_IMAGES)


def _event(line: bytes) -> dict[str, Any] | None:
    try:
        event = load_json(line)
    except ValueError:
        return None
    return event if isinstance(event, dict) and isinstance(event.get("event"), str) else None


def _job_rows(path: SafePath, log: RunLog) -> Iterator[Mapping[str, Any]]:
    if not path.is_file():
        return
    try:
        with path.open() as stream, pq.ParquetFile(stream) as file:
            check_cells(file.metadata.num_rows, file.metadata.num_columns)
            for batch in file.iter_batches(5000):
                yield from batch.to_pylist()
    except (OSError, ValueError, pa.ArrowException):
        log.damaged_lines += 1


def _add_job(log: RunLog, job: Mapping[str, Any]) -> None:
    seconds, memory = _number(job.get("seconds")), _number(job.get("peak_memory_bytes"))
    if seconds is not None:
        log.job_s.append(seconds)
    if memory:
        log.peak_memory_bytes.append(memory)
    if job.get("worker"):
        log.workers.add(str(job["worker"]))
    for stage, value in _pairs(job.get("timings_s")):
        if (took := _number(value)) is not None:
            log.stage_s[str(stage)] = log.stage_s.get(str(stage), 0.0) + took


def _pairs(timings: Any) -> list[tuple[Any, Any]]:
    """Stage and seconds: of an object in the log, or of a map in the table."""
    if isinstance(timings, dict):
        return list(timings.items())
    return [one for one in timings if isinstance(one, tuple)] if isinstance(timings, list) else []


def _number(value: Any) -> float | None:
    """A finite number of at least 0, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        return None
    return float(value)


def _whole(value: Any) -> int | None:
    return None if _number(value) is None else int(value)


def _seconds_of(text: Any) -> float | None:
    """An ISO 8601 time as seconds of the clock."""
    try:
        return datetime.fromisoformat(str(text)).timestamp()
    except (ValueError, OverflowError, OSError):
        return None
