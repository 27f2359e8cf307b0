"""The identity pass: who is in each sample of each pixel, traced exactly.

`ray_intersect_preliminary` of an LLVM or CUDA variant needs no code per instance, so its one small kernel serves any
number of instances. What a hit means is looked up in flat tables: instance -> plant, (exemplar, organ) -> part and
colour, face -> normal and vertices (`tracer`). Rays leave in a regular grid of S sub-pixel positions; a further ray
through the pixel's centre gives depth, position, normals, colour and the sun's visibility (`surface`).
"""

from __future__ import annotations

from forestgen.render.identity.surface import trace_identity
from forestgen.render.identity.tracer import SceneTracer, camera_rays, face_normals, hit_tables, sample_offsets

__all__ = ["SceneTracer", "camera_rays", "face_normals", "hit_tables", "sample_offsets", "trace_identity"]
