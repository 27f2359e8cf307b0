"""Passes of the renderer in one call, for tests."""

from __future__ import annotations

import numpy as np

from forestgen.core.progress import Silent
from forestgen.core.timing import Timings
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.frame import Identity, Radiance, Surface
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.noise import Until
from forestgen.render.radiance import render_radiance
from forestgen.render.sensors import sensor_of
from forestgen.render.surfaces import Paints
from forestgen.render.variant import SCALAR, mitsuba
from forestgen.render.views import Shot
from forestgen.render.wavelengths import Mode
from forestgen.scene.spec import Camera, SceneSpec


def seen(spec: SceneSpec, samples: int, *, faces: bool = False, variant: str | None = None) -> tuple[Identity, Surface]:
    """Of the first camera."""
    return shot(SceneTracer(spec, Timings(), variant), spec.cameras[0], samples, faces=faces)


def shot(tracer: SceneTracer, camera: Camera, samples: int, *, faces: bool = False) -> tuple[Identity, Surface]:
    return trace_identity(tracer, camera, samples=samples, timer=Timings(), advance=lambda rows: None, faces=faces)


def identity(spec: SceneSpec, samples: int) -> Identity:
    return seen(spec, samples)[0]


def radiance(spec: SceneSpec, samples: int | Until, seed: int, max_depth: int = 64, mode: Mode = "rgb") -> Radiance:
    """Of the first camera, with every pixel taken to see the sky."""
    until = Until(samples) if isinstance(samples, int) else samples
    shot = Shot(spec, spec.cameras[0], until, seed, mode, max_depth)
    return render_radiance(shot, progress=Silent(), timer=Timings())


def alpha(spec: SceneSpec, samples: int) -> np.ndarray:
    """(H, W) share of the radiance pass' rays that meet the scene."""
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        scene = load({**scene_dict(spec, origin_of(spec.cameras[0]), Paints()), "light": {"type": "constant"}})
        integrator = mi.load_dict({"type": "volpath", "max_depth": 2, "hide_emitters": True})
        image = integrator.render(scene, sensor=sensor_of(spec.cameras[0], samples), seed=1, spp=samples)
        return np.array(image)[..., 3].astype(np.float64)
