"""What stands above points of the site: rays straight down, through all surfaces that they meet."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity.surface import LIFT
from forestgen.render.identity.tracer import SceneTracer
from forestgen.render.variant import dr, mi, on_device, using
from forestgen.scene.projection import DeviceRays

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


def plants_below(tracer: SceneTracer, start_m: Floats, length_m: Floats) -> Iterator[tuple[Rows, Rows]]:
    """Rays straight down and the plants that they meet: a pair of arrays (K,) for the first surfaces, the second ...

    The ground ends a ray. Whoever is met twice, with two leaves, is reported twice.

    Parameters
    ----------
    start_m : (R, 3) world.
    length_m : (R,) of the rays.

    Yields
    ------
    (K,) rows of rays, and (K,) rows of the instances that they meet.
    """
    place, left_m, ray = start_m - tracer.origin_m, length_m.copy(), np.arange(len(start_m))
    step_m = LIFT * max(1.0, float(np.abs(place).max(initial=0.0)))  # beyond the surface that was met
    with using(tracer.variant):
        down = DeviceRays(mi.Vector3f(0.0, 0.0, -1.0), mi.Float(1.0), None, None)
        while len(ray):
            rays = mi.Ray3f(mi.Point3f(*(on_device(mi.Float, axis) for axis in place.T)), down.direction)
            rays.maxt = on_device(mi.Float, left_m)
            found = tracer.scene.ray_intersect_preliminary(rays, coherent=True, active=True)
            hits = tracer.looked_up(down, found, mi.Bool(True))
            dr.eval(hits.instance, hits.distance_m)
            row = np.array(hits.instance).astype(np.int64) - 1  # -1: nothing, or the ground
            met = row >= 0
            yield ray[met], row[met]
            place, left_m, ray = place[met], left_m[met], ray[met]
            gone_m = np.array(hits.distance_m, dtype=np.float64)[met] + step_m
            place[:, 2] -= gone_m
            left_m = left_m - gone_m
            on = left_m > 0.0
            place, left_m, ray = place[on], left_m[on], ray[on]
        dr.flush_malloc_cache()
