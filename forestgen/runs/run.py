"""A batch from start to end, with any engine."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from forestgen.core.errors import DatasetError, ForestgenError, OutputError, RecipeError
from forestgen.dataset.settings import DatasetSettings, check_one_data_set, check_splits, check_stands, data_set_of
from forestgen.recipe.dataset import split_of, used_splits
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs import folder
from forestgen.runs.contract import (
    TRANSIENT,
    Done,
    Engine,
    Failed,
    Job,
    JobRecord,
    Lock,
    Notice,
    Outcome,
    RunOptions,
    StorageBackend,
    Work,
)
from forestgen.runs.finish import finish
from forestgen.runs.records import done_keys, job_key, records_of, versions_hash
from forestgen.runs.remote_storage import storage_of
from forestgen.runs.replace import check_replaceable, recover, replacing
from forestgen.runs.stale_outputs import ResumeDiff, check_stale_outputs, damaged_images, resume_diff
from forestgen.runs.storage import LocalStorage
from forestgen.runs.summary import (
    Display,
    Log,
    ProgressTracker,
    RunSummary,
    SilentDisplay,
    job_fields,
    write_jobs_table,
    write_summary,
)
from forestgen.scene.plan import check_plan

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
    queue: JobQueue
    display: Display
    retries: int
    strict: bool
    tracker: ProgressTracker = field(init=False)
    submitted: set[str] = field(default_factory=set)  # keys of all jobs handed out
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # on the images made
    last: JobRecord | None = None  # of the image that was finished last
    peak_memory_bytes: int = 0
    logged_s: float = 0.0

    def __post_init__(self) -> None:
        self.tracker = ProgressTracker(len(self.queue.images), already=self.queue.done)

    def notice(self, event: str, fields: Mapping[str, str]) -> None:
        """Log and show an engine's event."""
        self.log.event(event, **fields)
        self.display.say(fields["message"])


def run_batch(
    loaded: LoadedRecipe,
    target: str,
    options: RunOptions,
    engine: Callable[[Work, Notice], Engine],
    prepare: Callable[[Work, int], Work] = lambda work, left: work,
    *,
    strict: bool = False,
    display: Display | None = None,
) -> RunSummary:
    """Make the first images of a recipe into a data set: all of them, or those that it lacks.

    `target`: a folder, or the address of an object store.
    `engine`: makes what does the jobs, given what they need, and whom to tell which workers come and go.
    `prepare`: given the work and the number of images that are to be made, before anything is changed: refuses what
    cannot fit, and returns the work with the threads of each worker.
    `strict`: an image that cannot be drawn or made ends the run with its own error; the others before it are made. A
    run that ends before an image is finished leaves nothing; so does one with `options.overwrite`.

    Raises `RecipeError`, `ResourceError`: see `check_recipe`, `check_stale_outputs` and `prepare`.
    Raises `OutputError`, `DatasetError`: the storage fails for good, or the first images all fail; what is done stays.
    """
    display, overwrite = display or SilentDisplay(), options.overwrite
    count = options.count or loaded.images
    storage, images = storage_of(target), images_of(loaded, count)
    folder.check_ours(storage)
    settings, splits = check_recipe(loaded, images)
    work = Work(loaded, settings, storage, versions_hash(), options.threads, options.memory_bytes)
    with storage.lock(display.say) as lock:
        folder.check_resume(storage, resume=options.resume or overwrite)
        recover(storage, display.say)
        mark = folder.fingerprint(loaded, work.versions)
        before = finished_images(work, images, splits, mark, display.say, overwrite=overwrite)
        check_stale_outputs(before, storage.name, agreed=options.discard)
        work = prepare(work, count - before.kept)
        with replacing(storage, splits, display.say, overwrite=overwrite, keep_begun=not strict):
            storage.clear_staging()
            used = used_splits(splits, images)
            damaged = damaged_images(storage, loaded, images, before.stale, display.say)
            with Log(storage) as log:
                storage.discard(storage.staging())  # raises if nothing can be written, before anything is removed
                known = folder.open_batch(storage, images, used, mark, display.say, before.stale, damaged)
                retries = 0 if strict else options.retries
                queue = JobQueue(work, images, splits, known, before.stale)
                run = _Run(work, lock, log, queue, display, retries, strict)
                about = {"images": len(images), "done": run.queue.done, "threads": work.threads}
                log.event("start", target=target, recipe=str(loaded.path), **about)
                for image, problem in damaged.items():
                    log.event("image_damaged", image=image, message=problem)
                return _make_and_finish(run, engine, images, used, mark)


