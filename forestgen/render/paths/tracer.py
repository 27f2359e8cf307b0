"""The light of an image, path by path, in rounds: every round takes all paths that still go on one scattering further.

Light of the sun is sampled at each scattering, and that of a sky with clouds; all skies are met where a path leaves the
scene. From the second
scattering on, paths end by chance, the sooner the less light they carry. Each path has its own places in the sums, so
the image does not depend on the number of threads.

Work is O(pixels x samples x scatterings x log triangles). Memory: some 250 bytes a path of a block of pixels, of
`_PATHS_AT_ONCE` paths, and 40 bytes a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.identity import SceneTracer
from forestgen.render.identity.surface import LIFT
from forestgen.render.identity.tracer import pixel_rays
from forestgen.render.paths.light import Sky, Sun
from forestgen.render.paths.scattering import Surfaces
from forestgen.render.paths.sequence import Sequence, sequence_of
from forestgen.render.settings import ROULETTE_DEPTH
from forestgen.render.tracing import renderer_errors
from forestgen.render.variant import drjit, mitsuba
from forestgen.scene.projection import DeviceRays
from forestgen.scene.spec import Camera

_PATHS_AT_ONCE = 1_500_000
_MOST_LIKELY = 0.95  # a path to go on, once chance may end it
_CHOICES = 4  # pairs of numbers for a scattering: sun, which lobe and whether to go on, onwards, sky
Array = NDArray[np.float32]


@dataclass(frozen=True)
class Image:
    """What came back to the camera."""

    by_sky: Array  # (H, W, 3) of the sky, off the scene
    by_sun: Array  # (H, W, 3) of the sun, off the scene
    beyond: Array  # (H, W, 3) of sky and sun, straight
    open: Array  # (H, W) share of each pixel that sees past the scene


@dataclass(frozen=True)
class Paths:
    """Paths on their way, as device arrays."""

    index: Any  # UInt32, where each began
    start: Any  # Point3f
    direction: Any  # Vector3f
    carried: Any  # Color3f
    hit: Any  # PreliminaryIntersection3f

    def kept(self, rows: Any) -> Paths:
        dr = drjit()
        return Paths(*(dr.gather(type(one), one, rows) for one in vars(self).values()))


class PathTracer:
    """Paths of one camera through a scene. Enter the tracer's variant first."""

    def __init__(self, tracer: SceneTracer, camera: Camera, surfaces: Surfaces, max_depth: int) -> None:
        self._tracer, self._camera, self._surfaces, self._max_depth = tracer, camera, surfaces, max_depth

    def take(self, sky: Sky, sun: Sun | None, samples: int, seed: int) -> Image:
        """An image of so many samples a pixel."""
        width, height = self._camera.size_px
        pixels, at_once = width * height, max(1, _PATHS_AT_ONCE // samples)
        found = np.zeros((pixels, 10), dtype=np.float32)
        with renderer_errors():
            for first in range(0, pixels, at_once):
                count = min(at_once, pixels - first)
                found[first : first + count] = self._block(sky, sun, samples, seed, first, count)
            drjit().flush_malloc_cache()
        image = found.reshape(height, width, 10)
        return Image(image[..., :3], image[..., 3:6], image[..., 6:9], image[..., 9])

    def _block(self, sky: Sky, sun: Sun | None, samples: int, seed: int, first: int, count: int) -> Array:
        """(count, 10) of the pixels from `first` on, row by row: what `Image` holds, one after another."""
        mi, dr = mitsuba(), drjit()
        size = count * samples
        each, base = dr.opaque(mi.UInt32, samples), dr.opaque(mi.UInt32, first)
        key = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)

        def sequence(index: Any) -> Sequence:
            pixel = index // each
            return sequence_of(key, base + pixel, index - pixel * each)

        index = dr.arange(mi.UInt32, size)
        rays, hit, active = self._first(sequence(index), base + index // each, index - index // each * each, key)
        found = hit.is_valid() & active
        past = active & ~hit.is_valid()
        beyond = dr.select(past, sky.towards(rays.direction, past), 0.0)
        if sun is not None:
            beyond += dr.select(past, sun.seen(rays.direction), 0.0)
        start = self._tracer.start_of(self._camera, rays) + mi.Vector3f(0.0)
        begun = Paths(index, start, rays.direction, mi.Color3f(1.0) + dr.zeros(mi.Color3f, size), hit)
        by_sky, by_sun = (dr.zeros(mi.Color3f, size) for _ in range(2))
        dr.eval(begun.start, begun.direction, begun.carried, hit, found, past, beyond, by_sky, by_sun)
        paths = begun.kept(dr.compress(found))
        del begun, rays, hit, start
        for depth in range(1, self._max_depth):
            if not dr.width(paths.index):
                break
            goes_on, paths, own_sky, own_sun = self._round(paths, sequence(paths.index), sky, sun, depth)
            for total, own in ((by_sky, own_sky), (by_sun, own_sun)):
                dr.scatter(total, dr.gather(mi.Color3f, total, paths.index) + own, paths.index)
            dr.eval(paths.start, paths.direction, paths.carried, paths.hit, goes_on, by_sky, by_sun)
            paths = paths.kept(dr.compress(goes_on))
        sums = [*by_sky, *by_sun, *beyond, dr.select(past, mi.Float(1.0), 0.0)]
        means = [dr.block_sum(one, samples) / samples for one in sums]
        dr.eval(means)
        return np.stack([np.array(one) for one in means], axis=-1)

    def _first(self, sequence: Sequence, pixel: Any, number: Any, key: Any) -> tuple[DeviceRays, Any, Any]:
        mi, dr = mitsuba(), drjit()
        width = dr.opaque(mi.UInt32, self._camera.size_px[0])
        row = pixel // width
        right, down = sequence.pair(mi.UInt32(0))
        # Replicates go on along the lens' points from places of their own.
        rays = pixel_rays(self._camera, pixel - row * width, row, right, down, number + (key >> 8))
        active = mi.Bool(True) if rays.valid is None else rays.valid
        ray = mi.Ray3f(self._tracer.start_of(self._camera, rays), rays.direction)
        return rays, self._tracer.scene.ray_intersect_preliminary(ray, coherent=True, active=active), active

    def _round(
        self, paths: Paths, sequence: Sequence, sky: Sky, sun: Sun | None, depth: int
    ) -> tuple[Any, Paths, Any, Any]:
        """Whether each path goes on, the paths one scattering later, and what they brought of sky and sun."""
        mi, dr = mitsuba(), drjit()
        rays = DeviceRays(paths.direction, mi.Float(1.0), None, None)
        hits = self._tracer.looked_up(rays, paths.hit, mi.Bool(True))
        point = paths.start + paths.direction * hits.distance_m
        surface = self._surfaces.at(hits)
        # A hit is as uncertain as the largest number that its place was made of.
        lift = LIFT * dr.maximum(dr.maximum(dr.max(dr.abs(point)), hits.distance_m), 1.0)
        choice = dr.opaque(mi.UInt32, 1 + (depth - 1) * _CHOICES)

        def leaving(direction: Any) -> Any:
            up = dr.select(dr.dot(surface.geometric, direction) < 0, -surface.geometric, surface.geometric)
            return mi.Ray3f(point + up * lift, direction)

        by_sun = mi.Color3f(0.0)
        if sun is not None:
            to_sun = sun.sample(*sequence.pair(choice))
            light = paths.carried * surface.value(to_sun) * sun.share(point, to_sun, mi.Bool(True)) * sun.irradiance
            wanted = dr.max(light) > 0
            lit = wanted & ~self._tracer.scene.ray_test(leaving(to_sun), coherent=False, active=wanted)
            by_sun = dr.select(lit, light, 0.0)
        lobe, luck = sequence.pair(choice + 1)
        direction, weight = surface.sample(lobe, *sequence.pair(choice + 2))
        carried = paths.carried * weight
        strength = dr.max(carried)
        by_chance = dr.opaque(mi.Bool, depth >= ROULETTE_DEPTH)
        likely = dr.select(by_chance, dr.minimum(strength, _MOST_LIKELY), 1.0)
        goes_on = (strength > 0) & (luck < likely)
        carried *= dr.rcp(dr.maximum(likely, 1e-9))
        ray = leaving(direction)
        hit = self._tracer.scene.ray_intersect_preliminary(ray, coherent=False, active=goes_on)
        away = goes_on & ~hit.is_valid()
        found = carried * sky.towards(direction, away)
        by_sky = mi.Color3f(0.0)
        if sky.sampled:
            # Both ways to the sky count by their densities (Veach 1997, the balance heuristic).
            chosen, density = sky.sample(*sequence.pair(choice + 3))
            light = paths.carried * surface.value(chosen) * sky.towards(chosen, mi.Bool(True))
            light *= dr.rcp(density + surface.density(chosen))
            wanted = (density > 0) & (dr.max(light) > 0)
            lit = wanted & ~self._tracer.scene.ray_test(leaving(chosen), coherent=False, active=wanted)
            by_sky = dr.select(lit, light, 0.0)
            own = surface.density(direction)
            found *= own * dr.rcp(dr.maximum(own + sky.density(direction), 1e-30))
        by_sky += dr.select(away, found, 0.0)
        later = Paths(paths.index, ray.o, direction, carried, hit)
        return goes_on & hit.is_valid(), later, by_sky, by_sun
