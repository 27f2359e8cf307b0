"""How a batch went, from run/log.jsonl and run/jobs.parquet: a line and a job at a time. What is damaged is counted."""

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

_LOG, _JOBS = "run/log.jsonl", "run/jobs.parquet"
_LONGEST_LINE = 1_000_000  # bytes
MOST_MESSAGES = 40  # different ones that are kept
_MOST_CHARACTERS = 600  # of a message
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
        """Over all runs; None if the log does not say."""
        return 3600.0 * len(self.finished_s) / self.running_s if self.running_s > 0 and self.finished_s else None

    @property
    def given_up(self) -> list[int]:
        """Images with failed attempts and none that succeeded."""
        return sorted({image for one in self.failures for image in one.images} - self.done)


def read_run(folder: Path) -> RunLog | None:
    """All that is known of the runs on a data set; None where it has no run/ folder."""
    lines, table = SafePath(folder, _LOG), SafePath(folder, _JOBS)
    if not lines.is_file() and not table.is_file():
        return None
    log = RunLog()
    jobs = _read_lines(lines, log)
    for row in _job_rows(table, log):
        if (image := _whole(row.get("image"))) is not None:
            jobs[image] = row
    for image in sorted(jobs):
        _add_job(log, jobs[image])
    log.done.update(jobs)
    return log


def _read_lines(path: SafePath, log: RunLog) -> dict[int, Mapping[str, Any]]:
    """Take the log's lines into account; the events of finished jobs by image."""
    jobs: dict[int, Mapping[str, Any]] = {}
    failures: dict[tuple[str, str], Failure] = {}
    before_s, start_s = 0.0, None  # running time of the earlier runs; start of this one, of the clock
    for line in _lines(path):
        event = _event(line)
        if event is None:
            log.damaged_lines += 1
            continue
        log.lines += 1
        at_s, kind, image = _seconds_of(event.get("time")), event["event"], _whole(event.get("image"))
        if kind == "start":
            before_s, start_s = log.running_s, at_s
            log.runs += 1
        if at_s is not None:
            start_s = at_s if start_s is None else start_s
            log.running_s = max(log.running_s, before_s + at_s - start_s)
        if kind == "job_done":
            if image is None:
                log.damaged_lines += 1
                continue
            log.finished_s.append(log.running_s)
            jobs[image] = event
        elif kind == "worker_lost":
            log.workers_lost += 1
        elif kind == "job_failed":
            _add_failure(log, failures, event, image)
    log.failures = sorted(failures.values(), key=lambda one: (-one.attempts, one.kind, one.message))
    return jobs


def _lines(path: SafePath) -> Iterator[bytes]:
    try:
        with path.open() as stream:
            yield from filter(bytes.strip, iter(lambda: stream.readline(_LONGEST_LINE), b""))
    except OSError:
        return  # there is none; jobs.parquet has the rest


def _event(line: bytes) -> dict[str, Any] | None:
    try:
        event = load_json(line)
    except ValueError:
        return None
    return event if isinstance(event, dict) and isinstance(event.get("event"), str) else None


def _add_failure(
    log: RunLog, failures: dict[tuple[str, str], Failure], event: Mapping[str, Any], image: int | None
) -> None:
    log.failed_attempts += 1
    key = str(event.get("kind", "?"))[:40], str(event.get("message", ""))[:_MOST_CHARACTERS]
    if key not in failures and len(failures) >= MOST_MESSAGES:
        log.unlisted_attempts += 1
        return
    failure = failures.setdefault(key, Failure(*key))
    failure.attempts += 1
    if image is not None and (image in failure.images or log.failed_attempts <= _MOST_ATTEMPTS):
        failure.images[image] = _whole(event.get("attempt")) or 1


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
    timings = job.get("timings_s")  # an object in the log, a map in the table
    pairs = timings.items() if isinstance(timings, dict) else timings if isinstance(timings, list) else ()
    for one in pairs:
        if isinstance(one, tuple) and (took := _number(one[1])) is not None:
            log.stage_s[str(one[0])] = log.stage_s.get(str(one[0]), 0.0) + took


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
