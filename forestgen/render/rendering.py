"""Scene -> frames: what a camera sees, its light with its variance, and notes on both.

An image is the mean of independent replicates, each made of passes: one in colour, or several at three wavelengths each
(render/wavelengths.py). Passes capture one scene that is built once (render/views.py), until
there are as many samples, or as little noise, as was asked for.

Running sums are kept on disk, so that an interrupted image goes on from its last replicate: in the folder `radiance` of
the cache (core/cache.py), under the hash of all that the image depends on: the drawn recipe, the image's seed, the
camera, and the code, tables and packages that make it. A sum is written when work is interrupted, and at times while it
goes on, so that a process that is killed loses little; it is removed when the image is done. What is continued has the
bytes of what was never interrupted: a replicate's seeds belong to its number.

Noise
-----
The relative error of a pixel is its standard error over its value, both over all channels:

    e² = sum over c of (variance_c / s_c²) / sum over c of (max(mean_c, 0.1 s_c) / s_c)²,

where s_c is the channel's mean over the image: bands of different strength count alike, and a pixel darker than a tenth
of it is measured against that tenth. Variance and mean are first averaged over 3 x 3 pixels: the variance of one pixel
comes from a few replicates and is itself noisy, which would raise the percentile. `relative_error` is the mean of e
over the pixels, which a few bright specks do not move, `relative_error_p95` its 95th percentile. Pixels outside of a
fisheye's circle do not count.

e falls as 1 / sqrt(n). So an image with error e after n samples needs n (e / target)²; slices are at most a sixteenth
of that, and the need is judged anew after each, by all slices so far. The last slice is what is left.

Samples need not be independent inside a slice (a stratified sampler's are not): the scatter of slices gives the
variance of the mean.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.extinction import KOSCHMIEDER
from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.parts import Part
from forestgen.core.progress import Progress, Silent, Timings
from forestgen.core.randomness import child_rng, child_seed
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.schema import Recipe
from forestgen.render.capture import LEAST_SAMPLES, is_assembled
from forestgen.render.cloud_shadow import cloud_transport_of
from forestgen.render.denoise import denoise, denoise_bands, guide_values, guides_of, open_values, with_clouds
from forestgen.render.falling import with_streaks
from forestgen.render.frame import Frame, Identity, Radiance, RenderJob, StoppingCriterion, Surface, Timer, View
from forestgen.render.haze import extinction_towards, seen_of, seen_values, through_haze
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.identity.surface import SAMPLES, pixel_sums
from forestgen.render.metering import light_around, with_shutter
from forestgen.render.skies.model import daylight_of
from forestgen.render.sun_at_lens import sun_at_lens
from forestgen.render.variant import MOST_SLICE_SAMPLES, SLICES
from forestgen.render.views import build_view
from forestgen.render.wavelengths import Quadrature, quadrature_of
from forestgen.scene.projection import image_circle
from forestgen.scene.spec import Camera, SceneSpec

EVERY_S = 20.0  # at least, from one writing to the next
_MOST_BYTES = 4_000_000_000
# Layers that shape an image.
_SOURCES = (
    "architecture", "atmosphere", "community", "core", "geometry", "lsystem", "plants", "recipe", "render", "scene",
)  # fmt: skip
_COMPUTE_WITH = ("numpy", "scipy", "numba", "pvlib", "mitsuba", "drjit")
_STEPS = 1000  # of the progress of an image
_THICK_HAZE = 1.0  # optical depth to the far plants
_FLOOR = 0.1
_WINDOW = 3
_SHARE_OF_NEED = 16
_FINEST = 64  # a slice is at least this share of the samples so far


def render_frame(
    tracer: SceneTracer,
    camera: Camera,
    recipe: Recipe,
    seed: int,
    progress: Progress,
    timings: Timings,
    *,
    check: Callable[[Identity], None] | None = None,
    key: str | None = None,
) -> Frame:
    """Trace what the samples hit, then their light.

    Parameters
    ----------
    tracer : of the scene as it is at the camera's time.
    seed : of the image.
    check : refuses ids that files cannot hold, before the light, which takes long.
    key : hash of the drawn recipe, by which an interrupted image finds what was done; None: it begins anew.
    """
    with progress.stage(f"identity {camera.name}", camera.size_px[1]) as advance:
        identity, surface = trace_identity(
            tracer, camera, samples=recipe.labels.samples, timer=timings, advance=advance
        )
    if check is not None:
        check(identity)
    settings = recipe.render
    shot = RenderJob(
        spec=tracer.spec,
        camera=camera,
        until=StoppingCriterion(**{one.name: getattr(settings, one.name) for one in fields(StoppingCriterion)}),
        seed=child_seed(seed, "radiance", camera.name),
        mode=settings.mode,
        max_depth=settings.max_depth,
        cloud_transport=cloud_transport_of(settings.clouds, tracer.spec, (camera,)),
        position_m=surface.position_m,
    )
    meter = partial(_metered, tracer=tracer, timings=timings)
    shot = with_shutter(shot, meter)
    camera = shot.camera
    kept = None if key is None else unfinished(key, seed, camera.name)
    radiance = render_radiance(shot, progress=progress, timer=timings, kept=kept, tracer=tracer)
    radiance = replace(radiance, sun=sun_at_lens(shot, tracer))
    sky = (identity.part == Part.NOTHING).mean(axis=2) if settings.denoise else None
    frame = Frame(camera, _finished(shot, radiance, tracer, timings, sky), identity, surface)
    return with_streaks(frame, tracer.spec.falling, seed, lambda: light_around(shot, meter))


def _metered(still: RenderJob, tracer: SceneTracer, timings: Timings) -> Radiance:
    """What a meter sees."""
    radiance = render_radiance(still, progress=Silent(), timer=timings, tracer=tracer)
    return _finished(still, radiance, tracer, timings)


def _finished(
    shot: RenderJob,
    radiance: Radiance,
    tracer: SceneTracer,
    timings: Timings,
    sky: NDArray[np.float64] | None = None,
) -> Radiance:
    """The light through the haze; and denoised, if `sky` is given, (H, W) the share of a pixel that sees nothing."""
    camera, wanted, sums = shot.camera, [], []
    extinction = extinction_towards(camera, tracer.spec.sky, shot.mode)
    if sky is not None:
        wanted += [guide_values(tracer, camera)] + ([] if camera.motion is None else [open_values])
    if extinction is not None:
        wanted.append(seen_values(tracer, camera, extinction))
    if wanted:
        with timings("identity: guides"):  # and the haze's distances, along the same rays
            sums = pixel_sums(tracer, camera, wanted)
    if extinction is not None:
        with timings("haze: airlight"):
            radiance = through_haze(radiance, tracer.spec, camera, seen_of(sums[-1]), extinction, shot.mode)
    if sky is not None:
        with timings("denoise"):
            sky = sky if camera.motion is None else sums[1][0] / SAMPLES
            guides = with_clouds(guides_of(sums[0]), tracer.spec, camera, sky)
            clean = (denoise_bands if radiance.bands else denoise)(radiance.mean, guides.colour, guides.normal)
        radiance = replace(radiance, denoised=clean)
    return radiance


@dataclass(frozen=True)
class Estimate:
    """Mean of slices and the variance of that mean; the variance is NaN for a single slice."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SliceSum:
    """Weighted running mean and variance of slices of different length (West 1979); the same after an interruption."""

    samples: int = 0
    slices: int = 0
    mean: Any = 0.0  # (H, W, C)
    scatter: Any = 0.0  # (H, W, C) sum of samples x squared distance from the mean

    def added(self, image: NDArray[np.float64], samples: int) -> SliceSum:
        """The sum with one more slice."""
        weight = self.samples + samples
        difference = image - self.mean
        mean = self.mean + difference * (samples / weight)
        return SliceSum(weight, self.slices + 1, mean, self.scatter + samples * difference * (image - mean))

    def estimate(self) -> Estimate:
        if self.slices < 2:
            return Estimate(self.mean, np.full_like(self.mean, np.nan))
        return Estimate(self.mean, self.scatter / (self.samples * (self.slices - 1)))


