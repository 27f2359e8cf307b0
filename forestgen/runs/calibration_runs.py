"""A few images of a batch, made for an estimate and thrown away.

A probe is an image of the batch, whole but for its light, which has fewer samples, and its size where that is large;
what was left out is added in proportion. Probes are made by a worker process, as the batch's own images are: so their
memory is measured too, and nothing of them stays. They take nothing from a cache and leave nothing there, so that a
second estimate says the same as the first one.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from forestgen.core.cache import ENVIRONMENT
from forestgen.core.progress import Progress
from forestgen.dataset.settings import DatasetSettings
from forestgen.plants.growing import forget_shared
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.runs.contract import Done, Failed, Job, Outcome, Work
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.records import job_key, versions_hash
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import make_job
from forestgen.scene.plan import estimate_bytes, make_plan

MOST_PROBES = 6
_MOST_PIXELS = 300_000  # of a probe, over all its frames
# Light paths of a probe, at least: with fewer, the time is that of setting out. And at least one a pixel in so many.
_LEAST_PATHS, _SAMPLES_SHARE = 2_000_000, 16
_SHARE_OF_BATCH = 0.05  # that probes may take of a worker's time for the batch
_PATIENCE = 3.0  # times the budget, after which the probe in work is given up

# Time that goes with the light paths, and time that does not go with the pixels, by the names under which `Timings`
# books it.
_BY_SAMPLE = ("light paths", "clouds: sky pixels")
_BY_SCENE = (
    "amodal: build", "amodal: outlines", "clouds", "clouds: bake", "community", "identity: build", "load Mitsuba",
    "measures", "plants", "radiance: build", "radiance: repaint", "recipe", "scene",
)  # fmt: skip
_MERGED = ("annotations.json",)  # what the files of a whole split repeat


@dataclass(frozen=True)
class ReducedSettings:
    """How a probe differs from its image."""

    samples: float = 1.0  # the image's light paths a pixel, over the probe's
    pixels: float = 1.0  # the image's pixels over the probe's
    more_bytes: int = 0  # of memory that the image's pixels take beyond the probe's


@dataclass(frozen=True)
class CalibrationRun:
    """What an image of the batch takes, measured on a lighter one."""

    image: int
    frames: int
    plants: int
    exemplars: int
    triangles: int  # of the exemplars
    seconds: float  # of the image
    made_s: float  # of the probe itself
    stages_s: Mapping[str, float]
    disk_bytes: int
    memory_bytes: int  # of the process at its peak
    is_first: bool  # of its worker, and so with what is compiled and loaded once


@dataclass(frozen=True)
class CalibrationRuns:
    """All probes of an estimate, and why some are missing."""

    probes: tuple[CalibrationRun, ...]
    notes: tuple[str, ...] = ()
    reduced: ReducedSettings = ReducedSettings()


def make_probe(work: Work, job: Job, attempt: int) -> Outcome:
    """Do a job without any cache."""
    os.environ[ENVIRONMENT] = ""
    forget_shared()
    return make_job(work, job, attempt)


def probe_images(
    loaded: LoadedRecipe, settings: DatasetSettings, *, count: int, threads: int, budget_s: float, progress: Progress
) -> CalibrationRuns:
    """Make probes until the time is up: image 0, and others all over the batch.

    Two are made unless they take very long: the first one's time is that of a worker that has just started.
    """
    light, reduced = lightened(loaded)
    probes: list[CalibrationRun] = []
    notes: list[str] = []
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="forestgen-estimate-") as folder:
        work = Work(light, settings, LocalStorage(Path(folder)), versions_hash(), threads)
        with LocalEngine(work, 1, make_probe) as engine, progress.stage("estimate", MOST_PROBES) as advance:
            for index in _spread(count):
                drawn = light.draw(index)
                engine.submit(Job(index, drawn.image_index, drawn.split, job_key(drawn, work.versions)), 1)
                outcome = _wait(engine, start + _PATIENCE * budget_s)
                advance(1)
                if outcome is None:
                    lasted = f"{_PATIENCE * budget_s:.0f} s"
                    notes.append(f"image {drawn.image_index} was given up for the estimate after {lasted}")
                elif isinstance(outcome, Failed):
                    notes.append(f"image {drawn.image_index} fails: {outcome.message}")
                else:
                    probes.append(_probe_of(outcome, drawn, reduced, is_first=not probes))
                spent_s = time.monotonic() - start
                if outcome is None:
                    break
                # Whether another probe would take more than there is, or more than its share of the batch.
                if len(probes) > 1 and (
                    spent_s + probes[-1].made_s > budget_s or spent_s > _SHARE_OF_BATCH * count * probes[-1].seconds
                ):
                    break
    return CalibrationRuns(tuple(probes), tuple(notes), reduced)


def _spread(count: int) -> Iterator[int]:
    """Indices 0 ... count - 1, at most so many as are probed, evenly over the batch however many are taken."""
    seen: set[int] = set()
    for number in range(MOST_PROBES):
        digits = f"{number:b}"[::-1]
        index = int(digits, 2) * count // (1 << len(digits))
        if index not in seen:
            seen.add(index)
            yield index


def _wait(engine: LocalEngine, until_s: float) -> Outcome | None:
    while (left := until_s - time.monotonic()) > 0:
        for outcome in engine.wait(min(left, 1.0)):
            return outcome
    return None


def lightened(loaded: LoadedRecipe) -> tuple[LoadedRecipe, ReducedSettings]:
    """The recipe with fewer samples and pixels, as far as it says how many there are."""
    drawn, data = loaded.draw(0), deepcopy(loaded.data)
    samples, pixels = _fewer_samples(loaded, drawn, data), _smaller_images(loaded, drawn, data)
    if samples == pixels == 1.0:
        return loaded, ReducedSettings()
    light = replace(loaded, data=data)
    full_bytes, light_bytes = (estimate_bytes(make_plan(one))["images"] for one in (drawn, light.draw(0)))
    return light, ReducedSettings(samples, pixels, max(0, full_bytes - light_bytes))


def _pixels(drawn: DrawnRecipe) -> int:
    """Of all frames of an image."""
    return sum(camera.frames * math.prod(camera.size_px) for camera in drawn.recipe.cameras)


def _fewer_samples(loaded: LoadedRecipe, drawn: DrawnRecipe, data: dict[str, Any]) -> float:
    """Write fewer samples into `data`; the factor between. 1 where the samples follow from something else."""
    render = drawn.recipe.render
    follows = (render.target_error, render.target_error_p95, render.time_budget_s) != (None, None, None)
    spectral = render.mode == "spectral" or any(camera.bands for camera in drawn.recipe.cameras)
    if follows or spectral or any(keys[:1] == ("render",) for keys in loaded.distributions):
        return 1.0
    pixels = min(_pixels(drawn), _MOST_PIXELS)
    few = max(math.ceil(_LEAST_PATHS / pixels), render.samples // _SAMPLES_SHARE, 2)
    if few >= render.samples:
        return 1.0
    data["render"] = {**data.get("render", {}), "samples": few}
    return render.samples / few


def _smaller_images(loaded: LoadedRecipe, drawn: DrawnRecipe, data: dict[str, Any]) -> float:
    """Write smaller images of the same shape into `data`; the factor between their pixels."""
    cameras = drawn.recipe.cameras
    full = _pixels(drawn)
    written = data.get("cameras")
    drawn_sizes = any(keys[0] == "cameras" and "size_px" in keys for keys in loaded.distributions)
    if full <= _MOST_PIXELS or drawn_sizes or not isinstance(written, list):
        return 1.0
    shrink = math.sqrt(_MOST_PIXELS / full)
    pixels = 0
    for camera, section in zip(cameras, written, strict=True):
        width, height = camera.size_px
        common = math.gcd(width, height)
        steps = max(1, round(common * shrink))
        size = (width // common * steps, height // common * steps)
        section["size_px"] = list(size)
        pixels += camera.frames * math.prod(size)
    return full / pixels


def _probe_of(done: Done, drawn: DrawnRecipe, reduced: ReducedSettings, *, is_first: bool) -> CalibrationRun:
    stages = full_stages(done.run.timings_s, reduced)
    sizes = {path: int(about["bytes"]) for path, about in done.record.files.items()}
    repeated = sum(size for path, size in sizes.items() if path.rsplit("/", 1)[-1] in _MERGED)
    report = done.record.report
    return CalibrationRun(
        image=drawn.image_index,
        frames=len(done.record.rows),
        plants=sum(report["counts"].values()),
        exemplars=sum(one["exemplars"] for one in report["size_errors"]),
        triangles=report["triangles"],
        seconds=sum(stages.values()) + max(0.0, done.run.seconds - sum(done.run.timings_s.values())),
        made_s=done.run.seconds,
        stages_s=stages,
        disk_bytes=round((sum(sizes.values()) + repeated) * reduced.pixels),
        memory_bytes=done.run.peak_memory_bytes + reduced.more_bytes,
        is_first=is_first,
    )


def full_stages(stages_s: Mapping[str, float], reduced: ReducedSettings) -> dict[str, float]:
    """Seconds of each stage for the image itself, from those of its probe."""
    return {
        name: seconds
        * (reduced.samples if name in _BY_SAMPLE else 1.0)
        * (1.0 if name in _BY_SCENE else reduced.pixels)
        for name, seconds in stages_s.items()
    }
