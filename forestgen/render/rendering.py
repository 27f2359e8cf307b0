"""Scene -> frames: what a camera sees, its light with its variance, and notes on both.

An image is the mean of independent replicates (render/noise.py), each made of passes: one in colour, or several at
three wavelengths each (render/wavelengths.py). Passes capture one scene that is built once (render/views.py), until
there are as many samples, or as little noise, as was asked for.

Running sums are kept on disk, so that an interrupted image goes on from its last replicate: in the folder `radiance` of
the cache (core/cache.py), under the hash of all that the image depends on: the drawn recipe, the image's seed, the
camera, and the code, tables and packages that make it. A sum is written when work is interrupted, and at times while it
goes on, so that a process that is killed loses little; it is removed when the image is done. What is continued has the
bytes of what was never interrupted: a replicate's seeds belong to its number.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_rng, child_seed
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.schema import Recipe
from forestgen.render.capture import least_samples
from forestgen.render.cloud_shadow import cloud_transport_of
from forestgen.render.denoise import denoise, denoise_bands, guide_values, guides_of
from forestgen.render.frame import Frame, Identity, Radiance, RenderJob, StoppingCriterion, Surface, Timer, View
from forestgen.render.haze import KOSCHMIEDER, extinction_towards, seen_of, seen_values, through_haze
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.identity.surface import pixel_sums
from forestgen.render.noise import Noise, Schedule, SliceSum, noise_of
from forestgen.render.skies.model import daylight_of
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
    radiance = _radiance(tracer, camera, recipe, seed, surface, progress, timings, key)
    return Frame(camera=camera, radiance=radiance, identity=identity, surface=surface)


def _radiance(
    tracer: SceneTracer,
    camera: Camera,
    recipe: Recipe,
    seed: int,
    surface: Surface,
    progress: Progress,
    timings: Timings,
    key: str | None,
) -> Radiance:
    """With its denoised copy where that is asked for."""
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
    kept = None if key is None else unfinished(key, seed, camera.name)
    radiance = render_radiance(shot, progress=progress, timer=timings, kept=kept, tracer=tracer)
    extinction, guides, seen = extinction_towards(camera, tracer.spec.sky, settings.mode), None, None
    if settings.denoise:
        wanted = [guide_values(tracer, camera)] + ([] if extinction is None else [seen_values(extinction)])
        with timings("identity: guides"):  # and the haze's distances, along the same rays
            sums = pixel_sums(tracer, camera, wanted)
        guides, seen = guides_of(sums[0]), None if extinction is None else seen_of(sums[1])
    radiance = through_haze(radiance, tracer, camera, mode=settings.mode, timer=timings, seen=seen)
    if guides is not None:
        with timings("denoise"):
            clean = (denoise_bands if radiance.bands else denoise)(radiance.mean, guides.colour, guides.normal)
        radiance = replace(radiance, denoised=clean)
    return radiance


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
    schedule = Schedule(job.until, quadrature.passes, least_samples(job.camera) if job.is_exact else 1)
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
