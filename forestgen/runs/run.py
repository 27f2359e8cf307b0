"""A batch from start to end, whoever does the work."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from forestgen.core.errors import DatasetError, ForestgenError, OutputError, RecipeError
from forestgen.dataset.data_set import check_one_data_set, check_splits, check_stands, data_set_of
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.splits import used_splits
from forestgen.runs.contract import TRANSIENT, Done, Engine, Failed, JobRecord, Lock, Notice, Outcome, Place, Work
from forestgen.runs.damage import damaged_images
from forestgen.runs.discards import check_discards, resume_diff
from forestgen.runs.finish import Finished, finish
from forestgen.runs.folder import TAKEN, check_ours, check_resume, fingerprint, open_batch, settle_batch
from forestgen.runs.jobs import JobQueue
from forestgen.runs.keys import versions_hash
from forestgen.runs.log import Log, done_fields, failed_fields
from forestgen.runs.meter import Listener, Meter, SilentListener
from forestgen.runs.places import LocalPlace, place_of
from forestgen.runs.records import done_keys, records_of
from forestgen.runs.replace import recover, replacing
from forestgen.runs.summary import RunSummary, write_jobs_table, write_summary
from forestgen.scene.planning import check_plan

_AHEAD = 2  # jobs that are drawn and handed on, for each worker; one by one where the first failure ends the run
_WAIT_S = 1.0
_PROGRESS_EVERY_S = 60.0  # in the log
_HOPELESS = 10  # images failed and not one made: the others would fail too
_REPORT = "report.html"


@dataclass
class _Run:
    """What the steps of a run share."""

    work: Work
    lock: Lock
    log: Log
    meter: Meter
    queue: JobQueue
    listener: Listener
    retries: int
    strict: bool
    submitted: set[str] = field(default_factory=set)  # keys of all jobs handed out
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # on the images made
    last: JobRecord | None = None  # of the image that was finished last
    peak_memory_bytes: int = 0
    logged_s: float = 0.0

    def notice(self, event: str, fields: Mapping[str, str]) -> None:
        """What an engine tells of its workers."""
        self.log.event(event, **fields)
        self.listener.say(fields["message"])


def run_batch(
    loaded: LoadedRecipe,
    target: str,
    *,
    count: int,
    engine: Callable[[Work, Notice], Engine],
    resume: bool = False,
    discard: bool = False,
    overwrite: bool = False,
    retries: int = 2,
    strict: bool = False,
    threads: int | None = None,
    memory_bytes: int | None = None,
    listener: Listener | None = None,
) -> RunSummary:
    """Make the first `count` images of a recipe into a data set: all of them, or those that it lacks.

    Parameters
    ----------
    target : a folder, or the address of an object store.
    engine : makes what does the jobs, given what they need, and whom to tell which workers come and go.
    resume : go on in a data set that is there; without it, one that is there is refused. Finished images of which a
        file is missing or damaged are made again.
    discard : whether finished images may be thrown away that are too many, or that would be made otherwise now.
    overwrite : replace a data set that is there, which comes back if no image of the new one is finished.
    retries : attempts after the first, of jobs whose failure may pass.
    strict : an image that cannot be drawn ends the run with its own error; the others before it are made. A run that
        ends before an image is finished leaves nothing; so does one with `overwrite`.
    threads, memory_bytes : of each worker; None: no bound.
    listener : told how it goes.

    Raises
    ------
    RecipeError, ResourceError : see `check_recipe` and `check_discards`.
    OutputError : the place cannot be used, or storage fails for good; what is done stays.
    DatasetError : the first images all fail.
    """
    listener = listener or SilentListener()
    images = images_of(loaded, count)
    settings, splits = check_recipe(loaded, images)
    work = Work(loaded, settings, place_of(target), versions_hash(), threads, memory_bytes)
    check_ours(work.place)
    with work.place.lock(listener.say) as lock:
        check_resume(work.place, resume=resume or overwrite)
        recover(work.place, listener.say)
        with replacing(work.place, splits, listener.say, overwrite=overwrite, keep_begun=not strict):
            mark = fingerprint(loaded, work.versions)
            before = resume_diff(work.place, loaded, images, mark, work.versions, listener.say)
            check_discards(before, work.place.name, agreed=discard)
            _clear_staging(work.place)
            used = used_splits(splits, images)
            damaged = damaged_images(work.place, loaded, images, before.stale, listener.say)
            with Log(work.place) as log:
                work.place.discard(work.place.staging())  # what cannot be written is told before anything is removed
                known = open_batch(work.place, images, used, mark, listener.say, before.stale, damaged)
                queue = JobQueue(work, images, splits, known)
                run = _Run(work, lock, log, Meter(count, already=queue.done), queue, listener, retries, strict)
                _log_start(run, target, damaged)
                return _make_and_finish(run, engine, images, used, mark)


def _log_start(run: _Run, target: str, damaged: Mapping[int, str]) -> None:
    loaded, images = run.work.loaded, run.meter.total
    run.log.event(
        "start", target=target, recipe=str(loaded.path), images=images, done=run.queue.done, threads=run.work.threads
    )
    for image, problem in damaged.items():
        run.log.event("image_damaged", image=image, message=problem)


def _make_and_finish(
    run: _Run, engine: Callable[[Work, Notice], Engine], images: range, splits: list[str], mark: str
) -> RunSummary:
    """Make the images that are missing, then the files over all of them; `splits`: that they are in."""
    work = run.work
    try:
        _make_all(run, engine(work, run.notice))
        settle_batch(work.place, splits, mark)
        return _finish(run, images)
    except BaseException as error:
        _count_made(run)
        _log_stop(run, error)
        raise
    finally:
        _clear_staging(work.place)


def images_of(loaded: LoadedRecipe, count: int) -> range:
    """Numbers of the first `count` images of a recipe."""
    first = int(loaded.complete["first_image"])
    return range(first, first + count)


def check_recipe(loaded: LoadedRecipe, images: range) -> tuple[DatasetSettings, dict[str, float]]:
    """Settings of the data set, and the splits with their shares, of a recipe that passes every check.

    Parameters
    ----------
    images : numbers of those that are wanted.

    Raises
    ------
    RecipeError : at an end of its distributions the recipe asks for the impossible, or for several data sets.
    ResourceError : an image would need more memory than is free.
    """
    plan = check_plan(loaded)
    settings = data_set_of(plan.drawn)
    for drawn in loaded.probes():
        check_one_data_set(drawn, settings)
    splits = dict(plan.drawn.recipe.dataset.splits)
    for name in TAKEN:
        if name in splits:
            raise RecipeError(
                "a split cannot have this name: the data set's folder uses it",
                where=plan.drawn.where("dataset", "splits", name),
                expected="another than " + ", ".join(TAKEN),
                got=name,
            )
    used = used_splits(splits, images)
    check_splits(loaded, used)
    check_stands(plan.community, loaded, used)
    return settings, splits


def _make_all(run: _Run, engine: Engine) -> None:
    """Hand out jobs, a few ahead of the workers, until each is done or given up."""
    in_flight = 0
    run.listener.show(run.meter)
    with engine:
        while True:
            in_flight += _hand_out(run, engine, in_flight)
            if not in_flight:
                return
            for outcome in engine.wait(_WAIT_S):
                in_flight -= 1
                _account(run, outcome)
            run.lock.check()
            _tell(run)


def _hand_out(run: _Run, engine: Engine, in_flight: int) -> int:
    """How many jobs were submitted."""
    handed = 0
    run.meter.workers = engine.workers
    ahead = 1 if run.strict else _AHEAD * max(1, engine.workers)
    while in_flight + handed < ahead:
        task = run.queue.next()
        run.meter.already = run.queue.done
        if task is None:
            break
        if isinstance(task, Failed):
            _give_up(run, task)
        else:
            run.submitted.add(task[0].key)
            engine.submit(*task)
            handed += 1
    return handed


def _account(run: _Run, outcome: Outcome) -> None:
    if isinstance(outcome, Done):
        run.meter.count(outcome.run.timings_s)
        run.last = outcome.record
        run.notes += outcome.record.notes
        run.peak_memory_bytes = max(run.peak_memory_bytes, outcome.run.peak_memory_bytes)
        run.log.event("job_done", **done_fields(outcome))
        return
    if outcome.kind == "worker":
        run.log.event("worker_lost", worker=outcome.worker, image=outcome.job.image, message=outcome.message)
    if outcome.kind not in TRANSIENT or outcome.attempt > run.retries:
        _give_up(run, outcome)
        return
    run.meter.retried += 1
    run.log.event("job_failed", **failed_fields(outcome), will_retry=True)
    run.queue.again(outcome.job, outcome.attempt + 1)


def _give_up(run: _Run, failed: Failed) -> None:
    """An image that will not be made; the run goes on, unless the others would fail alike."""
    run.failed.append(failed)
    run.meter.failed += 1
    run.log.event("job_failed", **failed_fields(failed), will_retry=False)
    if run.strict and failed.error is not None:
        raise failed.error
    if failed.kind == "output":
        raise OutputError(
            f"the run has stopped: results cannot be written\n{failed.message}",
            where=run.work.place.name,
            hint="when that is mended, the same command with `resume=True` goes on",
        )
    if run.meter.failed >= _HOPELESS and not run.meter.done:
        kinds = Counter(one.message for one in run.failed)
        message, times = kinds.most_common(1)[0]
        raise DatasetError(
            f"the run has stopped: the first {run.meter.failed} images all failed, {times} of them with\n{message}",
            where=run.work.place.name,
            hint="the same command with `resume=True` tries them again",
        )


def _tell(run: _Run) -> None:
    run.listener.show(run.meter)
    now = time.monotonic()
    if now - run.logged_s > _PROGRESS_EVERY_S:
        run.logged_s = now
        run.log.event("progress", **run.meter.as_event())


def _finish(run: _Run, images: range) -> RunSummary:
    """The files over all images, the report, and the counts."""
    place, meter = run.work.place, run.meter
    run.listener.say("writing the files over all images")
    records = records_of(place, run.listener.say)
    whole = finish(place, run.work.loaded, run.work.settings, run.queue.all_jobs(), records)
    run.log.event("progress", **meter.as_event())
    run.log.event("finish", images=meter.total, frames=whole.frames, bytes=whole.bytes, missing=list(whole.missing))
    run.log.upload()
    write_jobs_table(place, run.log.lines(), images)
    report, why = _write_report(place)
    summary = _summary(run, whole, report, (*whole.notes, *why))
    write_summary(place, summary)
    return summary


def _write_report(place: Place) -> tuple[str | None, list[str]]:
    """Path of report.html, of a data set in a folder. Its failure is a note, as nothing depends on it."""
    from forestgen.dataset.report.page import write_report  # loads the template engine

    if not isinstance(place, LocalPlace):
        return None, ["no report was written: `forestgen report` makes it of a copy in a folder"]
    try:
        staging = place.staging()  # a run that is killed leaves no half of it beside the data set
        write_report(place.root, staging / _REPORT)
        place.put_file(staging / _REPORT, _REPORT)
        place.discard(staging)
    except ForestgenError as error:
        return None, [f"no report was written: {error}"]
    return f"{place.name}/{_REPORT}", []


def _summary(run: _Run, whole: Finished, report: str | None, notes: tuple[str, ...]) -> RunSummary:
    meter = run.meter
    return RunSummary(
        target=run.work.place.name,
        images=meter.total,
        already=meter.already,
        made=meter.made,
        failed=tuple(sorted(run.failed, key=lambda failed: failed.job.image)),
        missing=whole.missing,
        frames=whole.frames,
        bytes=whole.bytes,
        report=report,
        seconds=time.monotonic() - meter.started_s,
        images_per_hour=meter.images_per_hour,
        stages_s=dict(sorted(meter.stages_s.items(), key=lambda stage: -stage[1])),
        peak_memory_bytes=run.peak_memory_bytes,
        notes=notes,
        image_notes=tuple(run.notes),
        last=run.last,
    )


def _count_made(run: _Run) -> None:
    """Count the images by their records: a run that is stopped may not have heard of the last ones."""
    if run.submitted:
        with suppress(ForestgenError):  # what has stopped the run matters more
            run.meter.made = len(run.submitted & done_keys(run.work.place))


def _log_stop(run: _Run, error: BaseException) -> None:
    """Why the run ended early; the error itself matters more than that the log may fail too."""
    if isinstance(error, ForestgenError):
        reason = str(error)
    else:
        reason = f"{type(error).__name__}: {error}" if isinstance(error, Exception) else "interrupted"
    try:
        run.log.event("stop", reason=reason, **run.meter.as_event())
        run.log.upload()
    except ForestgenError:
        return


def _clear_staging(place: Place) -> None:
    """What lies there is of jobs that nobody does any more."""
    if isinstance(place, LocalPlace):
        place.clear_staging()
