"""What a batch will take, before it starts: time, memory, disk.

Images, frames, pixels and light paths follow from the recipe. Plants, exemplars and triangles, seconds, bytes and
memory are those of a few images of the batch that are really made on this machine as it is now (calibration_runs.py).
Intervals are from the 10th to the 90th percentile of images, as if the logarithms of what they take were normal.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from forestgen.core.errors import OutputError, ResourceError
from forestgen.core.figures import count as counted
from forestgen.core.figures import seconds, show_bytes, three_digits
from forestgen.core.processes import free_bytes
from forestgen.core.progress import Progress
from forestgen.core.threads import cores
from forestgen.dataset.settings import DatasetSettings
from forestgen.dataset.writer import frame_bytes
from forestgen.plants.growing import SHARED_BYTES
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.runs.calibration_runs import CalibrationRun, CalibrationRuns, probe_images
from forestgen.runs.contract import StorageBackend
from forestgen.runs.storage import LocalStorage
from forestgen.scene.plan import estimate_bytes, make_plan

BUDGET_S = 60.0  # of the probes
LEAST_IMAGES = 50  # a smaller batch is made as fast as it is estimated
SHARE_OF_MEMORY = 0.8  # of what is free now, for all workers; the rest is the system's and this process'
_COUNTED_IMAGES = 64  # drawn, where frames or samples are drawn for each image
_NINETIETH = 1.2816  # of a normal distribution, in standard deviations
_LEAST_SPREAD, _UNKNOWN_SPREAD, _MEMORY_SPREAD = 0.05, 0.4, 0.15  # of a logarithm: of several images; of one
_SIZES_OF_ALL = 2.0  # sizes of plants in a batch, by those in an image: measured on recipes/mixed_stand.yaml
_MOST_CHANNELS = 13  # of a sensor, at a guess
_MOST_STAGES, _WIDTH = 6, 16  # of the text
_ROOM_BYTES = 50_000_000  # of a disk that is nearly full
_COUNTED_KEYS = (("render", "samples"), ("cameras", "size_px"), ("cameras", "path"), ("cameras", "rig"))


@dataclass(frozen=True)
class Range:
    """What images take: the 10th percentile, the mean, the 90th."""

    low: float
    mean: float
    high: float


@dataclass(frozen=True)
class Counts:
    """Of all images that are to be made."""

    images: int
    frames: float
    pixels: float
    paths: float  # of light: samples times pixels
    drawn: int  # images that were drawn to know; 0: what one has, all have


@dataclass(frozen=True)
class Estimate:
    """What a batch will take, and how that is known."""

    counts: Counts
    workers: int
    wanted: int | None  # workers that the user asked for
    threads: int  # of each worker
    probed: CalibrationRuns
    image_s: Range | None  # of a worker; None: not measured
    start_s: float  # of a worker, once
    stages: Mapping[str, float]  # share of an image's time, the largest first
    memory_bytes: Range  # of a worker at its peak
    disk_bytes: Range  # of an image
    parallel: float  # workers that have a core for themselves

    @property
    def seconds(self) -> Range | None:
        """Of the whole batch: its mean's uncertainty, and not the images' differences, of which many even out."""
        if self.image_s is None:
            return None
        each, probes = self.image_s, max(1, len(self.probed.probes))
        half = math.log(max(each.high / max(each.low, 1e-9), 1.0)) / 2 / math.sqrt(probes)
        total = self.start_s * self.workers / self.parallel + self.counts.images * each.mean / self.parallel
        return Range(total * math.exp(-half), total, total * math.exp(half))

    @property
    def images_per_hour(self) -> float | None:
        """Once all workers are at work."""
        return None if self.image_s is None else 3600 * self.parallel / max(self.image_s.mean, 1e-9)

    @property
    def worker_bytes(self) -> int:
        """Memory of a worker that is enough for most images."""
        return round(self.memory_bytes.high)

    @property
    def total_disk_bytes(self) -> int:
        return round(self.counts.images * self.disk_bytes.mean)

    def lines(self) -> Iterator[str]:
        """For people: what the batch takes, how that is known, and where the time goes."""
        for name, text in _rows(self):
            yield f"{name:<{_WIDTH}}{text}"
        for note in self.probed.notes:
            yield f"note: {note}"


def estimate(
    loaded: LoadedRecipe,
    settings: DatasetSettings,
    *,
    count: int,
    workers: int | None,
    threads: int | None,
    progress: Progress,
    probe: bool = False,
    budget_s: float = BUDGET_S,
) -> Estimate:
    """What `count` images of a recipe will take on this machine.

    `workers`: None: as many as its cores and its free memory allow.
    `threads`: of each worker; None: the cores are shared out.
    `probe`: whether to make images of a small batch too, which takes about as long as the batch itself.
    `budget_s`: of the probes, about; at least one is made.
    """
    counts, probed = count_images(loaded, count), CalibrationRuns(())
    here = threads or max(1, cores() // (workers or cores()))
    if count and (probe or count >= LEAST_IMAGES):
        probed = probe_images(loaded, settings, count=count, threads=here, budget_s=budget_s, progress=progress)
    drawn = loaded.draw(0)
    measured = probed.probes
    kept = 0 if drawn.recipe.plants.library is None else SHARED_BYTES  # which probes do not
    memory = (
        _range([one.memory_bytes + kept for one in measured], _MEMORY_SPREAD)
        if measured
        else _guess(sum(estimate_bytes(make_plan(drawn)).values()) + kept)
    )
    disk = _range([one.disk_bytes for one in measured]) if measured else _guess(most_disk_bytes(drawn))
    image_s, start_s, stages = _times(measured, drawn, count)
    allowed = min(cores() // here, int(SHARE_OF_MEMORY * free_bytes() / max(memory.high, 1.0)))
    chosen = workers or min(max(1, allowed), max(1, count))
    return Estimate(
        counts=counts,
        workers=chosen,
        wanted=workers,
        threads=threads or max(1, cores() // chosen),
        probed=probed,
        image_s=image_s,
        start_s=start_s,
        stages=stages,
        memory_bytes=memory,
        disk_bytes=disk,
        parallel=max(1.0, min(float(chosen), max(count, 1), cores() / here)),
    )


def check_fits(expected: Estimate, storage: StorageBackend, *, workers_here: bool = True) -> None:
    """Refuse a batch that cannot fit.

    `workers_here`: whether the workers are processes of this machine.

    Raises `ResourceError`: too little memory for a worker, or for the workers that were asked for.
    Raises `OutputError`: the disk is too small.
    """
    free, need = SHARE_OF_MEMORY * free_bytes(), expected.worker_bytes
    if workers_here and need > free:
        problem = "one worker would need more memory than is free"
        hint = "make the images or the site smaller, or lower plants.exemplars_per_species"
        raise ResourceError(problem, expected=f"at most {show_bytes(free)}", got=f"about {show_bytes(need)}", hint=hint)
    if workers_here and expected.wanted is not None and need * expected.wanted > free:
        fits = max(1, int(free / need))
        raise ResourceError(
            "so many workers would need more memory than is free",
            parameter=f"workers={expected.wanted}",
            expected=f"at most {show_bytes(free)} in all",
            got=f"about {show_bytes(need * expected.wanted)}: {show_bytes(need)} for each",
            hint=f"`workers={fits}`, or leave it out",
        )
    check_disk(storage, expected.counts.images, expected.disk_bytes.mean)


def count_images(loaded: LoadedRecipe, count: int) -> Counts:
    """Frames, pixels and light paths of `count` images: known, unless the recipe draws them for each image."""
    varies = any(keys[0] == first and last in keys for keys in loaded.distributions for first, last in _COUNTED_KEYS)
    number = min(count, _COUNTED_IMAGES) if varies else min(count, 1)
    frames = pixels = paths = 0.0
    for index in range(number):
        recipe = loaded.draw(index * count // number).recipe
        sizes = [camera.frames * math.prod(camera.size_px) for camera in recipe.cameras]
        frames += sum(camera.frames for camera in recipe.cameras)
        pixels += sum(sizes)
        paths += sum(sizes) * recipe.render.samples
    each = count / max(number, 1)
    return Counts(count, frames * each, pixels * each, paths * each, number if varies else 0)


def most_disk_bytes(drawn: DrawnRecipe) -> float:
    """Of an image, an upper estimate: nothing is compressed."""
    recipe = drawn.recipe
    sizes = [
        camera.frames * frame_bytes(camera.size_px, 0, recipe.dataset.formats, _MOST_CHANNELS if camera.bands else 3)
        for camera in recipe.cameras
    ]
    return float(sum(sizes))


def _guess(upper: float) -> Range:
    return Range(0.0, upper, upper)


def _range(values: Sequence[float], of_one: float = _UNKNOWN_SPREAD) -> Range:
    """Interval of several images; of a single one with the spread `of_one`."""
    mean = fmean(values)
    logarithms = [math.log(max(value, 1e-9)) for value in values]
    more = math.sqrt(1 + 1 / len(values))
    spread = of_one if len(values) < 2 else max(_LEAST_SPREAD, stdev(logarithms) * more)
    factor = math.exp(_NINETIETH * spread)
    middle = math.exp(fmean(logarithms))
    return Range(min(middle / factor, mean), mean, max(middle * factor, mean))


def _times(
    probes: Sequence[CalibrationRun], drawn: DrawnRecipe, count: int
) -> tuple[Range | None, float, dict[str, float]]:
    """Seconds of an image, of a worker's start, and the stages' shares of an image's time.

    The first probe of a worker loads and compiles what the next ones find: its seconds beyond theirs are the start's.
    """
    if not probes:
        return None, 0.0, {}
    warm = [one for one in probes if not one.is_first] or list(probes)
    kept = [_without_shared(one, drawn, count) for one in warm]
    seconds = _range([sum(stages.values()) for stages in kept])
    names = {name for stages in kept for name in stages}
    means = {name: fmean([stages.get(name, 0.0) for stages in kept]) for name in names}
    total = max(sum(means.values()), 1e-9)
    shares = {name: means[name] / total for name in sorted(means, key=lambda name: -means[name])}
    first = next((one.seconds for one in probes if one.is_first), 0.0)
    start = max(0.0, first - fmean([one.seconds for one in warm])) if warm[0] is not probes[0] else 0.0
    return seconds, start, shares


def _without_shared(probe: CalibrationRun, drawn: DrawnRecipe, count: int) -> dict[str, float]:
    """Seconds by stage, `other` among them; of a library, each image's part of what grows once."""
    stages = dict(probe.stages_s)
    stages["other"] = max(0.0, probe.seconds - sum(stages.values()))
    section = drawn.recipe.plants
    if section.library is not None and "plants" in stages:
        sets = len(drawn.recipe.dataset.splits) * section.library / section.variants_per_size
        growing = _SIZES_OF_ALL * sets  # images whose plants are as many as the library's
        stages["plants"] *= min(1.0, growing / max(count, 1) + 0.05)  # and the rest takes them from memory or disk
    return stages