def finished_images(
    work: Work, images: range, splits: Mapping[str, float], mark: str, say: Callable[[str], None], *, overwrite: bool
) -> ResumeDiff:
    """The finished images that a run finds; with `overwrite`, none of a data set that can be replaced."""
    if not overwrite:
        return resume_diff(work.storage, work.loaded, images, mark, work.versions, say)
    check_replaceable(work.storage, splits)
    return ResumeDiff(0, 0, frozenset())


def _make_and_finish(
    run: _Run, engine: Callable[[Work, Notice], Engine], images: range, splits: list[str], mark: str
) -> RunSummary:
    """Make the images that are missing, then the files over all of them; `splits`: that they are in."""
    work = run.work
    try:
        _make_all(run, engine(work, run.notice))
        folder.settle_batch(work.storage, splits, mark)
        return _finish(run, images)
    except BaseException as error:
        _log_stop(run, error)
        raise
    finally:
        work.storage.clear_staging()


def images_of(loaded: LoadedRecipe, count: int) -> range:
    """Numbers of the first `count` images of a recipe."""
    first = int(loaded.complete["first_image"])
    return range(first, first + count)


def check_recipe(loaded: LoadedRecipe, images: range) -> tuple[DatasetSettings, dict[str, float]]:
    """Settings of the data set, and the splits with their shares, of a recipe that passes every check.

    `images`: numbers of those that are wanted.

    Raises `RecipeError`: at an end of its distributions the recipe asks for the impossible, or for several data sets.
    Raises `ResourceError`: an image would need more memory than is free.
    """
    plan = check_plan(loaded)
    settings = data_set_of(plan.drawn)
    for drawn in loaded.probes():
        check_one_data_set(drawn, settings)
    splits = dict(plan.drawn.recipe.dataset.splits)
    for name in folder.TAKEN:
        if name in splits:
            problem = "a split cannot have this name: the data set's folder uses it"
            where = plan.drawn.where("dataset", "splits", name)
            raise RecipeError(problem, where=where, expected="another than " + ", ".join(folder.TAKEN), got=name)
    used = used_splits(splits, images)
    check_splits(loaded, used)
    check_stands(plan.community, loaded, used)
    return settings, splits


def _make_all(run: _Run, engine: Engine) -> None:
    """Hand out jobs, a few ahead of the workers, until each is done or given up."""
    in_flight = 0
    run.display.show(run.tracker)
    with engine:
        while True:
            in_flight += _hand_out(run, engine, in_flight)
            if not in_flight:
                return
            for outcome in engine.wait(_WAIT_S):
                in_flight -= 1
                _account(run, outcome)
            run.lock.check()
            run.display.show(run.tracker)
            if time.monotonic() - run.logged_s > _PROGRESS_EVERY_S:
                run.logged_s = time.monotonic()
                run.log.event("progress", **run.tracker.as_event())


def _hand_out(run: _Run, engine: Engine, in_flight: int) -> int:
    """How many jobs were submitted."""
    handed = 0
    run.tracker.workers = engine.workers
    ahead = 1 if run.strict else _AHEAD * max(1, engine.workers)
    while in_flight + handed < ahead:
        task = run.queue.next()
        run.tracker.already = run.queue.done
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
        run.tracker.count(outcome.run.timings_s)
        run.last = outcome.record
        run.notes += outcome.record.notes
        run.peak_memory_bytes = max(run.peak_memory_bytes, outcome.run.peak_memory_bytes)
        run.log.event("job_done", **job_fields(outcome))
        return
    if outcome.kind == "worker":
        run.log.event("worker_lost", worker=outcome.worker, image=outcome.job.image, message=outcome.message)
    if outcome.kind not in TRANSIENT or outcome.attempt > run.retries:
        _give_up(run, outcome)
        return
    run.tracker.retried += 1
    run.log.event("job_failed", **job_fields(outcome), will_retry=True)
    run.queue.again(outcome.job, outcome.attempt + 1)


def _give_up(run: _Run, failed: Failed) -> None:
    """An image that will not be made; the run goes on, unless the others would fail alike."""
    run.failed.append(failed)
    run.tracker.failed += 1
    run.log.event("job_failed", **job_fields(failed), will_retry=False)
    if run.strict and failed.error is not None:
        raise failed.error
    if failed.kind == "output":
        problem, where = f"the run has stopped: results cannot be written\n{failed.message}", run.work.storage.name
        raise OutputError(problem, where=where, hint="when that is mended, the same command with `resume=True` goes on")
    if run.tracker.failed >= _HOPELESS and not run.tracker.done:
        kinds = Counter(one.message for one in run.failed)
        message, times = kinds.most_common(1)[0]
        raise DatasetError(
            f"the run has stopped: the first {run.tracker.failed} images all failed, {times} of them with\n{message}",
            where=run.work.storage.name,
            hint="the same command with `resume=True` tries them again",
        )


