"""The identity pass of one camera: S samples a pixel, and the surface at pixel centres."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from forestgen.render.frame import Identity, Surface
from forestgen.render.identity.surface import empty_surface, trace_rows
from forestgen.render.identity.tracer import SceneTracer, sample_offsets
from forestgen.render.variant import drjit, mitsuba, using
from forestgen.scene.spec import Camera

_RAYS_AT_ONCE = 2_000_000


def trace_identity(
    tracer: SceneTracer,
    camera: Camera,
    *,
    samples: int,
    timer: Callable[[str], Any],
    advance: Callable[[int], None],
    faces: bool = False,
) -> tuple[Identity, Surface]:
    """What `camera` sees of the tracer's scene.

    Time O(pixels x samples x log triangles); memory 5 bytes a sample (13 with faces), 94 bytes a pixel, and about
    60 bytes a ray of a block of two million rays.

    Parameters
    ----------
    samples : a pixel; a perfect square.
    timer : context manager that books time under a name.
    advance : is told of rows that are done.
    faces : tell each sample's exemplar and face too.
    """
    width, height = camera.size_px
    identity, surface = _empty(height, width, samples, faces), empty_surface(height, width)
    with using(tracer.variant):
        with timer("identity: trace"):
            block = max(1, _RAYS_AT_ONCE // (width * samples))
            for first in range(0, height, block):
                rows = slice(first, min(first + block, height))
                _trace_samples(tracer, camera, samples, rows, identity)
                advance(rows.stop - rows.start)
        with timer("identity: surface"):
            block = max(1, _RAYS_AT_ONCE // width)
            for first in range(0, height, block):
                trace_rows(tracer, camera, slice(first, min(first + block, height)), surface)
        drjit().flush_malloc_cache()
    return identity, surface


def _empty(height: int, width: int, samples: int, faces: bool) -> Identity:
    shape = (height, width, samples)
    return Identity(
        plant_id=np.zeros(shape, dtype=np.uint32),
        part=np.zeros(shape, dtype=np.uint8),
        exemplar=np.zeros(shape, dtype=np.uint32) if faces else None,
        face=np.zeros(shape, dtype=np.uint32) if faces else None,
    )


def _trace_samples(tracer: SceneTracer, camera: Camera, samples: int, rows: slice, identity: Identity) -> None:
    """Fill `rows`, all samples of all their pixels in one launch."""
    mi, dr = mitsuba(), drjit()
    byte = dr.uint8_array_t(mi.UInt32)
    hits = tracer.trace(camera, sample_offsets(samples), rows.start, rows.stop - rows.start)
    found = {
        "plant_id": dr.gather(mi.UInt32, tracer.plant_id, hits.instance, hits.valid),
        "part": byte(dr.gather(mi.UInt32, tracer.part, hits.organ, hits.valid)),
    }
    if identity.face is not None:
        found["exemplar"] = dr.gather(mi.UInt32, tracer.exemplar, hits.instance, hits.valid)
        found["face"] = tracer.face_in_exemplar(hits)
    dr.eval(found)
    for name, values in found.items():
        field = getattr(identity, name)
        field[rows] = np.array(values).reshape(field[rows].shape)