def check_disk(storage: StorageBackend, images: int, image_bytes: float) -> None:
    """Refuse images of which the disk might not hold all. Raises `OutputError`."""
    if not (isinstance(storage, LocalStorage) and images):
        return
    folder = storage.root.absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    free, need = shutil.disk_usage(folder).free, round(images * image_bytes)
    if need + _ROOM_BYTES > free:
        fits = max(0, int((free - _ROOM_BYTES) / max(image_bytes, 1.0)))
        problem = "the data set would be larger than what is free on the disk"
        expected = f"at most {show_bytes(max(0, free - _ROOM_BYTES))}"
        got = f"about {show_bytes(need)} for {images:,} images"
        hint = f"another disk, or `count={fits}`" if fits else "another disk"
        raise OutputError(problem, where=storage.name, expected=expected, got=got, hint=hint)


def _rows(expected: Estimate) -> Iterator[tuple[str, str]]:
    counts = expected.counts
    about = "" if not counts.drawn else f" (drawn: the mean of {counts.drawn} images)"
    yield (
        "images",
        f"{counts.images:,}; {counted(round(counts.frames), 'frame')}, {three_digits(counts.pixels)} pixels, "
        f"{three_digits(counts.paths)} light paths{about}",
    )
    probes = expected.probed.probes
    if probes:
        plants, exemplars, triangles = (
            fmean([float(getattr(one, name)) for one in probes]) for name in ("plants", "exemplars", "triangles")
        )
        yield "in each", f"{plants:,.0f} plants, {exemplars:,.0f} models of {three_digits(triangles)} triangles"
    yield "workers", f"{expected.workers}, of {counted(expected.threads, 'thread')} each"
    total, each, pace = expected.seconds, expected.image_s, expected.images_per_hour
    if total is None or each is None or pace is None:
        yield "time", "not measured"
    else:
        yield "time", f"{_between(total, seconds)}; {_between(each, seconds)} an image and worker"
        yield "images an hour", three_digits(pace)
        shares = list(expected.stages.items())[:_MOST_STAGES]
        yield "time goes to", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)
    memory, disk = expected.memory_bytes, expected.disk_bytes
    yield "memory", f"{_between(memory, show_bytes)} a worker, {show_bytes(expected.workers * memory.high)} in all"
    yield "disk", f"{show_bytes(expected.total_disk_bytes)}; {_between(disk, show_bytes)} an image"
    yield "known from", _source(expected)


def _source(expected: Estimate) -> str:
    probes, reduced = expected.probed.probes, expected.probed.reduced
    if not probes:
        small = "" if expected.probed.notes else f" was made, as for batches below {LEAST_IMAGES} images"
        return f"no image{small}; memory and disk are upper bounds"
    names = ", ".join(f"{one.image}" for one in probes)
    pixels = f" of 1/{three_digits(reduced.pixels)} of the pixels" if reduced.pixels > 1 else ""
    samples = f" with 1/{three_digits(reduced.samples)} of the light paths" if reduced.samples > 1 else ""
    made = f", made{pixels}{samples}" if samples or pixels else ""
    first = "" if any(not one.is_first for one in probes) else ", with the start of a worker in its time"
    return f"{'image' if len(probes) == 1 else 'images'} {names}{made}{first}"


def _between(value: Range, show: Callable[[float], str]) -> str:
    if value.low <= 0:
        return f"at most {show(value.high)}"
    return f"{show(value.mean)} ({show(value.low)} to {show(value.high)})"
