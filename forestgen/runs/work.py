"""A job, done: an image's frames made in a staging folder, put into the data set, and their record written last."""

from __future__ import annotations

import os
import platform
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from forestgen.core import errors
from forestgen.core.errors import STORAGE_ERRNOS, output_error
from forestgen.core.processes import whole_bytes
from forestgen.core.progress import Progress, Silent, Timings
from forestgen.core.registry import explained_bug
from forestgen.core.threads import cores, limit_cores
from forestgen.dataset.manifest import file_sum, peak_memory_bytes
from forestgen.dataset.png import thumbnail_name, write_thumbnail
from forestgen.dataset.settings import check_one_data_set
from forestgen.pipeline import assemble_image, write_image
from forestgen.recipe.assets import MAPS
from forestgen.recipe.map_files import recipe_hash
from forestgen.render.variant import mitsuba
from forestgen.runs.contract import Done, Failed, FailureKind, Job, JobRecord, JobRun, Outcome, StorageBackend, Work
from forestgen.runs.records import job_key, record_bytes, record_path
from forestgen.scene.plan import check_memory, make_plan

_FRAMES = "frames"  # of a staging folder: what belongs into the split's folder


class _StorageFailedError(Exception):
    """The data set's storage has failed; `__cause__` is the error."""


def make_job(work: Work, job: Job, attempt: int) -> Outcome:
    """Do a job: draw, check, render, label, put into place. Its failure is an outcome, never an exception."""
    start = time.perf_counter()
    try:
        # What is free now says nothing: the estimate is an upper one, and the other workers hold their part already.
        return complete(work, job, attempt, Silent(), memory_budget_bytes=whole_bytes())
    except Exception as error:  # noqa: BLE001 - whatever an image breaks on, the other images go on
        return failed(job, attempt, error, start)


def make_here(work: Work, job: Job, attempt: int, progress: Progress) -> Done:
    """Do a job in this process. Its failure is the error that it raised; one of the storage is an `OutputError`."""
    try:
        return complete(work, job, attempt, progress)
    except _StorageFailedError as error:
        cause = error.__cause__
        if not isinstance(cause, errors.OutputError):
            raise output_error(cast(OSError, cause)) from cause
        raise cause from cause.__cause__
    except OSError as error:
        if error.errno not in STORAGE_ERRNOS:
            raise
        raise output_error(error, None if error.filename else Path(work.storage.name)) from error


class InProcessEngine:
    """The engine of `render`: images made one after another in this process; see `contract.Engine`.

    An image that fails brings its error, which the run raises; finished images stay. `progress` shows the stages of
    each.
    """

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work, self._progress = work, progress
        self._queue: deque[tuple[Job, int]] = deque()

    def __enter__(self) -> InProcessEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.clear()
        if self._work.threads is not None:
            limit_cores(None)
            mitsuba(cores())

    @property
    def workers(self) -> int:
        return 1

    def submit(self, job: Job, attempt: int) -> None:
        self._queue.append((job, attempt))

    def wait(self, timeout_s: float) -> list[Outcome]:
        """Make one image, however long it takes."""
        if not self._queue:
            return []
        job, attempt = self._queue.popleft()
        began_s = time.perf_counter()
        try:
            return [make_here(self._work, job, attempt, self._progress)]
        except Exception as error:  # noqa: BLE001 - the run logs it, and raises it
            return [replace(failed(job, attempt, error, began_s), error=error)]


def failed(job: Job, attempt: int, error: Exception, start_s: float) -> Failed:
    """The outcome of a job that this process has failed at, begun at `start_s` of the performance counter."""
    return Failed(job, attempt, failure_kind(error), explained(error), time.perf_counter() - start_s, _worker_name())


def _worker_name() -> str:
    """Who this process is, in logs."""
    return f"{platform.node()}:{os.getpid()}"


def failure_kind(error: BaseException) -> FailureKind:
    """What went wrong, as far as it decides whether another attempt may help."""
    if isinstance(error, MemoryError | errors.ResourceError):
        return "memory"
    if _storage_failed(error):
        return "output"
    if isinstance(error, errors.RecipeError | errors.AssetError | errors.LsystemError | errors.OutputError):
        return "recipe"  # also what a format cannot hold, however often it is tried
    return "renderer" if isinstance(error, errors.RenderError) else "bug"


def _storage_failed(error: BaseException | None) -> bool:
    """Whether a disk, a quota or a network is behind an error."""
    while error is not None:
        if isinstance(error, _StorageFailedError) or (
            isinstance(error, errors.OutputError) and error.__cause__ is not None
        ):
            return True  # an `OutputError` without a cause is about what a format cannot hold
        if isinstance(error, OSError) and (error.errno in STORAGE_ERRNOS or isinstance(error, ConnectionError)):
            return True
        error = error.__cause__
    return False


