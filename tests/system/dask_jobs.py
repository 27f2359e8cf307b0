"""Stand-ins for `make_job` that a Dask worker imports by name, and workers that differ from us."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from pathlib import Path

from forestgen.runs.contract import Done, Job, JobRecord, JobRun, Outcome, Work
from forestgen.runs.records import record_bytes, record_path

DOOMED = (
    "FORESTGEN_TEST_DOOMED"  # a folder: the jobs whose numbers are files in it kill their worker, and take the file
)
POISON = 666  # an image that kills every worker


def make(work: Work, job: Job, attempt: int) -> Outcome:
    """A small folder and a record whose bytes depend on the key alone; in between it may die."""
    staging = work.storage.staging()
    frame = staging / f"{job.image:06d}"
    frame.mkdir()
    for name in ("image.bin", "mask.bin"):
        (frame / name).write_bytes(hashlib.sha256(f"{job.key} {name}".encode()).digest() * 100)
    time.sleep(0.05)
    work.storage.put_folder(frame, f"{job.split}/{job.image:06d}")
    _die_if_doomed(job)
    files = {f"{job.split}/{job.image:06d}/{name}": {"bytes": 3200} for name in ("image.bin", "mask.bin")}
    record = JobRecord(job.key, job.image, job.split, 0, "", (), files)
    work.storage.write(record_path(job.key), record_bytes(record))
    work.storage.discard(staging)
    return Done(job, record, JobRun(job.image, attempt, str(os.getpid()), 0.0, {"threads": float(work.threads or 0)}))


def make_slowly(work: Work, job: Job, attempt: int) -> Outcome:
    """As `make`, after a sign that it has begun and a wait for a sign to go on."""
    folder = Path(os.environ[DOOMED])
    (folder / f"begun-{job.image}").touch()
    while not (folder / "go").exists():
        time.sleep(0.02)
    return make(work, job, attempt)


def _die_if_doomed(job: Job) -> None:
    if job.image == POISON:
        os.kill(os.getpid(), signal.SIGKILL)
    doom = Path(os.environ.get(DOOMED, "/nowhere")) / str(job.image)
    try:
        doom.unlink()
    except FileNotFoundError:
        return
    os.kill(os.getpid(), signal.SIGKILL)
