"""Scene -> frames: what a camera sees, its light, and notes on both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from forestgen.core.progress import Progress, Timings
from forestgen.core.randomness import child_seed
from forestgen.recipe.schema import Recipe
from forestgen.render.cloud_shadow import cloud_transport_of
from forestgen.render.denoise import denoise, denoise_bands, guide_values, guides_of
from forestgen.render.frame import Frame, Identity, Radiance, Surface
from forestgen.render.haze import KOSCHMIEDER, extinction_towards, seen_of, seen_values, through_haze
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.identity.sums import pixel_sums
from forestgen.render.job import RenderJob, StoppingCriterion
from forestgen.render.radiance import render_radiance, unfinished
from forestgen.scene.spec import Camera, SceneSpec

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
        until=StoppingCriterion(
            samples=settings.samples,
            target_error=settings.target_error,
            target_error_p95=settings.target_error_p95,
            time_budget_s=settings.time_budget_s,
            most_samples=settings.most_samples,
        ),
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
