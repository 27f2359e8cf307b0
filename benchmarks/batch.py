"""What the batch adds to its jobs: `uv run python benchmarks/batch.py [--quick] [--real]`; 1 if a bound is missed.

Bounds, for 1,000 tiny jobs on two workers: the wall time of the workers less the time inside of jobs is under 50 ms a
job, and the memory of the process that hands them out grows by less than 5% from the 100th job to the last. Jobs are
empty ones that leave a record, or with --real images of 32 by 24 pixels. The start of the workers, until each has done
its first job, does not count; nor does the end, when the files of the whole data set are written, which is printed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Done, Failed, Job, JobRecord, JobRun, Notice, Outcome, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.records import record_bytes, record_path
from forestgen.runs.run import run_batch
from forestgen.runs.work import make_job

JOBS, QUICK_JOBS, WORKERS = 1000, 200, 2
OVERHEAD_BOUND_S, GROWTH_BOUND, SETTLED_JOBS = 0.050, 0.05, 100
JOB_S = 0.02
RECIPE = """
forestgen: 1
seed: 1
site: {size_m: [10, 10], terrain: flat, ground: grass}
species: {fireweed: , grass: }
community: {model: uniform, plants: {fireweed: {count: 4}, grass: {count: 6}}}
plants: {library: 2, exemplars_per_species: 1}
sky: {sun: {elevation_deg: {uniform: [20, 60]}}}
cameras: [{name: eye, position_m: [5, -3, 1.6], look_at_m: [5, 5, 0.5], size_px: [32, 24]}]
render: {samples: 1}
labels: {samples: 1}
"""


def empty_job(work: Work, job: Job, attempt: int) -> Outcome:
    """Wait for a moment and leave a record."""
    start = time.perf_counter()
    time.sleep(JOB_S)
    record = JobRecord(
        job.key, job.image, job.split, 0, "0" * 64, (), {}, {"image": job.image, "seed": 0, "counts": {}}
    )
    work.storage.write(record_path(job.key), record_bytes(record))
    return Done(job, record, JobRun(job.image, attempt, f"{os.getpid()}", time.perf_counter() - start))


class WatchedEngine(LocalEngine):
    """Notes when each job was done, and the memory of this process then."""

    def __init__(self, work: Work, make: Callable[[Work, Job, int], Outcome]) -> None:
        super().__init__(work, WORKERS, make)
        self.done: list[tuple[float, Done]] = []
        self.memory_bytes: list[int] = []

    def wait(self, timeout_s: float) -> list[Outcome]:
        outcomes = super().wait(timeout_s)
        for outcome in outcomes:
            if isinstance(outcome, Failed):
                sys.exit(f"image {outcome.job.image} failed: {outcome.message}")
            self.done.append((time.perf_counter(), outcome))
            self.memory_bytes.append(resident_bytes())
        return outcomes


def resident_bytes() -> int:
    import psutil

    return int(psutil.Process().memory_info().rss)


def overhead_s(engine: WatchedEngine) -> float:
    """Of a job: wall time of all workers less the time inside of jobs, once each worker has done one."""
    first: dict[str, float] = {}
    for when, done in engine.done:
        first.setdefault(done.run.worker, when)
    start = max(first.values())
    later = [(when, done) for when, done in engine.done if when > start]
    wall = later[-1][0] - start
    return (wall * WORKERS - sum(done.run.seconds for _, done in later)) / len(later)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_JOBS} jobs")
    parser.add_argument("--real", action="store_true", help="tiny images instead of empty jobs")
    asked = parser.parse_args()
    jobs = QUICK_JOBS if asked.quick else JOBS
    engines: list[WatchedEngine] = []

    def engine(work: Work, notice: Notice) -> WatchedEngine:
        engines.append(WatchedEngine(work, make_job if asked.real else empty_job))
        return engines[-1]

    with tempfile.TemporaryDirectory() as folder:
        os.environ["FORESTGEN_CACHE"] = f"{folder}/cache"
        recipe = Path(folder) / "tiny.yaml"
        recipe.write_text(RECIPE, encoding="utf-8")
        start = time.perf_counter()
        summary = run_batch(load_recipe(recipe), f"{folder}/set", count=jobs, engine=engine, threads=1)
        total = time.perf_counter() - start
    watched = engines[0]
    before, after = watched.memory_bytes[SETTLED_JOBS - 1], watched.memory_bytes[-1]
    cost, growth = overhead_s(watched), after / before - 1
    inside = sum(done.run.seconds for _, done in watched.done) / jobs
    print(f"{jobs} jobs on {WORKERS} workers: {total:.1f} s in all, {start_and_end(watched, start, total)}")
    print(f"inside of a job        {1000 * inside:8.1f} ms")
    print(f"beside it              {1000 * cost:8.1f} ms a job (bound {1000 * OVERHEAD_BOUND_S:.0f} ms)")
    print(f"memory of the parent   {before / 1e6:8.1f} MB at job {SETTLED_JOBS}, {after / 1e6:.1f} MB at the last one: "
          f"{100 * growth:+.1f}% (bound {100 * GROWTH_BOUND:.0f}%)")  # fmt: skip
    return int(summary.made != jobs or cost >= OVERHEAD_BOUND_S or growth >= GROWTH_BOUND)


def start_and_end(engine: WatchedEngine, start: float, total: float) -> str:
    first, last = engine.done[0][0] - start, start + total - engine.done[-1][0]
    return f"{first:.1f} s until the first was done, {last:.1f} s after the last one"


if __name__ == "__main__":
    sys.exit(main())
