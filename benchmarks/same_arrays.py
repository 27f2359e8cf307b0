"""Every shipped recipe's arrays, before and after: `uv run python benchmarks/same_arrays.py [--keep DIR]`.

Each recipe is rendered by an older commit and by this checkout, and every array of their frames is compared, byte by
byte: all channels of frame.exr, the pixels of instance.png and semantic.png, the columns of plants.parquet that both
have. Prints a line a recipe; exit code 1 if an array differs, or if a recipe does not render in both.

By default the recipes are reduced (`SMALLER`, and small images with little light), which keeps what they exercise;
`--full` takes them as they are. `--keep DIR` stores the older commit's frames and takes them from there the next time.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import OpenEXR
import pyarrow.parquet as pq
from PIL import Image
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
COMMIT = "996a2e2"
LONGEST_PX = 128  # side of a reduced image
FEW = ("render.samples=4", "labels.samples=4")
COMPARED = ("frame.exr", "instance.png", "semantic.png", "plants.parquet")
TIMEOUT_S = 3600.0

# Shorter simulations, by recipe. `images` is how many are drawn, for recipes that draw at random.
SMALLER: dict[str, tuple[str, ...]] = {
    "training_set": ("images=2",),
    "mixed_stand": ("images=2",),
    "sapling_stand": ("images=2",),
    "weather_story": ("images=3",),
    "walk_in_the_wind": ("cameras.0.path.frames=3",),
}


@dataclass(frozen=True)
class Side:
    """A checkout and the interpreter of its environment."""

    folder: Path
    python: Path
    cache: Path

    def render(self, recipe: Path, target: Path, overrides: Sequence[str], log: Path) -> str | None:
        """Render a recipe into a folder; None, or why that failed."""
        words = [str(self.python), "-m", "forestgen", "render"]
        usage = subprocess.run([*words, "--help"], cwd=self.folder, capture_output=True, text=True, check=True).stdout
        words += [str(recipe), "--out" if "--out " in usage else "--output", str(target)]
        words += [word for override in overrides for word in ("--set", override)]
        environment = {**os.environ, "FORESTGEN_CACHE": str(self.cache)}
        with log.open("w", encoding="utf-8") as file:
            try:
                done = subprocess.run(
                    words, cwd=self.folder, env=environment, stdout=file, stderr=file, timeout=TIMEOUT_S, check=False
                )
            except subprocess.TimeoutExpired:
                return f"not finished after {TIMEOUT_S:.0f} s"
        if done.returncode == 0:
            return None
        last = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
        return " ".join(last[-4:])[:300] or f"exit code {done.returncode}"


@dataclass
class Comparison:
    """What came of a recipe."""

    name: str
    arrays: int = 0
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    before_s: float = 0.0  # 0: kept
    after_s: float = 0.0

    def line(self) -> str:
        found = f"{len(self.differences)} of {self.arrays} arrays differ" if self.differences else "same"
        times = f"{self.before_s:.0f} s, {self.after_s:.0f} s"
        rows = [f"{self.name:<36} {found} ({self.arrays} arrays; {times})"]
        return "\n".join([*rows, *(f"    {text}" for text in (*self.differences, *self.notes))])


def overrides_of(recipe: Path, *, full: bool) -> tuple[str, ...]:
    """Overrides that reduce a recipe: the same aspect of each camera, few samples, and what `SMALLER` says."""
    if full:
        return ()
    data = YAML(typ="safe").load(recipe.read_text(encoding="utf-8"))
    cameras = data.get("cameras")
    if not cameras:
        return (f"cameras=[{{size_px: [{LONGEST_PX}, {LONGEST_PX * 9 // 16}]}}]", *FEW, *SMALLER.get(recipe.stem, ()))
    sizes = []
    for index, camera in enumerate(cameras):
        width, height = camera["size_px"]
        scale = min(1.0, LONGEST_PX / max(width, height))
        sizes.append(f"cameras.{index}.size_px=[{round(width * scale)}, {round(height * scale)}]")
    return (*sizes, *FEW, *SMALLER.get(recipe.stem, ()))


def frames_in(folder: Path) -> dict[str, Path]:
    """Folders of frames by name, in whatever split's folder they lie."""
    return {path.parent.name: path.parent for path in sorted(folder.rglob("frame.exr"))}


