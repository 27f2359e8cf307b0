"""What the denoiser is guided by: nearly noise-free pictures of the scene's colours in sun and shade, and its normals.

Tracing a ray is much cheaper than a light path, so the guides can have many samples. The sun's share is in the colours
since its shadows are edges too: a denoiser that knows albedo alone takes them for noise and smears them.
Clouds and what lies between are left to the denoiser.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity.surface import albedo, shading_normal, sun_visible
from forestgen.render.identity.tracer import SceneTracer, sample_offsets
from forestgen.render.skies.model import sky_model_of
from forestgen.render.variant import drjit, mitsuba, using
from forestgen.scene.spec import Camera

SAMPLES = 64  # a pixel
_SHADE = 0.15  # light in the shade, by that of a surface that faces the sun
_RAYS_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class Guides:
    """Means over a pixel's samples."""

    colour: NDArray[np.float32]  # (H, W, 3) reflectance + transmittance, times the light of sun and shade; the sky: 1
    normal: NDArray[np.float32]  # (H, W, 3) shading normals, world; the sky: 0


def trace_guides(tracer: SceneTracer, camera: Camera, *, timer: Callable[[str], Any]) -> Guides:
    """Guides of what `camera` sees of the tracer's scene."""
    width, height = camera.size_px
    colour, normal = (np.zeros((height, width, 3), dtype=np.float32) for _ in range(2))
    rows = max(1, _RAYS_AT_ONCE // (width * SAMPLES))
    with using(tracer.variant), timer("identity: guides"):
        for first in range(0, height, rows):
            last = min(first + rows, height)
            found = _trace_rows(tracer, camera, first, last - first)
            for field, value in zip((colour, normal), found, strict=True):
                field[first:last] = np.array(value).reshape(last - first, width, 3)
        drjit().flush_malloc_cache()
    return Guides(colour, normal)


def _trace_rows(tracer: SceneTracer, camera: Camera, first: int, count: int) -> tuple[Any, Any]:
    mi, dr = mitsuba(), drjit()
    hits = tracer.trace(camera, sample_offsets(SAMPLES), first, count)
    facing = tracer.geometric_normal(hits)
    smooth = shading_normal(tracer, hits, facing)
    shade = mi.Float(1.0)
    if sky_model_of(tracer.spec.sky).has_sun:
        lit = sun_visible(tracer, camera, hits, facing)
        shade = _SHADE + (1.0 - _SHADE) * dr.select(lit, dr.abs(dr.dot(smooth, tracer.to_sun)), 0.0)
    colour = dr.select(hits.valid, albedo(tracer, hits) * shade, 1.0)
    smooth = dr.select(hits.valid, smooth, 0.0)
    dr.eval(colour, smooth)
    means = [
        dr.ravel(type(value)(*[dr.block_sum(channel, SAMPLES) / SAMPLES for channel in value]))
        for value in (colour, smooth)
    ]
    dr.eval(means)
    return means[0], means[1]
