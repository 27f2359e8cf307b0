"""Sums over many rays a pixel: what the denoiser's guides and the haze need to know of a view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity.tracer import Hits, SceneTracer, sample_offsets
from forestgen.render.variant import drjit, using
from forestgen.scene.spec import Camera

SAMPLES = 64  # a pixel
_RAYS_AT_ONCE = 1_000_000
Values = Callable[[Hits], Sequence[Any]]


def pixel_sums(tracer: SceneTracer, camera: Camera, wanted: Sequence[Values]) -> list[NDArray[np.float32]]:
    """(C, H, W) for each of `wanted`: its C values, Float by ray, summed over a pixel's `SAMPLES` rays.

    All of them are found in one launch: tracing the rays is what takes long.
    """
    dr = drjit()
    width, height = camera.size_px
    rows = max(1, _RAYS_AT_ONCE // (width * SAMPLES))
    blocks = []
    with using(tracer.variant):
        for first in range(0, height, rows):
            count = min(rows, height - first)
            hits = tracer.trace(camera, sample_offsets(SAMPLES), first, count)
            values = [list(one(hits)) for one in wanted]
            dr.eval(values)  # together, and before the sums: each sum alone would trace all the rays again
            sums = [[dr.block_sum(one, SAMPLES) for one in group] for group in values]
            dr.eval(sums)
            blocks.append([np.array(group).reshape(-1, count, width) for group in sums])
        dr.flush_malloc_cache()
    return [np.concatenate(parts, axis=1) for parts in zip(*blocks, strict=True)]
