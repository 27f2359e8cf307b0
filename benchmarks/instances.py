"""Cost of 10,000 instances: `uv run python benchmarks/instances.py`; exit code 1 if a bound is missed.

Bounds: the radiance scene builds in under 5 s; the identity pass of 512 x 256 pixels, one sample, with set-up, takes
under 3 s. Beside it, alternately: Mitsuba's own `aov` integrator (at 1,000 instances, where it is bearable), which
looks shapes up one by one, and the same scene with every instance expanded into meshes of its own.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from forestgen.core.progress import Timings
from forestgen.render.build import load, origin_of, plants_dict, scene_dict, to_mesh
from forestgen.render.capture import sensor_of
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, mitsuba
from forestgen.scene.colour import RGB
from forestgen.scene.spec import SceneSpec
from support.radiometry import lights
from support.scenes import scattered_scene
from support.twins import trace_twin

INSTANCES, COMPARED = 10_000, 1_000
SIZE_PX = (512, 256)
SCENE_BOUND_S, IDENTITY_BOUND_S = 5.0, 3.0
ROUNDS = 3


def seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def build_scene(spec: SceneSpec) -> None:
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        load({**scene_dict(spec, origin_of(spec.cameras[0]), SpectralBsdfs()), **lights(spec.sky, RGB)})


def identity(spec: SceneSpec) -> np.ndarray:
    tracer = SceneTracer(spec, Timings())
    traced, _ = trace_identity(tracer, spec.cameras[0], samples=1, timer=Timings(), advance=lambda rows: None)
    return traced.plant_id


def aov(spec: SceneSpec) -> np.ndarray:
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        origin = origin_of(spec.cameras[0])
        terrain = to_mesh(spec.terrain.mesh, None, origin, "terrain")
        scene = load({**plants_dict(spec, origin, None), "terrain": terrain})
        integrator = mi.load_dict({"type": "aov", "aovs": "shape:shape_index"})
        return np.array(integrator.render(scene, sensor=sensor_of(spec.cameras[0], 1), spp=1))


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> int:
    mitsuba()
    spec = scattered_scene(INSTANCES, size_m=300.0, exemplars=10, leaves=25_000, size_px=SIZE_PX)
    triangles = sum(exemplar.triangles for exemplar in spec.exemplars)
    print(f"{INSTANCES:,} instances of {len(spec.exemplars)} exemplars, {triangles:,} triangles before instancing")
    scene_s, identity_s = [], []
    for number in range(ROUNDS):
        scene_s.append(seconds(lambda: build_scene(spec)))
        identity_s.append(seconds(lambda: identity(spec)))
        if number == 0:
            print(f"first, cold: scene {scene_s[0]:.2f} s, identity {identity_s[0]:.2f} s")
    print(f"scene build:    {median(scene_s):6.2f} s (bound {SCENE_BOUND_S} s, worst {max(scene_s):.2f} s)")
    print(f"identity pass:  {median(identity_s):6.2f} s (bound {IDENTITY_BOUND_S} s, worst {max(identity_s):.2f} s)")
    print(f"peak memory:    {peak_gb():6.2f} GB")

    few = scattered_scene(COMPARED, size_m=100.0, exemplars=10, leaves=400, size_px=SIZE_PX)
    ours, by_aov, by_twin = [], [], []
    for _ in range(ROUNDS):
        ours.append(seconds(lambda: identity(few)))
        by_aov.append(seconds(lambda: aov(few)))
        by_twin.append(seconds(lambda: trace_twin(few, few.cameras[0], 1)))
    one = median(ours)
    print(f"{COMPARED:,} instances, identity pass with set-up: ours {one:.2f} s,")
    print(f"  Mitsuba's aov integrator {median(by_aov):6.2f} s, ratio {median(by_aov) / one:5.1f}")
    print(f"  expanded into meshes     {median(by_twin):6.2f} s, ratio {median(by_twin) / one:5.1f}")
    return int(max(scene_s) >= SCENE_BOUND_S or max(identity_s) >= IDENTITY_BOUND_S)


if __name__ == "__main__":
    sys.exit(main())
