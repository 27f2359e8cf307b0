"""Trials of the renderer's variants: each computes something small and says what it used."""

from __future__ import annotations

from forestgen.render.cuda import cuda_devices
from forestgen.render.variant import LLVM, SCALAR, drjit, find_llvm, mitsuba


def check_scalar() -> str:
    """Trace one ray in the scalar variant."""
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
        hit = scene.ray_intersect_preliminary(mi.Ray3f([0, 0, -5], [0, 0, 1]))
        if abs(hit.t - 4.0) > 1e-4:
            raise RuntimeError(f"a ray that should travel 4 m travels {hit.t} m")
        return f"works, {drjit().thread_count()} threads"


def check_llvm() -> str:
    """Compile and run a kernel in the LLVM variant."""
    mi = mitsuba()
    library = find_llvm()
    if library is None:
        raise RuntimeError("no libLLVM found")
    with mi.variant_context(LLVM):
        dr = drjit()
        total = dr.sum(dr.arange(mi.Float, 100))[0]
        if total != 4950:
            raise RuntimeError(f"the sum of 0 to 99 came out as {total}")
    return f"works, {library}"


def check_cuda() -> str:
    """Name the CUDA devices."""
    return cuda_devices()
