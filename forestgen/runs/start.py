"""How runs start: `render` in this process, `batch` with workers, and the estimate before either."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from forestgen.core.arguments import flag_of, shown, whole_of
from forestgen.core.errors import DatasetError, RecipeError
from forestgen.core.figures import count, parse_bytes, seconds
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import TRANSIENT, Engine, Failed, Notice, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.estimate import BUDGET_S, LEAST_IMAGES, Estimate, check_disk, check_fits, estimate, most_disk_bytes
from forestgen.runs.folder import check_ours, fingerprint
from forestgen.runs.keys import versions_hash
from forestgen.runs.remote_storage import storage_of
from forestgen.runs.replace import previous_note
from forestgen.runs.run import check_recipe, finished_images, images_of, run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.summary import RunSummary
from forestgen.runs.tracker import Display
from forestgen.runs.work import InProcessEngine, make_job

ENGINES = ("local", "dask")
DEVICES = ("llvm", "cuda")
_LEAST_BYTES = 10**8  # less is a mistake, such as a number without its unit: Python and Mitsuba alone take more
_MOST_FAILURES = 5  # that an error names


@dataclass(frozen=True)
class RunOptions:
    """What `render` and `batch` may be asked for besides the recipe and the folder; they take checked ones."""

    count: int | None = None  # images of the data set, in all; None: as many as the recipe says
    resume: bool = False  # go on in a data set that is there
    discard: bool = False  # with resume: remove finished images that do not belong to the data set any more
    overwrite: bool = False  # replace a previous data set
    threads: int | None = None  # of the renderer, in each worker; None: all cores are shared out
    workers: int | None = None  # processes; None: as many as cores and memory allow
    worker_memory: int | str | None = None  # bytes, or a text such as 4GB; a worker that takes more is stopped
    timeout: float | str | None = None  # seconds, or a text such as 30min, that an image may take
    retries: int = 2  # further attempts at an image whose failure may pass
    engine: str = "local"  # or dask
    scheduler: str | None = None  # address of a Dask scheduler
    resources: Mapping[str, float] | None = None  # that each image takes of a Dask worker
    device: str | None = None  # what traces rays, llvm or cuda; None: what FORESTGEN_TRACING says

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> RunOptions:
        """The options among the arguments of a call, checked."""
        return cls(**{one.name: arguments[one.name] for one in fields(cls) if one.name in arguments}).check()

    def check(self) -> RunOptions:
        """The same with Python's own numbers.

        Raises `RecipeError`: values that are none, or options that exclude one another.
        """
        numbers: dict[str, Any] = {"retries": whole_of(self.retries, "retries", 0, 100)}
        for name, most in (("count", 10**8), ("threads", 4096), ("workers", 1024)):
            if getattr(self, name) is not None:
                numbers[name] = whole_of(getattr(self, name), name, 1, most)
        for name in ("resume", "discard", "overwrite"):
            flag_of(getattr(self, name), name)
        for name, value, known in (("device", self.device or "llvm", DEVICES), ("engine", self.engine, ENGINES)):
            if value not in known:
                raise RecipeError(f"no such {name}", parameter=name, expected=" or ".join(known), got=shown(value))
        self._check_together()
        resources: Any = self.resources or {}
        for key, amount in resources.items() if isinstance(resources, Mapping) else [(None, resources)]:
            if not (isinstance(key, str) and isinstance(amount, int | float) and 0 < amount < math.inf):
                expected, got = "a mapping such as {'GPU': 1}", shown(self.resources)
                raise RecipeError("these are no resources", parameter="resources", expected=expected, got=got)
        _ = self.memory_bytes, self.timeout_s  # which refuse texts that are no size and no duration
        return replace(self, **numbers)

    def _check_together(self) -> None:
        """Refuse options that exclude one another."""
        is_dask = self.engine == "dask"
        of_dask = self.scheduler is not None or bool(self.resources)
        for wrong, option, why in (
            (self.discard and not self.resume, "discard", "it belongs to `resume`"),
            (self.resume and self.overwrite, "overwrite", "it replaces the data set, which `resume` goes on with"),
            (of_dask and not is_dask, "engine", "`scheduler` and `resources` belong to `engine='dask'`"),
            (is_dask and self.workers is not None, "workers", "the cluster has its own workers"),
            (is_dask and self.timeout is not None, "timeout", "only workers of this machine can be stopped"),
            (is_dask and self.device is not None, "device", "set FORESTGEN_TRACING where the workers start"),
        ):
            if wrong:
                raise RecipeError(f"this option cannot be used here: {why}", parameter=option)

    @property
    def memory_bytes(self) -> int | None:
        if self.worker_memory is None:
            return None
        size = parse_bytes(self.worker_memory, "worker_memory")
        if size < _LEAST_BYTES:
            raise RecipeError(
                "this is too little for a worker",
                parameter="worker_memory",
                expected="such as 4GB",
                got=shown(self.worker_memory),
            )
        return size

    @property
    def timeout_s(self) -> float | None:
        return None if self.timeout is None else seconds_of(self.timeout, "timeout")


def render(loaded: LoadedRecipe, target: str, options: RunOptions, display: Display) -> RunSummary:
    """Make a recipe's images in this process; the first one that fails raises its error, finished ones stay.

    Raises `RecipeError`, `AssetError`, `ResourceError`, `OutputError`, `RenderError`: what an image or the folder does
    not allow.
    Raises `DatasetError`: images are missing at the end.
    """

    def prepare(work: Work, left: int) -> Work:
        check_disk(work.storage, left, most_disk_bytes(loaded.draw(0)))
        return work

    return _run(loaded, target, options, display, lambda work, _: InProcessEngine(work, display), prepare, strict=True)


def batch(loaded: LoadedRecipe, target: str, options: RunOptions, display: Display) -> RunSummary:
    """Make a recipe's images with many workers.

    Raises `RecipeError`, `ResourceError`, `OutputError`: see `forestgen.runs.run.run_batch`.
    Raises `DatasetError`: images failed, or are missing at the end.
    """
    workers = _Workers(options, display)
    return _run(loaded, target, options, display, workers.engine, workers.prepare)


def _run(
    loaded: LoadedRecipe,
    target: str,
    options: RunOptions,
    display: Display,
    engine: Callable[[Work, Notice], Engine],
    prepare: Callable[[Work, int], Work],
    *,
    strict: bool = False,
) -> RunSummary:
    summary = run_batch(
        loaded,
        target,
        count=options.count or loaded.images,
        engine=engine,
        prepare=prepare,
        resume=options.resume,
        discard=options.discard,
        overwrite=options.overwrite,
        retries=0 if strict else options.retries,
        strict=strict,
        threads=options.threads,
        memory_bytes=options.memory_bytes,
        display=display,
    )
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
        expected = _estimate(work.loaded, work.settings, left, self._options, self._display)
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
    expected = _estimate(loaded, settings, len(images) - before.kept, options, display, probe=True)
    check_fits(expected, storage, workers_here=options.engine == "local")
    return DryRun(expected, before.discarded, before.reasons())


def _estimate(
    loaded: LoadedRecipe,
    settings: DatasetSettings,
    left: int,
    options: RunOptions,
    display: Display,
    *,
    probe: bool = False,
) -> Estimate:
    """What the images that are not made yet will take, with as many workers as cores and memory allow."""
    if left and (probe or left >= LEAST_IMAGES):
        display.say(f"making some images to measure them: about {BUDGET_S:.0f} s, and longer for large ones")
    return estimate(
        loaded,
        settings,
        count=left,
        workers=options.workers,
        threads=options.threads,
        progress=display,
        probe=probe,
    )


def _check_complete(summary: RunSummary) -> None:
    """Raise `DatasetError` if an image that was asked for is not in the data set."""
    if not summary.failed and not summary.missing:
        return
    if not summary.failed:
        raise DatasetError(
            f"{len(summary.missing):,} of {summary.images:,} images are missing: files have changed meanwhile",
            where=summary.target,
            got="\n".join(summary.notes[:_MOST_FAILURES]),
            hint="the same command with `resume=True` makes them again",
        )
    shown = [_failure(failed) for failed in summary.failed[:_MOST_FAILURES]]
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


def _failure(failed: Failed) -> str:
    tries = f"{failed.attempt} attempt{'s' if failed.attempt > 1 else ''}"
    return f"image {failed.job.image} ({failed.job.split}), {tries}, {failed.kind}: {failed.message}"


def seconds_of(duration: float | str, option: str) -> float:
    """Seconds of a number, or of a text such as 90s, 30min or 1.5h. Raises `RecipeError`."""
    if isinstance(duration, int | float) and not isinstance(duration, bool) and 0 < duration < sys.maxsize:
        return float(duration)
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", duration if isinstance(duration, str) else "")
    if found is None or not float(found[1]):
        raise RecipeError(
            "no such duration", parameter=option, expected="such as 90s, 30min or 2h", got=shown(duration)
        )
    return float(found[1]) * {"s": 1, "min": 60, "h": 3600}[found[2]]