def arrays_of(frame: Path) -> dict[str, np.ndarray[Any, Any]]:
    """All arrays of a frame by file and channel, or column."""
    arrays = {}
    with OpenEXR.File(str(frame / "frame.exr"), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                arrays[f"frame.exr {part.name()}:{name}"] = np.array(channel.pixels)
    for name in ("instance.png", "semantic.png"):
        with Image.open(frame / name) as image:
            arrays[f"{name} {image.mode}"] = np.array(image)
    table = pq.read_table(frame / "plants.parquet")
    for name in table.column_names:
        column = table.column(name)
        arrays[f"plants.parquet {name} null"] = column.is_null().to_numpy()
        blank = False if str(column.type) == "bool" else 0
        if str(column.type) == "string":
            arrays[f"plants.parquet {name}"] = np.array(column.to_pylist(), dtype=np.str_)
        else:
            arrays[f"plants.parquet {name}"] = column.fill_null(blank).combine_chunks().to_numpy(zero_copy_only=False)
    return arrays


def difference(before: np.ndarray[Any, Any], after: np.ndarray[Any, Any]) -> str | None:
    """How two arrays differ; None: not in a byte."""
    if before.shape != after.shape or (before.dtype != after.dtype and before.dtype.kind != "U"):
        return f"{before.dtype} {before.shape} became {after.dtype} {after.shape}"
    if before.dtype == after.dtype and before.tobytes() == after.tobytes():
        return None
    if before.dtype.kind in "US":
        return f"{int((before != after).sum()) or 'no'} of {before.size} differ"
    values = before.astype(np.float64), after.astype(np.float64)
    differ = ~((values[0] == values[1]) | (np.isnan(values[0]) & np.isnan(values[1])))
    most = float(np.nanmax(np.abs(values[1] - values[0]))) if differ.any() else 0.0
    return f"{int(differ.sum())} of {before.size} differ, by {most:g} at most"


def compare(name: str, before: Path, after: Path) -> Comparison:
    """Two outputs of a recipe."""
    result = Comparison(name)
    olds, news = frames_in(before), frames_in(after)
    for frame in sorted(olds.keys() ^ news.keys()):
        result.differences.append(f"{frame}: only {'before' if frame in olds else 'after'}")
    if not olds:
        result.differences.append("no frames")
    for frame in sorted(olds.keys() & news.keys()):
        old, new = arrays_of(olds[frame]), arrays_of(news[frame])
        for array in [*old, *(key for key in new if key not in old)]:
            if array not in new or array not in old:
                there = "removed" if array in old else "added"
                is_column = array.startswith("plants.parquet")
                (result.notes if is_column else result.differences).append(f"{frame} {array}: {there}")
                continue
            result.arrays += 1
            found = difference(old[array], new[array])
            if found:
                result.differences.append(f"{frame} {array}: {found}")
    return result


@contextmanager
def older(folder: Path | None, work: Path) -> Iterator[Path]:
    """A checkout of `COMMIT` with its own environment: the one that is given, or one that is made and removed."""
    if folder is not None:
        yield folder.resolve()
        return
    made = work / "before"
    subprocess.run(["git", "worktree", "add", "--detach", str(made), COMMIT], cwd=ROOT, check=True, capture_output=True)
    environment = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
    try:
        subprocess.run(["uv", "sync", "--frozen", "--quiet"], cwd=made, env=environment, check=True)
        yield made
    finally:
        subprocess.run(["git", "worktree", "remove", "--force", str(made)], cwd=ROOT, check=False, capture_output=True)


def keep_frames(output: Path, store: Path, about: dict[str, Any]) -> None:
    """Store what is compared of an output, complete or not at all."""
    partial = store.with_name(store.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    for name, frame in frames_in(output).items():
        (partial / name).mkdir(parents=True)
        for file in COMPARED:
            shutil.copyfile(frame / file, partial / name / file)
    (partial / "about.json").write_text(json.dumps(about), encoding="utf-8")
    shutil.rmtree(store, ignore_errors=True)
    partial.rename(store)


def is_kept(store: Path, about: dict[str, Any]) -> bool:
    """Whether a store has the frames that are asked for."""
    file = store / "about.json"
    return file.is_file() and json.loads(file.read_text(encoding="utf-8")) == about


class Run:
    """The comparison of all recipes; everything that it writes is under `work`, or kept in `store`."""

    def __init__(self, before: Side, work: Path, store: Path | None, *, full: bool) -> None:
        self._before, self._work, self._store, self._full = before, work, store, full
        self._after = Side(ROOT, Path(sys.executable), work / "cache-after")

    def one(self, recipe: Path) -> Comparison:
        """Render a recipe on both sides, compare, and remove both."""
        name = recipe.relative_to(ROOT / "recipes").with_suffix("").as_posix()
        folder = self._work / name.replace("/", "-")
        folder.mkdir()
        try:
            return self._one(recipe, name, folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _one(self, recipe: Path, name: str, folder: Path) -> Comparison:
        overrides = overrides_of(recipe, full=self._full)
        about = {"commit": COMMIT, "overrides": list(overrides)}
        kept = None if self._store is None else self._store / name.replace("/", "-")
        failed, seconds = Comparison(name), 0.0
        before = folder / "before"
        if kept is not None and is_kept(kept, about):
            before = kept
        else:
            problem, seconds = self._timed(self._before, recipe, before, overrides)
            if problem:
                failed.differences.append(f"before: {problem}")
            elif kept is not None:
                keep_frames(before, kept, about)
        problem, after_s = self._timed(self._after, recipe, folder / "after", overrides)
        if problem:
            failed.differences.append(f"after: {problem}")
        result = failed if failed.differences else compare(name, before, folder / "after")
        result.before_s, result.after_s = seconds, after_s
        return result

    def _timed(self, side: Side, recipe: Path, target: Path, overrides: Sequence[str]) -> tuple[str | None, float]:
        own = side.folder / recipe.relative_to(ROOT)
        if not own.is_file():
            return "has no such recipe", 0.0
        start = perf_counter()
        problem = side.render(own, target, overrides, target.with_suffix(".log"))
        return problem, perf_counter() - start


def chosen(names: Sequence[str]) -> list[Path]:
    """Recipes by the names given, all if none are."""
    recipes = sorted((ROOT / "recipes").rglob("*.yaml"))
    unknown = set(names) - {path.stem for path in recipes}
    if unknown:
        sys.exit(f"no such recipe: {', '.join(sorted(unknown))}")
    return [path for path in recipes if not names or path.stem in names]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, metavar="DIR", help=f"a checkout of {COMMIT} with its own .venv")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="store the frames of before there, or take them")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="recipes, by name; by default all")
    parser.add_argument("--full", action="store_true", help="the recipes as they are")
    parser.add_argument("--jobs", type=int, default=1, help="recipes at a time")
    asked = parser.parse_args()
    recipes = chosen(asked.only)
    with tempfile.TemporaryDirectory(prefix="same_arrays-") as temporary:
        work = Path(temporary)
        if asked.keep is not None:
            asked.keep.mkdir(parents=True, exist_ok=True)
        with older(asked.before, work) as folder:
            side = Side(folder, folder / ".venv" / "bin" / "python", work / "cache-before")
            run = Run(side, work, asked.keep, full=asked.full)
            different = 0
            with ThreadPoolExecutor(asked.jobs) as pool:
                for result in pool.map(run.one, recipes):
                    print(result.line(), flush=True)
                    different += bool(result.differences)
    print(f"{len(recipes) - different} of {len(recipes)} recipes are the same")
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
