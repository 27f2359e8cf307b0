"""What a view's denoiser and its haze need, each by a pass of its own; renders trace both along the same rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.render.denoise import Guides, guide_values, guides_of
from forestgen.render.frame import Radiance
from forestgen.render.haze import Seen, extinction_towards, seen_of, seen_values, through_haze
from forestgen.render.identity.surface import pixel_sums
from forestgen.render.identity.tracer import SceneTracer
from forestgen.render.wavelengths import Mode
from forestgen.scene.spec import Camera


def trace_guides(tracer: SceneTracer, camera: Camera) -> Guides:
    """Guides of what `camera` sees of the tracer's scene."""
    return guides_of(*pixel_sums(tracer, camera, [guide_values(tracer, camera)]))


def trace_seen(tracer: SceneTracer, camera: Camera, extinction_per_m: NDArray[np.float64]) -> Seen:
    """What `camera` sees of the tracer's scene through a haze of an extinction (C,)."""
    return seen_of(*pixel_sums(tracer, camera, [seen_values(tracer, camera, extinction_per_m)]))


def seen_through_haze(radiance: Radiance, tracer: SceneTracer, camera: Camera, mode: Mode) -> Radiance:
    """The image as the haze of the tracer's scene shows it."""
    extinction = extinction_towards(camera, tracer.spec.sky, mode)
    assert extinction is not None
    return through_haze(radiance, tracer.spec, camera, trace_seen(tracer, camera, extinction), extinction, mode)
