"""A denoiser's guides in a pass of their own; renders trace them together with what haze needs."""

from __future__ import annotations

from forestgen.render.denoise import Guides, guide_values, guides_of
from forestgen.render.identity.surface import pixel_sums
from forestgen.render.identity.tracer import SceneTracer
from forestgen.scene.spec import Camera


def trace_guides(tracer: SceneTracer, camera: Camera) -> Guides:
    """Guides of what `camera` sees of the tracer's scene."""
    return guides_of(*pixel_sums(tracer, camera, [guide_values(tracer, camera)]))
