"""Passes of the renderer in one call, for tests."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from forestgen.core.progress import Silent, Timings
from forestgen.render.frame import Identity, Radiance, RenderJob, StoppingCriterion, Surface
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import sky_map
from forestgen.render.paths.tracer import PathTracer
from forestgen.render.rendering import render_radiance
from forestgen.render.variant import cuda_devices
from forestgen.render.wavelengths import Mode
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, SceneSpec


def seen(spec: SceneSpec, samples: int, *, faces: bool = False, variant: str | None = None) -> tuple[Identity, Surface]:
    """Of the first camera."""
    return shot(SceneTracer(spec, Timings(), variant), spec.cameras[0], samples, faces=faces)


def shot(tracer: SceneTracer, camera: Camera, samples: int, *, faces: bool = False) -> tuple[Identity, Surface]:
    return trace_identity(tracer, camera, samples=samples, timer=Timings(), advance=lambda rows: None, faces=faces)


def identity(spec: SceneSpec, samples: int) -> Identity:
    return seen(spec, samples)[0]


def radiance(
    spec: SceneSpec, samples: int | StoppingCriterion, seed: int, max_depth: int = 64, mode: Mode = "rgb"
) -> Radiance:
    """Of the first camera, with every pixel taken to see the sky."""
    until = StoppingCriterion(samples) if isinstance(samples, int) else samples
    shot = RenderJob(spec, spec.cameras[0], until, seed, mode, max_depth)
    return render_radiance(shot, progress=Silent(), timer=Timings())


def need_cuda() -> None:
    """Skip a test where there is no GPU."""
    try:
        cuda_devices()
    except RuntimeError as error:
        pytest.skip(str(error))


def alpha(spec: SceneSpec, samples: int) -> np.ndarray:
    """(H, W) share of the light paths of the first camera that meet the scene; outside of a circle 1."""
    lit = PathTracer(SceneTracer(spec, Timings()), spec.cameras[0], 1, partial(sky_map, spec.sky))
    lit.show(RGB)
    return 1.0 - lit.take(samples, seed=1).open
