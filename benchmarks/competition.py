"""Speed and memory of the competition models: `uv run python benchmarks/competition.py`.

Prints the grid's domination against all pairs (alternately, medians); its time and memory a circle from 10,000 to
1,000,000 circles, in stands of several kinds; the other models at 100,000 circles; and first calls with an empty
Numba cache, each in a fresh process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Callable
from functools import partial
from statistics import median
from time import perf_counter, process_time

import numpy as np

from forestgen.community.competition.contract import Circles
from forestgen.community.competition.domination import dominated
from forestgen.community.registry import COMPETITION_MODELS

DENSITY_PER_M2 = 0.15


def seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def peak_bytes(work: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def stand(n: int, kind: str) -> tuple[Circles, tuple[float, float]]:
    """`n` circles at DENSITY_PER_M2, or as `kind` says; and the size of their site."""
    rng = np.random.default_rng(n)
    side = (n / DENSITY_PER_M2) ** 0.5
    ids = np.arange(1, n + 1, dtype=np.uint32)
    r = np.where(rng.random(n) < 0.03, rng.uniform(0.5, 3, n), rng.uniform(0.05, 0.5, n))
    if kind == "all equal, 3 m":
        r = np.full(n, 3.0)
    elif kind == "all overlapping":
        r = rng.uniform(0.5, 3, n) * side
    elif kind == "100 a square metre":
        side = (n / 100) ** 0.5
    x = rng.random((n, 2)) * side
    if kind == "seedlings in clusters":
        x = np.mod(x[rng.integers(0, n // 20, n)] + rng.normal(0, 0.5, (n, 2)), side)
    if kind == "after self-thinning":
        x, r, ids = thinned(n, side, rng)
    return Circles(x, r, r, ids, np.zeros(len(r), dtype=np.uint16)), (side, side)


def thinned(n: int, side: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    """What is left of a cohort that grew and thinned itself until it came down to `n`; many have the largest radius."""
    x, r = rng.random((4 * n, 2)) * side, rng.uniform(0.01, 0.03, 4 * n)
    ids = np.arange(1, len(r) + 1, dtype=np.uint32)
    while len(r) > n:
        r = np.minimum(r * rng.uniform(1, 1.5, len(r)), 2.0)
        keep = ~dominated(x, r, ids, (side, side), periodic=True)
        x, r, ids = x[keep], r[keep], ids[keep]
    return x, r, ids


def all_pairs(c: Circles, size_m: tuple[float, float]) -> np.ndarray:
    x, r, ids = c.position_m, c.radius_m, c.plant_id
    out = np.zeros(len(r), bool)
    for i in range(len(r)):
        d = np.abs(x - x[i])
        d = np.minimum(d, np.array(size_m) - d)
        touch = d[:, 0] ** 2 + d[:, 1] ** 2 <= (r + r[i]) ** 2
        out[i] = np.any(touch & ((r > r[i]) | ((r == r[i]) & (ids < ids[i]))))
    return out


def domination(c: Circles, size_m: tuple[float, float]) -> np.ndarray:
    return dominated(c.position_m, c.radius_m, c.plant_id, size_m, periodic=True)


def against_all_pairs() -> None:
    for n in (1_000, 4_000, 16_000):
        c, size_m = stand(n, "trees and seedlings")
        domination(c, size_m)
        grid, pairs = [], []
        for _ in range(5):
            grid.append(seconds(partial(domination, c, size_m)))
            pairs.append(seconds(partial(all_pairs, c, size_m)))
        a, b = median(grid), median(pairs)
        print(f"{n:7d} circles: grid {a * 1e3:7.2f} ms, all pairs {b * 1e3:8.1f} ms, ratio {b / a:6.0f}")


def scaling(kind: str) -> None:
    """Wall and processor time (of all threads) from 10,000 to 1,000,000 circles, which take turns."""
    made = [stand(n, kind) for n in (10_000, 100_000, 1_000_000)]
    wall, cpu = np.empty((3, 5)), np.empty((3, 5))
    for turn in range(5):
        for k, (c, size_m) in enumerate(made):
            repeats = max(1, 100_000 // len(c))
            start = process_time()
            took = seconds(lambda c=c, size_m=size_m, repeats=repeats: [domination(c, size_m) for _ in range(repeats)])
            wall[k, turn] = took / repeats / len(c)
            cpu[k, turn] = (process_time() - start) / repeats / len(c)
    each, work = np.median(wall, axis=1) * 1e9, np.median(cpu, axis=1) * 1e9
    n = len(made[-1][0])
    print(
        f"{kind}: {n} circles {each[-1] * n / 1e9:.3f} s (least {wall[-1].min() * n:.3f}), "
        f"{peak_bytes(partial(domination, *made[-1])) / n:.1f} bytes a circle\n"
        f"    ns a circle at 10k, 100k, 1M: {each.round()}, ratio {each[-1] / each[0]:.2f}; "
        f"of processors {work.round()}, ratio {work[-1] / work[0]:.2f}"
    )


def every_environment(n: int = 100_000) -> None:
    c, size_m = stand(n, "trees and seedlings")
    for name in COMPETITION_MODELS.ids():
        environment = COMPETITION_MODELS.load(name)
        work = partial(environment.answer, environment.Parameters(), c, size_m, periodic=True)
        work()
        took = median(seconds(work) for _ in range(5))
        print(f"{name:18s} {n} circles: {took * 1e3:7.1f} ms, {peak_bytes(work) / n:.1f} bytes a circle")


def first_call(name: str) -> None:
    environment = COMPETITION_MODELS.load(name)
    c, size_m = stand(100, "trees and seedlings")
    took = seconds(lambda: environment.answer(environment.Parameters(), c, size_m, periodic=True))
    print(f"{name:18s} first call {took:.2f} s", flush=True)


def first_calls() -> None:
    """Twice each: with an empty cache, and with what the first process left there."""
    for name in COMPETITION_MODELS.ids():
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(2):
                command = [sys.executable, __file__, "--first", name]
                subprocess.run(command, env={**os.environ, "NUMBA_CACHE_DIR": folder}, check=True)


def main() -> None:
    against_all_pairs()
    for kind in (
        "trees and seedlings",
        "after self-thinning",
        "seedlings in clusters",
        "100 a square metre",
        "all equal, 3 m",
        "all overlapping",
    ):
        scaling(kind)
    every_environment()
    first_calls()


if __name__ == "__main__":
    if "--first" in sys.argv:
        first_call(sys.argv[-1])
    else:
        main()