def _finish(run: _Run, images: range) -> RunSummary:
    """The files over all images, the report, and the counts."""
    storage, tracker = run.work.storage, run.tracker
    run.display.say("writing the files over all images")
    records = records_of(storage, run.display.say)
    whole = finish(storage, run.work.loaded, run.work.settings, run.queue.all_jobs(), records)
    run.log.event("progress", **tracker.as_event())
    run.log.event("finish", images=tracker.total, frames=whole.frames, bytes=whole.bytes, missing=list(whole.missing))
    run.log.upload()
    write_jobs_table(storage, run.log.lines(), images)
    report, why = _write_report(storage)
    summary = RunSummary(
        target=storage.name,
        images=tracker.total,
        already=tracker.already,
        made=tracker.made,
        failed=tuple(sorted(run.failed, key=lambda failed: failed.job.image)),
        missing=whole.missing,
        frames=whole.frames,
        bytes=whole.bytes,
        report=report,
        seconds=time.monotonic() - tracker.started_s,
        images_per_hour=tracker.images_per_hour,
        stages_s=tracker.longest_stages_s,
        peak_memory_bytes=run.peak_memory_bytes,
        notes=(*whole.notes, *why),
        image_notes=tuple(run.notes),
        last=run.last,
    )
    write_summary(storage, summary)
    return summary


def _write_report(storage: StorageBackend) -> tuple[str | None, list[str]]:
    """Path of report.html, of a data set in a folder. Its failure is a note, as nothing depends on it."""
    from forestgen.dataset.report.page import write_report  # loads the template engine

    if not isinstance(storage, LocalStorage):
        return None, ["no report was written: `forestgen report` makes it of a copy in a folder"]
    try:
        staging = storage.staging()  # a run that is killed leaves no half of it beside the data set
        write_report(storage.root, staging / _REPORT)
        storage.put_file(staging / _REPORT, _REPORT)
        storage.discard(staging)
    except ForestgenError as error:
        return None, [f"no report was written: {error}"]
    return f"{storage.name}/{_REPORT}", []


def _log_stop(run: _Run, error: BaseException) -> None:
    """Count the images made, and log why the run ended early; the error itself matters more than that these may fail.

    They are counted by their records: a run that is stopped may not have heard of the last ones.
    """
    if isinstance(error, ForestgenError):
        reason = str(error)
    else:
        reason = f"{type(error).__name__}: {error}" if isinstance(error, Exception) else "interrupted"
    with suppress(ForestgenError):
        if run.submitted:
            run.tracker.made = len(run.submitted & done_keys(run.work.storage))
    with suppress(ForestgenError):
        run.log.event("stop", reason=reason, **run.tracker.as_event())
        run.log.upload()


class JobQueue:
    """Jobs with their attempts; those that are tried again come first.

    `images`: numbers of the images that are wanted.
    `splits`: name -> share.
    `known`: the images whose records are there. A stale one is forgotten when its turn comes.
    """

    def __init__(
        self, work: Work, images: range, splits: Mapping[str, float], known: Mapping[int, str], stale: Collection[int]
    ) -> None:
        self._loaded, self._versions = work.loaded, work.versions
        self._storage = work.storage
        self.images, self._splits, self._known, self._stale = images, splits, known, stale
        self._again: deque[tuple[Job, int]] = deque()
        self._fresh = self._draw_all()
        self.done = sum(image not in stale for image in known)
        self.keys: dict[int, str] = {}  # image -> key, of all images that have had their turn

    def next(self) -> tuple[Job, int] | Failed | None:
        """A job and its attempt; an image that cannot be drawn; None if there is nothing to hand out now."""
        if self._again:
            return self._again.popleft()
        return next(self._fresh, None)

    def again(self, job: Job, attempt: int) -> None:
        """Try a job again, before all others."""
        self._again.append((job, attempt))

    def all_jobs(self) -> list[Job]:
        """Of every image that was handed out or known, by image."""
        return [self._job(image, self.keys[image]) for image in self.images]

    def _draw_all(self) -> Iterator[tuple[Job, int] | Failed]:
        for image in self.images:
            known = self._known.get(image)
            if known is not None and image not in self._stale:
                self.keys[image] = known
                continue
            if known is not None:
                folder.forget_key(self._storage, known)
            self.keys[image] = ""
            try:
                self.keys[image] = job_key(self._loaded.draw(image - self.images.start), self._versions)
            except ForestgenError as error:  # a drawn value that the schema rejects
                yield Failed(self._job(image, ""), 1, "recipe", str(error), error=error)
            else:
                yield self._job(image, self.keys[image]), 1

    def _job(self, image: int, key: str) -> Job:
        return Job(image - self.images.start, image, split_of(self._splits, image), key)