def slice_sizes(samples: int) -> list[int]:
    """Samples of each slice: nearly equal ones, at least two if there are two samples."""
    count = min(samples, max(SLICES, -(-samples // MOST_SLICE_SAMPLES)))
    return [samples // count + (1 if k < samples % count else 0) for k in range(count)]


@dataclass(frozen=True)
class Noise:
    """Relative error of an image; NaN for a single slice."""

    relative_error: float
    relative_error_p95: float


def noise_of(estimate: Estimate, seen: NDArray[np.bool_]) -> Noise:
    """Of (H, W, C) mean and variance; `seen` are the (H, W) pixels that count."""
    from scipy.ndimage import uniform_filter

    if not np.isfinite(estimate.variance).all() or not seen.any():
        return Noise(math.nan, math.nan)
    scale = estimate.mean[seen].mean(axis=0)
    used = scale > 0
    if not used.any():
        return Noise(0.0, 0.0)  # no light
    size = (_WINDOW, _WINDOW, 1)
    share = np.maximum(uniform_filter(seen.astype(np.float64), _WINDOW, mode="constant"), 1e-9)[..., None]
    mean, variance = (
        uniform_filter(image[..., used] * seen[..., None], size, mode="constant") / share / scale[used] ** power
        for image, power in ((estimate.mean, 1), (estimate.variance, 2))
    )
    signal = (np.maximum(mean, _FLOOR) ** 2).sum(axis=2)
    error = np.sqrt(np.maximum(variance.sum(axis=2), 0.0) / signal)[seen]
    return Noise(float(error.mean()), float(np.quantile(error, 0.95)))


class Schedule:
    """Which slice comes next. A function of what has been done alone: interrupted work goes on the same."""

    def __init__(self, until: StoppingCriterion, passes: int, least: int = 1) -> None:
        """`least` is the number of samples below which a camera takes no pass.

        `first` are sizes of the slices that are always rendered (but for a time budget).
        """
        self._until, self._least = until, least
        self.first = [max(size, least) for size in slice_sizes(-(-until.samples // passes))]
        self._most = max(-(-until.most_samples // passes), sum(self.first))
        self.stopped_by = ""

    def next_size(self, total: SliceSum, noise: Noise, elapsed_s: float) -> int:
        """Samples of the next slice in each pass, 0 when the image is done, for the reason in `stopped_by`."""
        size = self._wanted(total, noise)
        budget_s = self._until.time_budget_s
        if size and budget_s is not None and total.slices >= min(2, len(self.first)):
            fits = int((budget_s - elapsed_s) / (elapsed_s / total.samples)) if elapsed_s > 0 else size
            if fits < 1:
                self.stopped_by = "time_budget_s"
            size = max(min(size, fits), 0)
        return size

    def asks_for_noise(self, total: SliceSum) -> bool:
        """Whether the next slice depends on the noise so far."""
        targets = (self._until.target_error, self._until.target_error_p95)
        return targets != (None, None) and total.slices >= len(self.first)

    def progress(self, total: SliceSum, noise: Noise, elapsed_s: float) -> float:
        """Share of the work that is done, at a guess."""
        if not total.samples:
            return 0.0
        need = min(self._need(total, noise), float(self._most)) if self._until.open_ended else float(sum(self.first))
        if self._until.time_budget_s is not None and elapsed_s > 0:
            need = min(need, total.samples * self._until.time_budget_s / elapsed_s)
        return min(total.samples / max(need, sum(self.first), 1.0), 1.0)

    def _wanted(self, total: SliceSum, noise: Noise) -> int:
        if total.slices < len(self.first):
            return self.first[total.slices]
        need = self._need(total, noise)
        if not self._until.open_ended:
            self.stopped_by = "samples"
        elif need <= total.samples:
            self.stopped_by = "target_error"
        elif total.samples >= self._most:
            self.stopped_by = "most_samples"
        if self.stopped_by:
            return 0
        need = min(need, float(self._most))
        size = max(self.first[0], min(int(need / _SHARE_OF_NEED), MOST_SLICE_SAMPLES))
        size = max(min(size, math.ceil(need - total.samples)), total.samples // _FINEST)
        return max(min(size, self._most - total.samples), self._least)

    def _need(self, total: SliceSum, noise: Noise) -> float:
        """Samples in each pass that the targets ask for."""
        errors = (noise.relative_error, noise.relative_error_p95)
        targets = (self._until.target_error, self._until.target_error_p95)
        ratios = [error / target for error, target in zip(errors, targets, strict=True) if target is not None]
        if not ratios or math.isnan(max(ratios)):
            return math.inf
        return total.samples * max(ratios) ** 2


@dataclass(frozen=True)
class _Sum:
    """A running sum and the seconds spent on it."""

    total: SliceSum
    elapsed_s: float


@dataclass
class Unfinished:
    """The place of one image's running sum. It is used in one thread."""

    store: DiskCache
    key: str
    _written_s: float = 0.0

    def read(self) -> tuple[SliceSum, float]:
        """The sum so far and the seconds spent on it; an empty one if there is none that can be read."""
        self._written_s = time.monotonic()
        found = read_packed(self.store, self.key, (_Sum, SliceSum))
        return (SliceSum(), 0.0) if found is None else (found.total, found.elapsed_s)

    def write(self, total: SliceSum, elapsed_s: float, *, now: bool = False) -> None:
        """Keep the sum; unless it must be `now`, at most every `EVERY_S` seconds."""
        if not total.slices or not (now or time.monotonic() - self._written_s >= EVERY_S):
            return
        self.store.write(self.key, pack(_Sum(total, elapsed_s)))
        self.store.trim()
        self._written_s = time.monotonic()

    def drop(self) -> None:
        """The image is done."""
        self.store.drop(self.key)


def unfinished(*identity: str | int) -> Unfinished | None:
    """The place of an image, by all that it depends on besides the code; None if nothing can be kept here."""
    root = cache_root()
    if root is None:
        return None
    code = code_hash(_SOURCES, _COMPUTE_WITH, tuple(scenes_dir() / kind for kind in ("spectra", "modules")))
    text = repr((code, *identity))
    return Unfinished(DiskCache(root / "radiance", _MOST_BYTES), hashlib.sha256(text.encode()).hexdigest())


def render_radiance(
    job: RenderJob,
    *,
    progress: Progress,
    timer: Timer,
    kept: Unfinished | None = None,
    tracer: SceneTracer | None = None,
) -> Radiance:
    """Radiance of a job, not yet denoised.

    `timer` books time under a name; "light paths" is time without what is set up for them. `kept` is where an
    interrupted image's sum is kept; None: nowhere. `tracer` is that of the job's scene, if there is one already.
    """
    open_light = daylight_of(job.spec.sky).on_level
    quadrature = quadrature_of(job.camera, job.mode, open_light)
    least = LEAST_SAMPLES if job.is_exact and is_assembled(job.camera) else 1
    schedule = Schedule(job.until, quadrature.passes, least)
    view = build_view(job, progress, timer, tracer)
    with progress.stage("radiance", _STEPS) as advance:
        total, noise = _replicates(job, view, quadrature, schedule, advance, kept)
    estimate = total.estimate()
    return Radiance(
        mean=estimate.mean.astype(np.float32),
        variance=estimate.variance.astype(np.float32),
        denoised=None,
        samples=total.samples * quadrature.passes,
        channels=quadrature.names,
        bands=quadrature.bands,
        replicates=total.slices,
        open_irradiance=tuple(quadrature.of_light(open_light)),
        relative_error=noise.relative_error,
        relative_error_p95=noise.relative_error_p95,
        stopped_by=schedule.stopped_by,
    )


def _replicates(
    job: RenderJob,
    view: View,
    quadrature: Quadrature,
    schedule: Schedule,
    advance: Callable[[int], None],
    kept: Unfinished | None,
) -> tuple[SliceSum, Noise]:
    """Replicates until the schedule says that the image is done."""
    seen = image_circle(job.camera)
    total, before_s = (SliceSum(), 0.0) if kept is None else kept.read()
    start_s, shown = time.monotonic(), 0
    try:
        while True:
            elapsed_s = before_s + time.monotonic() - start_s
            decides = schedule.asks_for_noise(total)
            noise = noise_of(total.estimate(), seen) if decides else Noise(np.nan, np.nan)
            done = int(_STEPS * schedule.progress(total, noise, elapsed_s))
            advance(max(done - shown, 0))
            shown = max(done, shown)
            size = schedule.next_size(total, noise, elapsed_s)
            if not size:
                break
            total = total.added(_replicate(job, view, quadrature, total.slices, size), size)
            if kept is not None:
                kept.write(total, before_s + time.monotonic() - start_s)
    except BaseException:
        if kept is not None:
            kept.write(total, before_s + time.monotonic() - start_s, now=True)
        raise
    advance(_STEPS - shown)
    if kept is not None:
        kept.drop()
    return total, noise_of(total.estimate(), seen)


def _replicate(job: RenderJob, view: View, quadrature: Quadrature, number: int, samples: int) -> NDArray[np.float64]:
    """(H, W, C) image of one replicate, its passes' samples each."""
    rng = child_rng(job.seed, "wavelengths")
    width, height = job.camera.size_px
    image = np.zeros((height, width, len(quadrature.names)))
    for index, one in enumerate(quadrature.draw(rng, number)):
        image += view.take(one.channels, samples, (number, index)) @ one.weight.T
    return image


def noise_notes(radiance: Radiance, name: str) -> list[str]:
    """What people should know of an image that did not reach its target, or whose bytes came from the clock."""
    about = f"{radiance.samples} samples, relative error {radiance.relative_error:.3g}"
    if radiance.stopped_by == "time_budget_s":
        return [f"{name}: render.time_budget_s ended it at {about}; another run may end it elsewhere"]
    if radiance.stopped_by == "most_samples":
        return [f"{name}: render.most_samples ended it at {about}, above its target"]
    return []


def haze_notes(spec: SceneSpec, surface: Surface, name: str) -> list[str]:
    """What people should know of haze that is too thick for what a camera sees; see render/haze.py."""
    if spec.sky.visibility_m is None or not (surface.plant_id > 0).any():
        return []
    far_m = float(np.percentile(surface.distance_m[surface.plant_id > 0], 95))
    depth = KOSCHMIEDER / spec.sky.visibility_m * far_m
    if depth <= _THICK_HAZE:
        return []
    return [
        f"{name}: its far plants stand behind {100 * (1 - np.exp(-depth)):.0f}% of haze, which is meant to be thin; "
        "sky.clouds: fog scatters light as often as that takes"
    ]
