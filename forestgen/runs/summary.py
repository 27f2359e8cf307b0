"""What a run made: for people, run/summary.json and run/jobs.parquet."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from forestgen.runs.contract import RUN, Failed, JobRecord, Place

JOBS_TABLE = f"{RUN}/jobs.parquet"
SUMMARY = f"{RUN}/summary.json"
_COLUMNS = {"image": "int64", "split": "string", "attempt": "int64", "worker": "string", "seconds": "float64"}
_TYPES: dict[str, Any] = {  # of a job_done's fields; a log that a disk or a hand has damaged may hold anything
    **dict.fromkeys(("image", "attempt", "peak_memory_bytes", "frames"), int),
    **dict.fromkeys(("split", "worker", "time"), str),
    **{"seconds": (int, float), "timings_s": dict},
}


@dataclass(frozen=True)
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
    image_notes: tuple[str, ...] = field(default=(), repr=False)  # on the images that this run has made
    last: JobRecord | None = field(default=None, repr=False)  # of the image that was finished last


def write_summary(place: Place, summary: RunSummary) -> None:
    """Write run/summary.json."""
    plain = {
        "images": summary.images,
        "already": summary.already,
        "made": summary.made,
        "failed": [one.job.image for one in summary.failed],
        "missing": list(summary.missing),
        "frames": summary.frames,
        "bytes": summary.bytes,
        "total_s": summary.seconds,
        "timings_s": dict(summary.stages_s),
        "peak_memory_bytes": summary.peak_memory_bytes,
        "notes": list(summary.notes),
    }
    place.write(SUMMARY, (json.dumps(plain, indent=1) + "\n").encode())


def write_jobs_table(place: Place, lines: Iterable[Mapping[str, Any]], images: range) -> None:
    """Write run/jobs.parquet: a row an image, what the log's last `job_done` says of it.

    Parameters
    ----------
    lines : of the log.
    images : numbers of the batch's images.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    done = (line for line in lines if line.get("event") == "job_done" and _is_sound(line))
    last = {line["image"]: line for line in done if line["image"] in images}
    rows = [last[image] for image in sorted(last)]
    columns: dict[str, Any] = {name: pa.array([row[name] for row in rows], kind) for name, kind in _COLUMNS.items()}
    columns["peak_memory_bytes"] = pa.array([row["peak_memory_bytes"] for row in rows], "int64")
    columns["frames"] = pa.array([row["frames"] for row in rows], "int64")
    times = pa.map_(pa.string(), pa.float64())
    columns["timings_s"] = pa.array([list(row["timings_s"].items()) for row in rows], times)
    columns["finished"] = pa.array([row["time"] for row in rows], "string")
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns), buffer)
    place.write(JOBS_TABLE, buffer.getvalue())


def _is_sound(line: Mapping[str, Any]) -> bool:
    """Whether a `job_done` of the log has all of its fields, in their types."""
    sizes = (line.get("image"), line.get("attempt"), line.get("peak_memory_bytes"), line.get("frames"))
    return (
        all(isinstance(line.get(name), kind) for name, kind in _TYPES.items())
        and all(isinstance(size, int) and 0 <= size < 2**63 for size in sizes)
        and all(isinstance(seconds, int | float) for seconds in line["timings_s"].values())
    )
