"""Images an hour of three recipes: `uv run python benchmarks/throughput.py [--quick] [--rounds N] [--write FILE]`.

The same images are made by one worker and by two, alternately, each of one thread; exit code 1 if two are not 1.8 times
as fast. The pace is that of a batch that goes on: the first job of each worker, which loads and compiles, does not
count, and the plants of the library are on disk, as they are after the first hundred images. Simulated communities are
not: every image of a batch has its own.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median

from forestgen.core.figures import show_bytes
from forestgen.core.progress import Silent
from forestgen.core.threads import cores
from forestgen.recipe.load import LoadedRecipe, load_recipe
from forestgen.runs.contract import Done, Engine, Notice, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.estimate import Estimate, estimate
from forestgen.runs.run import check_recipe, images_of, run_batch
from forestgen.runs.work import make_job

ROOT = Path(__file__).resolve().parents[1]
IMAGES = {"sapling_stand": 6, "mixed_stand": 6, "vista": 4}
QUICK_IMAGES = 4
QUICK = ("render.samples=4", "labels.samples=1", "sky.clouds.type={choice: [none]}")
QUICK_OF = {
    "sapling_stand": ("cameras.0.size_px=[160, 120]", "cameras.1.size_px=[160, 120]"),
    "mixed_stand": ("cameras.0.size_px=[192, 144]", "community.cells=256"),
    "vista": ("cameras.0.size_px=[256, 144]", "community.cells=512"),
}
LONG = 10_000  # images of the batch that is estimated
BOUND = 1.8
MOST_STAGES = 5


@dataclass
class Pass:
    """One batch."""

    workers: int
    seconds: dict[int, float]  # of a job by image, without the first one of each worker
    stages_s: dict[str, float]
    memory_bytes: int
    disk_bytes: float  # of an image


class NotingEngine(LocalEngine):
    def __init__(self, work: Work, workers: int) -> None:
        super().__init__(work, workers, make_job)
        self.done: list[Done] = []

    def wait(self, timeout_s: float):  # type: ignore[no-untyped-def]
        outcomes = super().wait(timeout_s)
        for outcome in outcomes:
            if not isinstance(outcome, Done):
                sys.exit(f"image {outcome.job.image} failed: {outcome.message}")
            self.done.append(outcome)
        return outcomes


def batch(loaded: LoadedRecipe, folder: Path, images: int, workers: int) -> Pass:
    engines: list[NotingEngine] = []

    def engine(work: Work, notice: Notice) -> Engine:
        engines.append(NotingEngine(work, workers))
        return engines[-1]

    target = folder / "set"
    summary = run_batch(loaded, str(target), count=images, engine=engine, threads=1)
    shutil.rmtree(target)
    forget_communities(folder / "cache")
    started: set[str] = set()
    warm: list[Done] = []
    for done in engines[0].done:
        if done.run.worker in started:
            warm.append(done)
        started.add(done.run.worker)
    stages: dict[str, float] = {}
    for done in warm:
        for name, seconds in done.run.timings_s.items():
            stages[name] = stages.get(name, 0.0) + seconds
    stages["other"] = sum(done.run.seconds for done in warm) - sum(stages.values())
    return Pass(
        workers,
        {done.job.image: done.run.seconds for done in warm},
        stages,
        max(done.run.peak_memory_bytes for done in engines[0].done),
        summary.bytes / images,
    )


def forget_communities(cache: Path) -> None:
    """Of what is kept, leave the plants alone."""
    for entry in cache.iterdir() if cache.is_dir() else ():
        if entry.name != "exemplars":
            shutil.rmtree(entry)


def gain(one: Pass, two: Pass) -> float:
    """How much faster two workers are, by images that were no worker's first in either pass."""
    both = sorted(one.seconds.keys() & two.seconds.keys())
    return two.workers / one.workers * sum(one.seconds[k] for k in both) / sum(two.seconds[k] for k in both)


def pace(passes: list[Pass]) -> float:
    """Images an hour."""
    return median(3600 * one.workers / fmean(one.seconds.values()) for one in passes)


def where(passes: list[Pass]) -> str:
    total: dict[str, float] = {}
    for one in passes:
        for name, seconds in one.stages_s.items():
            total[name] = total.get(name, 0.0) + seconds
    whole = sum(total.values())
    largest = sorted(total, key=lambda name: -total[name])[:MOST_STAGES]
    return ", ".join(f"{name} {100 * total[name] / whole:.0f} %" for name in largest)


def row(name: str, expected: Estimate, ones: list[Pass], twos: list[Pass], ratio: float) -> str:
    assert expected.image_s is not None
    came_s = fmean(fmean(one.seconds.values()) for one in ones)
    came_bytes = fmean(one.disk_bytes for one in ones)
    peak = max(one.memory_bytes for one in (*ones, *twos))
    estimates = (
        f"{expected.image_s.mean / came_s:.2f}, {expected.worker_bytes / peak:.2f}, "
        f"{expected.disk_bytes.mean / came_bytes:.2f}"
    )
    return (
        f"| {name} | {pace(ones):,.0f} | {pace(twos):,.0f} | {ratio:.2f} | {where([*ones, *twos])} | "
        f"{show_bytes(peak)} | {show_bytes(came_bytes)} | {estimates} |"
    )


def measure(name: str, rounds: int, *, quick: bool) -> tuple[str, float]:
    loaded = load_recipe(ROOT / "recipes" / f"{name}.yaml", (*QUICK, *QUICK_OF[name]) if quick else ())
    images = QUICK_IMAGES if quick else IMAGES[name]
    settings, _ = check_recipe(loaded, images_of(loaded, LONG))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["FORESTGEN_CACHE"] = str(folder / "cache")
        expected = estimate(loaded, settings, count=LONG, workers=1, threads=1, progress=Silent(), probe=True)
        batch(loaded, folder, images, 2)  # plants
        ones, twos = [], []
        for _ in range(rounds):
            ones.append(batch(loaded, folder, images, 1))
            twos.append(batch(loaded, folder, images, 2))
    ratio = median(gain(one, two) for one, two in zip(ones, twos, strict=True))
    return row(name, expected, ones, twos, ratio), ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_IMAGES} small images with little light")
    parser.add_argument("--rounds", type=int, default=2, help="how often each is done; 2 by default")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table there, too")
    parser.add_argument("recipes", nargs="*", default=list(IMAGES), help="by default all three")
    asked = parser.parse_args()
    lines = [
        "| recipe | images an hour, one worker | two | gain | where the time goes | memory of a worker | an image | "
        "estimate over outcome: time, memory, disk |",
        "|---|---|---|---|---|---|---|---|",
    ]
    print(f"{cores()} cores; each worker has one thread", *lines, sep="\n", flush=True)
    ratios = []
    for name in asked.recipes:
        line, ratio = measure(name, asked.rounds, quick=asked.quick)
        lines.append(line)
        ratios.append(ratio)
        print(line, flush=True)
    if asked.write is not None:
        asked.write.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return int(min(ratios) < BOUND)


if __name__ == "__main__":
    sys.exit(main())
