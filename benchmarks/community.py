"""Speed of the community model: `uv run python benchmarks/community.py`.

Times 300 steps of succession of three species on 120 m x 120 m with an empty Numba cache (a fresh process, imports and
compilation counted) and warm, and the domination grid against all pairs, alternately.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from statistics import median
from time import perf_counter

import numpy as np

from forestgen.community.competition import domination
from forestgen.community.model import simulate
from forestgen.community.models.multiset_lsystem import MODEL
from forestgen.community.population import Site, SpeciesEcology

SITE = Site((120.0, 120.0))
SPECIES = (
    #              name        growth   R    shaded oldage rate  r_1  A_H  c_H
    SpeciesEcology("fireweed", 0.30, 0.50, 0.00, 0.85, 400.0, 0.15, 3.0, 0.7),
    SpeciesEcology("poplar", 0.085, 2.6, 0.60, 0.97, 20.0, 0.10, 9.8, 0.75),
    SpeciesEcology("spruce", 0.05, 2.8, 0.90, 0.9995, 12.0, 0.10, 9.2, 0.93),
)


def seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def stand(steps: int, site: Site = SITE) -> int:
    return [len(p) for p in simulate(MODEL, MODEL.Parameters(), site, SPECIES, 1, steps=steps)][-1]


def cold_seconds() -> float:
    """A fresh process with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--once"]
        return seconds(lambda: subprocess.run(command, env={**os.environ, "NUMBA_CACHE_DIR": folder}, check=True))


def all_pairs(x, r, ids, size):  # type: ignore[no-untyped-def]
    out = np.zeros(len(r), bool)
    for i in range(len(r)):
        d = np.abs(x - x[i])
        d = np.minimum(d, size - d)
        touch = d[:, 0] ** 2 + d[:, 1] ** 2 <= (r + r[i]) ** 2
        out[i] = np.any(touch & ((r > r[i]) | ((r == r[i]) & (ids < ids[i]))))
    return out


def grid_against_all_pairs(n: int, rounds: int = 5) -> tuple[float, float]:
    """Median seconds of a step's domination in a stand of `n`: 3% trees, the rest seedlings, at the same density."""
    rng = np.random.default_rng(n)
    side = np.sqrt(n / 0.15)
    x = rng.random((n, 2)) * side
    r = np.where(rng.random(n) < 0.03, rng.uniform(0.5, 3, n), rng.uniform(0.05, 0.5, n))
    ids = np.arange(1, n + 1, dtype=np.uint32)
    size = np.array([side, side])
    domination.dominated(x, r, ids, (side, side), periodic=True)
    grid, pairs = [], []
    for _ in range(rounds):
        grid.append(seconds(lambda: domination.dominated(x, r, ids, (side, side), periodic=True)))
        pairs.append(seconds(lambda: all_pairs(x, r, ids, size)))
    return median(grid), median(pairs)


def main() -> None:
    print(f"300 steps, cold process and cache: {median(cold_seconds() for _ in range(3)):6.2f} s")
    stand(2)
    print(f"300 steps, warm:                   {median(seconds(lambda: stand(300)) for _ in range(5)):6.2f} s")
    for times in (1, 4, 16):
        site = Site((120.0 * times**0.5, 120.0 * times**0.5))
        took = median([seconds(partial(stand, 150, site)) for _ in range(3)])
        print(f"150 steps, {times:2d} x the area:           {took:6.2f} s")
    for n in (1_000, 4_000, 16_000):
        grid, pairs = grid_against_all_pairs(n)
        print(f"{n:6d} plants: grid {grid * 1e3:7.2f} ms, all pairs {pairs * 1e3:8.1f} ms, ratio {pairs / grid:6.0f}")


if __name__ == "__main__":
    if "--once" in sys.argv:
        stand(300)
    else:
        main()
