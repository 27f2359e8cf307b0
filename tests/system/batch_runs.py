"""Batches for tests: in this process, in processes of their own, and what must be true of their folders."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Job, Outcome, RunOptions, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.records import records_of
from forestgen.runs.run import run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.summary import RunSummary

Make = Callable[[Work, Job, int], Outcome]

RECIPE = """\
forestgen: 1
seed: 5
site: {size_m: [6, 5], terrain: flat, ground: soil_wet}
species: {fireweed: }
community: {model: multiset_lsystem, program: succession, steps: 12}
plants: {exemplars_per_species: 1}
sky: {sun: {elevation_deg: {uniform: [20, 60]}}}
cameras:
  - {name: left, position_m: [3, -1, 1], look_at_m: [3, 3, 0.4], size_px: [32, 24]}
  - {name: right, position_m: [4, -1, 1], look_at_m: [3, 3, 0.4], size_px: [16, 16]}
render: {samples: 1, denoise: false}
labels: {samples: 1}
dataset: {formats: [], splits: {train: 2, val: 1}}
"""
WITH_LABELS = RECIPE.replace("formats: []", "formats: [coco]").replace("train: 2", "train: 1")
OF_THE_RUN = ("run", "report.html", ".forestgen")


def recipe(folder: Path, text: str = RECIPE) -> Path:
    path = folder / "fireweed.yaml"
    path.write_text(text, encoding="utf-8")
    return path


class SerialEngine:
    """Does jobs in this process when it is asked for outcomes.

    Parameters
    ----------
    hold : so many jobs are taken in before the first is done, and `order` chooses the next one of them.
    stop_after : outcomes, after which it is interrupted.
    """

    def __init__(
        self,
        work: Work,
        make: Make,
        hold: int = 1,
        order: Callable[[Sequence[Job]], int] = lambda jobs: 0,
        stop_after: int | None = None,
    ) -> None:
        self._work, self._make, self._hold, self._order = work, make, hold, order
        self._left = stop_after
        self._queue: list[tuple[Job, int]] = []

    def __enter__(self) -> SerialEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.clear()

    @property
    def workers(self) -> int:
        return self._hold

    def submit(self, job: Job, attempt: int) -> None:
        self._queue.append((job, attempt))

    def wait(self, timeout_s: float) -> list[Outcome]:
        if self._left == 0:
            raise KeyboardInterrupt
        self._left = None if self._left is None else self._left - 1
        job, attempt = self._queue.pop(self._order([job for job, _ in self._queue]))
        return [self._make(self._work, job, attempt)]


def serial(
    path: Path,
    target: Path,
    count: int,
    make: Make,
    *overrides: str,
    resume: bool = False,
    discard: bool = False,
    retries: int = 2,
    **engine: object,
) -> RunSummary:
    """A batch in this process."""
    return run_batch(
        load_recipe(path, overrides),
        str(target),
        RunOptions(count=count, resume=resume, discard=discard, retries=retries),
        lambda work, notice: SerialEngine(work, make, **engine),  # type: ignore[arg-type]
    )


def local(
    path: str,
    target: str,
    count: int,
    make: Make,
    workers: int = 2,
    *,
    resume: bool = True,
    retries: int = 2,
    memory_bytes: int | None = None,
    timeout_s: float | None = None,
) -> RunSummary:
    """A batch with worker processes."""
    return run_batch(
        load_recipe(path),
        target,
        RunOptions(count=count, resume=resume, retries=retries, worker_memory=memory_bytes),
        lambda work, notice: LocalEngine(work, workers, make, timeout_s=timeout_s),
    )


def shown(root: Path) -> dict[str, bytes]:
    """Every file that two runs must agree on, and the records: path -> bytes."""
    files = {path.relative_to(root).as_posix(): path for path in sorted(root.rglob("*")) if path.is_file()}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if name.partition("/")[0] not in OF_THE_RUN or name.startswith(".forestgen/jobs/")
    }


def assert_same(one: Path, other: Path) -> None:
    first, second = shown(one), shown(other)
    assert sorted(first) == sorted(second), sorted(set(first) ^ set(second))
    assert [name for name in first if first[name] != second[name]] == []


def assert_records_hold(root: Path) -> set[int]:
    """Each record's files are there, whole; the images that are done."""
    done = []
    for record in records_of(LocalStorage(root)):
        assert record.files
        for path, said in record.files.items():
            content = (root / path).read_bytes()
            assert len(content) == said["bytes"]
            assert hashlib.sha256(content).hexdigest() == said["sha256"]
        done.append(record.image)
    assert len(done) == len(set(done))
    return set(done)


def processes_below(pid: int) -> list[int]:
    """Worker processes of a run."""
    import psutil

    try:
        children = psutil.Process(pid).children(recursive=True)
        return [child.pid for child in children if "spawn_main" in " ".join(child.cmdline())]
    except psutil.Error:
        return []


def faults_folder(folder: Path) -> Path:
    """The folder that `pretend_jobs` looks into; processes that are started from now on inherit its name."""
    from pretend_jobs import FAULTS

    faults = folder / "faults"
    faults.mkdir()
    os.environ[FAULTS] = str(faults)
    return faults
