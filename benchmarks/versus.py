"""This checkout against an older commit: `uv run python benchmarks/versus.py [--rounds N] [--only RECIPE ...]`.

Both do the same alternately, in an order that turns round, and the table gives the median of the pairs' ratios:

- quickstart, cold: `forestgen render recipes/quickstart.yaml` with empty caches (plants, communities, DrJit's kernels).
  Numba's code and Python's bytecode are there, as `warm_up` leaves them.
- quickstart, warm: the same again.
- training_set: a batch of `--images` images by two workers of one thread each, from empty caches of plants and
  communities; start-up and end are in it.
- vista: the most memory that an image of 10,000 plants takes.

Exit code 1 if the training set is not 1.25 times as fast, or the others are worse than before by more than 3%.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

from same_arrays import COMMIT, ROOT, older

RECIPES = ("quickstart", "training_set", "vista")
WORKERS = 2
LEAST_GAIN, MOST_LOSS = 1.25, 1.03
SMALL = ("render.samples=1", "labels.samples=4", "cameras.0.size_px=[64, 48]")


@dataclass(frozen=True)
class Cost:
    """What a process and its children took."""

    wall_s: float
    cpu_s: float
    memory_bytes: int  # of the largest one


class Checkout:
    """A side, and the folder that its results and caches lie in."""

    def __init__(self, folder: Path, python: Path, work: Path) -> None:
        self._folder, self._python, self._work = folder, python, work
        work.mkdir()
        self._has_batch = bool(self._help("batch"))
        self._out = "--out" if "--out " in self._help("render") else "--output"

    def _help(self, command: str) -> str:
        """What a command says of itself; empty: there is none."""
        words = [str(self._python), "-m", "forestgen", command, "--help"]
        return subprocess.run(words, cwd=self._folder, capture_output=True, text=True, check=False).stdout

    def forget(self) -> None:
        """Empty all caches but Numba's."""
        for name in ("cache", "home"):
            shutil.rmtree(self._work / name, ignore_errors=True)

    def render(self, recipe: str, overrides: Sequence[str] = ()) -> Cost:
        """One image in one process."""
        return self._run("render", recipe, overrides, [self._out])

    def batch(self, recipe: str, images: int, overrides: Sequence[str] = ()) -> Cost:
        """Many images by `WORKERS` workers."""
        workers = ["--workers", str(WORKERS), "--threads", "1"]
        if self._has_batch:
            return self._run("batch", recipe, overrides, ["--count", str(images), *workers, "--out"])
        return self._run("render", recipe, overrides, ["--images", str(images), *workers, self._out])

    def _run(self, verb: str, recipe: str, overrides: Sequence[str], options: Sequence[str]) -> Cost:
        target = self._work / "out"
        shutil.rmtree(target, ignore_errors=True)
        home = self._work / "home"
        home.mkdir(exist_ok=True)
        words = [str(self._python), "-m", "forestgen", verb, f"recipes/{recipe}.yaml", *options, str(target)]
        words += [word for override in overrides for word in ("--set", override)]
        environment = {**os.environ, "FORESTGEN_CACHE": str(self._work / "cache"), "HOME": str(home)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # users' interpreters keep bytecode: `warm_up` leaves it
        with (self._work / "log").open("wb") as log:
            start = perf_counter()
            process = subprocess.Popen(words, cwd=self._folder, env=environment, stdout=log, stderr=log)
            _, status, usage = os.wait4(process.pid, 0)
            wall_s = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            sys.exit(f"{' '.join(words)}:\n{(self._work / 'log').read_text(errors='replace')[-2000:]}")
        return Cost(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def warm_up(one: Checkout) -> None:
    """Compile what the recipes need."""
    for recipe in ("quickstart", "vista"):
        one.render(recipe, SMALL)
    one.batch("training_set", WORKERS, SMALL)


def measure(one: Checkout, images: int, recipes: Sequence[str]) -> dict[str, Cost]:
    """Each of the module's four that has one of the recipes, once."""
    costs = {}
    one.forget()
    if "quickstart" in recipes:
        costs |= {"quickstart, cold": one.render("quickstart"), "quickstart, warm": one.render("quickstart")}
        one.forget()
    if "training_set" in recipes:
        costs[f"training_set, {images} images"] = one.batch("training_set", images)
    if "vista" in recipes:
        costs["vista"] = one.render("vista")
    return costs


def table(befores: list[dict[str, Cost]], afters: list[dict[str, Cost]]) -> tuple[str, dict[str, tuple[float, float]]]:
    """Lines to print, and by name the ratios after / before of wall time and memory."""
    lines = [
        "| | wall s before | after | ratio | CPU s before | after | ratio | GB before | after | ratio |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    ratios = {}
    for name in befores[0]:
        cells, own = [], []
        for field, unit in (("wall_s", 1.0), ("cpu_s", 1.0), ("memory_bytes", 1e9)):
            old, new = ([getattr(one[name], field) / unit for one in side] for side in (befores, afters))
            own.append(median(b / a for a, b in zip(old, new, strict=True)))
            digits = 1 if unit == 1.0 else 2
            cells += [f"{median(old):.{digits}f}", f"{median(new):.{digits}f}", f"{own[-1]:.3f}"]
        ratios[name] = (own[0], own[2])
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines), ratios


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, metavar="DIR", help=f"a checkout of {COMMIT} with its own .venv")
    parser.add_argument("--rounds", type=int, default=3, help="pairs; 3 by default")
    parser.add_argument("--images", type=int, default=12, help="of the training set; 12 by default")
    parser.add_argument("--only", nargs="+", choices=RECIPES, default=RECIPES, help="all by default")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="versus-") as temporary:
        work = Path(temporary)
        with older(asked.before, work) as folder:
            before = Checkout(folder, folder / ".venv" / "bin" / "python", work / "old")
            after = Checkout(ROOT, Path(sys.executable), work / "new")
            for one in (before, after):
                warm_up(one)
            costs: dict[Checkout, list[dict[str, Cost]]] = {before: [], after: []}
            for number in range(asked.rounds):
                for one in (before, after) if number % 2 == 0 else (after, before):
                    costs[one].append(measure(one, asked.images, asked.only))
                lines, ratios = table(costs[before], costs[after])
                print(f"after {number + 1} pairs\n{lines}", flush=True)
    failed = False
    for name, (wall, memory) in ratios.items():
        if name.startswith("training_set"):
            print(f"training_set is {1 / wall:.2f} times as fast (bound {LEAST_GAIN})")
            failed |= 1 / wall < LEAST_GAIN
        else:
            failed |= (memory if name == "vista" else wall) > MOST_LOSS
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
