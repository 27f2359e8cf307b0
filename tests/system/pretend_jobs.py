"""Jobs that render nothing, for tests of engines and runs: tiny frames whose bytes follow from the job's key.

What goes wrong is told by files in the folder that the environment variable FAULTS names, so that worker processes see
it too; they are imported there, and few modules are.
"""

from __future__ import annotations

import hashlib
import os
import signal
import time
from pathlib import Path

from forestgen.runs.contract import Done, Failed, Job, JobRecord, JobRun, Outcome, Work
from forestgen.runs.records import record_bytes, record_path

FAULTS = "FORESTGEN_TEST_FAULTS"
TWO_CAMERAS = ("left", "right")


def make(work: Work, job: Job, attempt: int) -> Outcome:
    """Two frames, put into place one after the other, then the record; as `batch.work.make_job`."""
    faults = Path(os.environ[FAULTS])
    with (faults / "begun.txt").open("a") as journal:
        journal.write(f"{job.image}\n")
    time.sleep(_number(faults / "seconds"))
    _die_or_hoard(faults, job)
    if (faults / f"fail-{job.image}").exists():
        kind, _, message = (faults / f"fail-{job.image}").read_text().partition(" ")
        return Failed(job, attempt, kind, message, 0.0, str(os.getpid()))  # type: ignore[arg-type]
    staging = work.storage.staging()
    files, rows = {}, []
    for camera in TWO_CAMERAS:
        frame = f"{job.image:06d}-{camera}"
        (staging / frame).mkdir()
        for name in ("preview.bin", "mask.bin"):
            content = hashlib.sha256(f"{job.key} {frame} {name}".encode()).digest() * 500
            (staging / frame / name).write_bytes(content)
            said = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
            files[f"{job.split}/{frame}/{name}"] = said
        folder = f"{job.split}/{frame}"
        place = {"frame": frame, "folder": folder, "split": job.split, "image": job.image, "camera": camera}
        rows.append({**place, "width_px": 8, "height_px": 8, "channels": ["R", "G", "B"], "plants_in_view": 0})
    for camera in TWO_CAMERAS:
        frame = f"{job.image:06d}-{camera}"
        work.storage.put_folder(staging / frame, f"{job.split}/{frame}")
        time.sleep(_number(faults / "seconds") / 4)  # a moment to die in
    report = {"image": job.image, "seed": 0, "counts": {}}
    record = JobRecord(job.key, job.image, job.split, 0, "0" * 64, tuple(rows), files, report)
    work.storage.write(record_path(job.key), record_bytes(record))
    work.storage.discard(staging)
    return Done(job, record, JobRun(job.image, attempt, str(os.getpid()), 0.01, {"sleep": 0.01}, 1))


def _die_or_hoard(faults: Path, job: Job) -> None:
    once = faults / f"die-{job.image}"
    if once.exists():
        once.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    stops = faults / f"stop-{job.image}"
    if stops.exists():
        stops.unlink()
        os.kill(os.getpid(), signal.SIGSTOP)
    if (faults / f"hoard-{job.image}").exists():
        hoard = []
        for _ in range(100):
            hoard.append(b"x" * 20_000_000)
            time.sleep(0.02)


def _number(path: Path) -> float:
    return float(path.read_text()) if path.exists() else 0.0


def begun(faults: Path) -> list[int]:
    """Numbers of the images whose jobs have begun, each as often as it has."""
    path = faults / "begun.txt"
    return [int(line) for line in path.read_text().split()] if path.exists() else []
