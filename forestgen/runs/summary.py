"""What a run made: for people, run/summary.json and run/jobs.parquet."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from forestgen.core.figures import count, seconds, table_lines
from forestgen.runs.contract import RUN, Failed, JobRecord, Place

JOBS_TABLE = f"{RUN}/jobs.parquet"
SUMMARY = f"{RUN}/summary.json"
_MOST_NOTES, _MOST_STAGES = 5, 5
_COLUMNS = {"image": "int64", "split": "string", "attempt": "int64", "worker": "string", "seconds": "float64"}
_TYPES: dict[str, Any] = {  # of a job_done's fields; a log that a disk or a hand has damaged may hold anything
    **dict.fromkeys(("image", "attempt", "peak_memory_bytes", "frames"), int),
    **dict.fromkeys(("split", "worker", "time"), str),
    **{"seconds": (int, float), "timings_s": dict},
}


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
    dead = f", {report['standing_dead']:,} of them standing dead" if report.get("standing_dead") else ""
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
    rows = [("species", "plants", "exemplars", "rms size error", "rms crown width error")]
    for one in errors:
        rms = (
            "-" if one[name] is None else f"{100 * one[name]:.1f} %"  # no species of its kind has a crown
            for name in ("radius_rms", "crown_width_rms")
        )
        rows.append((one["species"], f"{one['plants']:,}", f"{one['exemplars']:,}", *rms))
    return table_lines(rows)


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
