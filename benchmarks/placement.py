"""Speed and memory of placement: `uv run python benchmarks/placement.py` (`--quick`: small fields, no bounds).

Prints the fast field against Algorithm 5.2, compiled by the same compiler, for kernels of several reaches (they take
turns; the least of several, in seconds of one processor, all sums included); what a plant costs on
larger fields; and time and peak memory of 1,000,000 plants on 8192 x 8192 cells in a process of its own. Exits 1 if a
bound is missed, or if the two algorithms differ.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from time import perf_counter, process_time

import numpy as np

from forestgen.community.placement.field import DensityField, build, place
from forestgen.community.placement.kernels import SAMPLES, KernelTable
from support.lane_algorithms import algorithm_5_2

SECONDS_2048, TIMES_5_2 = 2.0, 10.0  # 100,000 plants; for the hard core
SECONDS_8192, BYTES_8192 = 30.0, 2e9  # 1,000,000 plants


def kernel(distances: list[float], values: list[float]) -> KernelTable:
    """Distances in mean spacings of the plants to be placed."""
    at = np.linspace(0.0, distances[-1], SAMPLES + 1)
    return KernelTable(np.interp(at, distances, values), distances[-1], in_radii=True)


KERNELS = {
    "hard core, 0.55 spacings": kernel([0, 0.55], [0, 0]),
    "hard core and slope, 0.6 spacings": kernel([0, 0.5, 0.6], [0, 0, 1]),
    "slope, 1 spacing": kernel([0, 1], [0.1, 1]),
    "clustering, 3 spacings": kernel([0, 0.1, 0.3, 3], [0, 0, 2, 1]),
}


def spacing(cells: int, plants: int) -> float:
    return cells / plants**0.5


def run_fast(cells: int, plants: int, table: KernelTable) -> tuple[float, np.ndarray]:
    size_m, uniform = (float(cells), float(cells)), np.random.default_rng(cells).random((plants, 2))
    field = DensityField(np.ones((cells, cells)), size_m, periodic=True)
    radius, species = np.full(plants, spacing(cells, plants)), np.zeros(plants, dtype=np.int64)
    start = process_time()
    placement = place([field], species, radius, [[table]], uniform)
    took = process_time() - start
    start = process_time()
    build(field._trees, field._exponents)  # all sums once more: what making the field took, but for copying
    return took + process_time() - start, placement.position_m


def run_plain(cells: int, plants: int, table: KernelTable) -> tuple[float, np.ndarray]:
    field, uniform = np.ones((cells, cells)), np.random.default_rng(cells).random((plants, 2))
    radius = np.full(plants, spacing(cells, plants))
    start = process_time()
    places = algorithm_5_2(field, (float(cells), float(cells)), radius, table, uniform, periodic=True)
    return process_time() - start, places


def against_5_2(cells: int, plants: int, turns: int, *, bounds: bool) -> bool:
    good = True
    print(f"{plants:,} plants on {cells} x {cells} cells, periodic; seconds of one processor")
    for name, table in KERNELS.items():
        run_fast(64, 50, table), run_plain(64, 50, table)
        fast, plain = [], []
        for _ in range(turns):
            took, places = run_fast(cells, plants, table)
            fast.append(took)
            took, places_plain = run_plain(cells, plants, table)
            plain.append(took)
        same = alike(places, places_plain)
        ratio, placed = min(plain) / min(fast), np.isfinite(places[:, 0]).mean()
        print(
            f"  {name:34s} fast {min(fast):7.3f} ({min(fast) / plants * 1e6:5.2f} us a plant), Algorithm 5.2 "
            f"{min(plain):7.3f}, ratio {ratio:5.1f}; placed {placed:.1%}; first {same:,} plants alike",
            flush=True,
        )
        good &= same >= min(plants, 1000)
        if bounds and name == next(iter(KERNELS)):
            good &= missed(f"{min(fast):.3f} s", min(fast) < SECONDS_2048, f"under {SECONDS_2048:g} s")
            good &= missed(f"{ratio:.1f} times", ratio >= TIMES_5_2, f"at least {TIMES_5_2:g} times Algorithm 5.2")
    return good


def alike(a: np.ndarray, b: np.ndarray) -> int:
    """How many plants stand at the same places before rounding in 5.2's differences first tells on one."""
    apart = np.abs(a - b).max(axis=1) > 1e-6
    return int(np.argmax(apart)) if apart.any() else len(a)


def missed(got: str, held: bool, bound: str) -> bool:
    print(f"    {'kept' if held else 'MISSED'}: {got}, {bound}")
    return held


def scaling(sizes: list[int]) -> None:
    """The same kernel in cells and the same number of plants, on larger and larger fields."""
    table, plants = KERNELS["hard core, 0.55 spacings"], 20_000
    for cells in sizes:
        uniform = np.random.default_rng(1).random((plants, 2))
        field = DensityField(np.ones((cells, cells)), (float(cells), float(cells)), periodic=True)
        radius, species = np.full(plants, 6.5), np.zeros(plants, dtype=np.int64)
        took = []
        for _ in range(3):
            again = DensityField(field.cells, field.size_m, periodic=True)
            start = process_time()
            place([again], species, radius, [[table]], uniform)
            took.append(process_time() - start)
        print(f"  {plants:,} plants on {cells:5d} x {cells:5d} cells: {min(took) / plants * 1e6:6.2f} us a plant")


def large(cells: int, plants: int) -> None:
    """In a process of its own: seconds from the density to the last plant, and the most memory it ever held."""
    table = KERNELS["hard core, 0.55 spacings"]
    run_fast(64, 50, table)
    uniform, density = np.random.default_rng(1).random((plants, 2)), np.ones((cells, cells))
    radius, species = np.full(plants, spacing(cells, plants)), np.zeros(plants, dtype=np.int64)
    start = perf_counter()
    field = DensityField(density, (float(cells), float(cells)), periodic=True)
    placed = place([field], species, radius, [[table]], uniform).placed.mean()
    print(perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, placed)


def in_own_process(cells: int, plants: int, *, bounds: bool) -> bool:
    command = [sys.executable, __file__, "--large", str(cells), str(plants)]
    answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    took, held, placed = (float(word) for word in answer.split())
    print(
        f"{plants:,} plants on {cells} x {cells} cells, from the density on: {took:.2f} s, peak {held / 1e9:.2f} GB of "
        f"the whole process, the caller's density included; placed {placed:.1%}"
    )
    if not bounds:
        return True
    kept = missed(f"{took:.2f} s", took < SECONDS_8192, f"under {SECONDS_8192:g} s")
    return missed(f"{held / 1e9:.2f} GB", held < BYTES_8192, f"under {BYTES_8192 / 1e9:g} GB") and kept


def main(*, quick: bool) -> int:
    good = against_5_2(512 if quick else 2048, 6_000 if quick else 100_000, 2 if quick else 3, bounds=not quick)
    print("What a plant costs on larger fields")
    scaling([256, 1024] if quick else [256, 1024, 4096])
    good &= in_own_process(1024 if quick else 8192, 15_000 if quick else 1_000_000, bounds=not quick)
    return 0 if good else 1


if __name__ == "__main__":
    if "--large" in sys.argv:
        large(int(sys.argv[-2]), int(sys.argv[-1]))
    else:
        sys.exit(main(quick="--quick" in sys.argv))