def explained(error: BaseException) -> str:
    """An error for people; of a bug also the place in the code."""
    if isinstance(error, _StorageFailedError) and error.__cause__ is not None:
        return explained(error.__cause__)
    if isinstance(error, errors.ForestgenError):
        return str(error)
    if isinstance(error, MemoryError):
        return "memory ran out\n  try       fewer workers, smaller images or a smaller site"
    if isinstance(error, OSError) and _storage_failed(error):
        return str(output_error(error))
    return explained_bug(error)


def complete(work: Work, job: Job, attempt: int, progress: Progress, *, memory_budget_bytes: int | None = None) -> Done:
    """Do a job: draw, check, render, label, put into place. Any failure is an exception, and leaves no frame.

    `memory_budget_bytes` is the memory that the image may take; None: what is free now.
    """
    timings = Timings()
    if work.threads is not None:
        limit_cores(work.threads)
    with timings("load Mitsuba"):  # at once from the second job on
        mitsuba(work.threads)
    with timings("recipe"):
        drawn = work.loaded.draw(job.index)
        if job_key(drawn, work.versions) != job.key:
            problem = "a file that the recipe names has changed since the batch was started"
            where = str(work.loaded.path)
            hint = "start the batch again with `resume=True`: what has changed is made anew"
            raise errors.AssetError(problem, where=where, expected=f"a drawn recipe of the key {job.key}", hint=hint)
        check_one_data_set(drawn, work.settings)
        plan = make_plan(drawn)
        check_memory(plan, memory_budget_bytes=memory_budget_bytes)
    staging = work.storage.staging()
    try:
        frames = staging / _FRAMES
        frames.mkdir()
        scene = assemble_image(plan, progress, timings, memory_budget_bytes=memory_budget_bytes)
        image = write_image(scene, work.settings, frames, progress, timings)
        with timings("write"):
            for folder in image.folders:
                write_thumbnail(folder, staging / thumbnail_name(folder.name))
            record = JobRecord(
                key=job.key,
                image=job.image,
                split=job.split,
                image_seed=drawn.image_seed,
                recipe_hash=recipe_hash(drawn.data),
                rows=image.rows,
                files=_staged_files(staging, job.split),
                report=image.report,
                notes=image.notes,
            )
            _put_into_place(work.storage, staging, job, record)
    finally:
        work.storage.discard(staging)
    run = JobRun(job.image, attempt, _worker_name(), timings.total(), dict(timings.seconds), peak_memory_bytes())
    return Done(job, record, run)


def _staged_files(staging: Path, split: str) -> dict[str, dict[str, Any]]:
    """Path in the data set's folder -> size and SHA-256, of all staged files."""
    files = {}
    for path in sorted(one for one in staging.rglob("*") if one.is_file()):
        relative = path.relative_to(staging)
        inside = relative.relative_to(_FRAMES) if relative.parts[0] == _FRAMES else None
        name = relative.as_posix() if inside is None else f"{split}/{inside.as_posix()}"
        files[name] = {"bytes": path.stat().st_size, "sha256": file_sum(path)}
    return dict(sorted(files.items()))


def _put_into_place(storage: StorageBackend, staging: Path, job: Job, record: JobRecord) -> None:
    """Maps, frames, thumbnails, and last the record: with it, the image is done. Before, a failure leaves no frame."""
    frames = sorted(path for path in (staging / _FRAMES).iterdir() if path.name != MAPS)
    maps = sorted((staging / _FRAMES / MAPS).glob("*"))
    try:
        for path in maps:
            target = f"{job.split}/{MAPS}/{path.name}"
            if storage.size_bytes(target) != path.stat().st_size:  # named by content: other jobs bring the same
                storage.put_file(path, target)
        for folder in frames:
            storage.put_folder(folder, f"{job.split}/{folder.name}")
        for name in (thumbnail_name(folder.name) for folder in frames):
            storage.put_file(staging / name, name)
        storage.write(record_path(job.key), record_bytes(record))
    except BaseException as error:
        if not isinstance(error, Exception):
            with suppress(errors.ForestgenError, OSError):
                if storage.exists(record_path(job.key)):
                    raise  # stopped just after the image was done
        for name in (record_path(job.key), *(f"{job.split}/{folder.name}" for folder in frames)):
            with suppress(errors.ForestgenError, OSError):
                storage.remove(name)
        if isinstance(error, errors.OutputError | OSError):
            raise _StorageFailedError from error
        raise
