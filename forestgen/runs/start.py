"""How runs start: `render` in this process, `batch` with workers, and the estimate before either."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from forestgen.core.errors import DatasetError
from forestgen.core.figures import count, seconds
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import TRANSIENT, Engine, Notice, RunOptions, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.estimate import BUDGET_S, LEAST_IMAGES, Estimate, check_disk, check_fits, estimate, most_disk_bytes
from forestgen.runs.folder import check_ours, fingerprint
from forestgen.runs.records import versions_hash
from forestgen.runs.remote_storage import storage_of
from forestgen.runs.replace import previous_note
from forestgen.runs.run import check_recipe, finished_images, images_of, run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.summary import Display, RunSummary
from forestgen.runs.work import InProcessEngine, make_job

_MOST_FAILURES = 5  # that an error names


def render(loaded: LoadedRecipe, target: str, options: RunOptions, display: Display) -> RunSummary:
    """Make a recipe's images in this process; the first one that fails raises its error, finished ones stay.

    Raises `RecipeError`, `AssetError`, `ResourceError`, `OutputError`, `RenderError`: what an image or the folder does
    not allow.
    Raises `DatasetError`: images are missing at the end.
    """

    def prepare(work: Work, left: int) -> Work:
        check_disk(work.storage, left, most_disk_bytes(loaded.draw(0)))
        return work

    def engine(work: Work, _: Notice) -> Engine:
        return InProcessEngine(work, display)

    summary = run_batch(loaded, target, options, engine, prepare, strict=True, display=display)
    _check_complete(summary)
    return summary


def batch(loaded: LoadedRecipe, target: str, options: RunOptions, display: Display) -> RunSummary:
    """Make a recipe's images with many workers.

    Raises `RecipeError`, `ResourceError`, `OutputError`: see `forestgen.runs.run.run_batch`.
    Raises `DatasetError`: images failed, or are missing at the end.
    """
    workers = _Workers(options, display)
    summary = run_batch(loaded, target, options, workers.engine, workers.prepare, display=display)
    _check_complete(summary)
    return summary


class _Workers:
    """The workers of a batch: as many as its estimate says, or those of a cluster."""

    def __init__(self, options: RunOptions, display: Display) -> None:
        self._options, self._display = options, display
        self._expected: Estimate

    def prepare(self, work: Work, left: int) -> Work:
        """See `run_batch`."""
        is_local = self._options.engine == "local"
        expected = _estimate(work, left, self._options, self._display)
        check_fits(expected, work.storage, workers_here=is_local)
        for text in expected.lines():
            self._display.say(text)
        self._expected = expected
        return replace(work, threads=expected.threads) if is_local else work  # a Dask worker has its own

    def engine(self, work: Work, notice: Notice) -> Engine:
        """See `run_batch`."""
        options = self._options
        if options.engine == "local":
            return LocalEngine(work, self._expected.workers, make_job, timeout_s=options.timeout_s)
        from forestgen.runs.engines.dask import DaskEngine  # loads Dask

        return DaskEngine(
            work,
            options.scheduler,
            make=make_job,
            resources=options.resources,
            job_memory_bytes=int(self._expected.memory_bytes.mean),
            notice=notice,
        )


@dataclass(frozen=True, repr=False)
class DryRun:
    """What a batch would take, and what it would remove."""

    estimate: Estimate
    discarded: int  # finished images that `resume` with `discard` would remove
    reasons: str  # why, for people

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        images, low_and_high = self.estimate.counts.images, self.estimate.seconds
        time = "not measured" if low_and_high is None else f"about {seconds(low_and_high.mean)}"
        return f"<DryRun: {count(images, 'image')}, {time}>"

    def lines(self) -> Iterator[str]:
        """For people."""
        yield from self.estimate.lines()
        if self.discarded:
            number = count(self.discarded, "finished image")
            yield f"resuming with discard would remove {number}: {self.reasons}"
        yield "nothing was made"


def dry_run(loaded: LoadedRecipe, target: str, options: RunOptions, display: Display) -> DryRun:
    """Check a batch and estimate its time, memory and disk; nothing is made or changed."""
    storage, images = storage_of(target), images_of(loaded, options.count or loaded.images)
    check_ours(storage)
    settings, splits = check_recipe(loaded, images)
    if isinstance(storage, LocalStorage) and (note := previous_note(storage.root)):
        display.say(note)
    work = Work(loaded, settings, storage, versions_hash())
    mark = fingerprint(loaded, work.versions)
    before = finished_images(work, images, splits, mark, display.say, overwrite=options.overwrite)
    expected = _estimate(work, len(images) - before.kept, options, display, probe=True)
    check_fits(expected, storage, workers_here=options.engine == "local")
    return DryRun(expected, before.discarded, before.reasons())


def _estimate(work: Work, left: int, options: RunOptions, display: Display, *, probe: bool = False) -> Estimate:
    """What the images that are not made yet will take, with as many workers as cores and memory allow."""
    if left and (probe or left >= LEAST_IMAGES):
        display.say(f"making some images to measure them: about {BUDGET_S:.0f} s, and longer for large ones")
    workers, threads = options.workers, options.threads
    return estimate(
        work.loaded, work.settings, count=left, workers=workers, threads=threads, progress=display, probe=probe
    )


def _check_complete(summary: RunSummary) -> None:
    """Raise `DatasetError` if an image that was asked for is not in the data set."""
    if not summary.failed and not summary.missing:
        return
    if not summary.failed:
        problem = f"{len(summary.missing):,} of {summary.images:,} images are missing: files have changed meanwhile"
        hint = "the same command with `resume=True` makes them again"
        raise DatasetError(problem, where=summary.target, got="\n".join(summary.notes[:_MOST_FAILURES]), hint=hint)
    shown = [
        f"image {one.job.image} ({one.job.split}), {count(one.attempt, 'attempt')}, {one.kind}: {one.message}"
        for one in summary.failed[:_MOST_FAILURES]
    ]
    if len(summary.failed) > _MOST_FAILURES:
        shown.append(f"... and {len(summary.failed) - _MOST_FAILURES} more: run/log.jsonl has all")
    again = any(failed.kind in TRANSIENT for failed in summary.failed)
    raise DatasetError(
        f"{len(summary.missing):,} of {summary.images:,} images could not be made",
        where=summary.target,
        got="\n".join(shown),
        hint="the same command with `resume=True` tries them again"
        if again
        else "they would fail again in the same way; the data set is finished without them",
    )
