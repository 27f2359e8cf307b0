"""The light of an image, path by path, over the same flat tables as the identity pass.

All paths of a block of pixels go one scattering further together, as arrays of Dr.Jit, and those that ended are
dropped. A kernel knows no instance and no material: what a hit means is looked up (`render/identity/tracer.py`,
`scattering.py`), so one kernel serves any scene. It runs on LLVM; on CUDA it has not been tried. ADR 0013 has the
measurements.

Light of the sun is sampled at each scattering, and that of a sky with clouds; all skies are met where a path leaves the
scene. From the second scattering on, paths end by chance, the sooner the less light they carry: not in fog, which
absorbs nothing, and whose scatterings do not count to the most that a path may have. Each path has its own
places in the sums, so the image does not depend on the number of threads.

Random numbers are points that fill the unit square evenly, for each pixel and each choice of a path its own: Sobol's
first two dimensions, scrambled by hashes as Owen scrambles (Burley 2020, "Practical hash-based Owen scrambling"). Any
first N points are spread evenly, best where N is a power of two. A point is a function of seed, pixel, number and
choice: it does not depend on other points, nor on where work is cut.

Work is O(pixels x samples x scatterings x log triangles). Memory: some 250 bytes a path of a block of pixels, of
`_PATHS_AT_ONCE` paths, and 40 bytes a pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.cloud_shadow import ShadowPlane
from forestgen.render.identity import SceneTracer
from forestgen.render.identity.surface import LIFT
from forestgen.render.identity.tracer import pixel_rays
from forestgen.render.light import has_sun, moon_phase, sun_irradiance, sun_radiance
from forestgen.render.paths.fog import FAR_M, Fog, Place
from forestgen.render.paths.scattering import Local, Surfaces, has_water
from forestgen.render.paths.sun import Sun
from forestgen.render.paths.water import Shore, is_water, out_of_water, refracted_down
from forestgen.render.variant import ROULETTE_DEPTH, dr, mi, renderer_errors, using
from forestgen.scene.colour import Channels
from forestgen.scene.projection import DeviceRays
from forestgen.scene.spec import Camera

_GOLDEN = 0x9E3779B9  # 2^32 over the golden ratio: steps that never meet
_SQUARES = ((16, 0xFFFFFFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555))
Floats = NDArray[np.float64]
_PATHS_AT_ONCE = 1_500_000
_MOST_LIKELY = 0.95  # a path to go on, once chance may end it
_FOG_CHOICE = 1 << 16  # the first of the pairs that fog takes
_TIME_CHOICE = _FOG_CHOICE - 1  # the pair of which a ray's time in the exposure is one
_BELOW_GROUND_M = 100.0  # below all terrain, where fog ends
_MOST_IN_FOG = 4096  # scatterings of a path, those at surfaces too
_CHOICES = 4  # pairs of numbers for a scattering: sun, which lobe and whether to go on, onwards, sky
Array = NDArray[np.float32]


@dataclass(frozen=True)
class Sequence:
    """Points of P paths."""

    key: Any  # UInt32, of the pixel
    number: Any  # UInt32, of the path in its pixel

    def pair(self, choice: Any) -> tuple[Any, Any]:
        """(P,) each in [0, 1): the point of one choice, a UInt32."""
        seeds = [hashed(self.key + mi.UInt32(choice) * _GOLDEN + (k * 0x85EBCA6B & 0xFFFFFFFF)) for k in range(3)]
        first = second = _scrambled(dr.brev(self.number), seeds[0])  # the shuffled number's bits, reversed
        for shift, mask in _SQUARES:  # Sobol's second number: Pascal's triangle modulo 2
            second = second ^ ((second & mi.UInt32(mask)) << shift)
        one, other = (
            mi.Float(dr.brev(_scrambled(dr.brev(bits), seed)) >> 8) * 2.0**-24
            for bits, seed in zip((first, second), seeds[1:], strict=True)
        )
        return one, other


def sequence_of(seed: Any, pixel: Any, number: Any) -> Sequence:
    """Points of paths by their pixels and their numbers there, all UInt32."""
    return Sequence(mi.sample_tea_32(seed, pixel, 4)[0], number)


def hashed(value: Any) -> Any:
    """UInt32, well mixed (Wang and Mueller's integer finaliser)."""
    value = (value ^ (value >> 16)) * 0x7FEB352D
    value = (value ^ (value >> 15)) * 0x846CA68B
    return value ^ (value >> 16)


def _scrambled(reversed_bits: Any, seed: Any) -> Any:
    """Each bit flipped by a hash of those after it (Laine and Karras; constants of Burley's paper)."""
    value = reversed_bits + seed
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        value = value ^ (value * factor)
    return value


class Sky:
    """The sky's radiance by direction, on the device; see `skies.model.map_directions`.

    If it is `sampled`, paths look for its light at every scattering, where it is bright; else they find it by chance,
    which costs less and is as good where a sky is nearly even.
    """

    def __init__(self, radiance: NDArray[np.float32], *, sampled: bool = False) -> None:
        self.sampled = sampled
        self._rows, self._columns = (dr.opaque(mi.UInt32, size) for size in radiance.shape[:2])
        self._texel = mi.Float(np.ascontiguousarray(radiance).ravel())
        if sampled:
            share, density = sky_shares(radiance)
            self._shares = mi.DiscreteDistribution2D(share.astype(np.float32))
            self._density = mi.Float(density.astype(np.float32).ravel())

    def sample(self, first: Any, second: Any) -> tuple[Any, Any]:
        """Unit directions, and Float, their density over the sphere."""
        cell, _, within = self._shares.sample(mi.Point2f(first, second))
        low, high = (dr.clip(mi.Float(cell.y) + side, 0.0, mi.Float(self._rows) - 1.0) for side in (-0.5, 0.5))
        zenith = (low + within.y * (high - low)) * (np.pi / (mi.Float(self._rows) - 1.0))
        turn = (mi.Float(cell.x) + within.x) * (2 * np.pi / mi.Float(self._columns))
        (up, level), (north, east) = dr.sincos(zenith)[::-1], dr.sincos(turn)
        density = dr.gather(mi.Float, self._density, cell.y * self._columns + cell.x)
        return mi.Vector3f(level * east, level * north, up), density / dr.maximum(level, 1e-6)

    def density(self, direction: Any) -> Any:
        """Float: density over the sphere with which `sample` chooses directions."""
        level = dr.sqrt(direction.x**2 + direction.y**2)
        turn = dr.atan2(direction.y, direction.x) * (0.5 / np.pi)
        column = dr.minimum(mi.UInt32((turn - dr.floor(turn)) * mi.Float(self._columns)), self._columns - 1)
        row = mi.UInt32(dr.atan2(level, direction.z) * ((mi.Float(self._rows) - 1.0) / np.pi) + 0.5)
        row = dr.minimum(row, self._rows - 1)
        return dr.gather(mi.Float, self._density, row * self._columns + column) / dr.maximum(level, 1e-6)

    def towards(self, direction: Any, active: Any) -> Any:
        """Color3f, bilinear between the map's places; the first and the last row are the zenith and the nadir."""
        rows, columns = mi.Float(self._rows), mi.Float(self._columns)
        x = dr.atan2(direction.y, direction.x) * (0.5 / np.pi) * columns - 0.5
        y = dr.atan2(dr.sqrt(direction.x**2 + direction.y**2), direction.z) * (1.0 / np.pi) * (rows - 1.0)
        top = dr.clip(dr.floor(y), 0.0, rows - 2.0)
        left = dr.floor(x)
        first = dr.select(left < 0.0, left + columns, left)
        second = dr.select(first + 1.0 >= columns, 0.0, first + 1.0)
        row = mi.UInt32(top) * self._columns
        upper, lower = (
            self._at(base + mi.UInt32(first), active) * (1.0 - (x - left))
            + self._at(base + mi.UInt32(second), active) * (x - left)
            for base in (row, row + self._columns)
        )
        return upper * (1.0 - (y - top)) + lower * (y - top)

    def _at(self, texel: Any, active: Any) -> Any:
        return dr.gather(mi.Color3f, self._texel, texel, active)


def sky_shares(radiance: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """(rows, columns) shares of light samples, and their density over angles of zenith and turn.

    A cell counts as much as the brightest of the places around it, since radiance goes in straight lines between them.
    """
    rows, columns = radiance.shape[:2]
    bright = radiance.mean(axis=2, dtype=np.float64)
    around = np.pad(np.pad(bright, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    most = np.max([around[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)
    edges = np.clip(np.arange(rows + 1) - 0.5, 0, rows - 1) * (np.pi / (rows - 1))
    share = most * (np.cos(edges[:-1]) - np.cos(edges[1:]))[:, None]
    share /= max(float(share.sum()), 1e-30)
    return share, share / (np.diff(edges)[:, None] * (2 * np.pi / columns))


@dataclass(frozen=True)
class Image:
    """What came back to the camera."""

    by_sky: Array  # (H, W, 3) of the sky, off the scene
    by_sun: Array  # (H, W, 3) of the sun, off the scene
    beyond: Array  # (H, W, 3) of sky and sun, straight
    open: Array  # (H, W) share of each pixel that sees past the scene


@dataclass(frozen=True)
class Paths:
    """Paths on their way, as device arrays. In fog a path may scatter before its hit, or without one."""

    index: Any  # UInt32, where each began
    start: Any  # Point3f
    direction: Any  # Vector3f
    carried: Any  # Color3f
    hit: Any  # PreliminaryIntersection3f
    flight_m: Any | None = None  # Float, to where the path scatters in fog; None: there is no fog
    asymmetry: Any | None = None  # Float, of the fog there
    surfaces: Any | None = None  # UInt32, scatterings at surfaces so far; None: there is no fog
    water: Any | None = None  # UInt32, organ of the surface of the water that it is in, 0 in air; None: there is none
    matt: Any | None = None  # Bool, whether it met anything but water; None: there is none

    def kept(self, rows: Any) -> Paths:
        return Paths(*(None if one is None else dr.gather(type(one), one, rows) for one in vars(self).values()))


class PathTracer:
    """Paths of one camera through a scene under a sky that is infinitely far away, in any channels.

    `radiance` is the sky in channels, as `light.sky_map` has it; `shadow` is what clouds let through of the sun's
    light, None: all.
    """

    def __init__(
        self,
        tracer: SceneTracer,
        camera: Camera,
        max_depth: int,
        radiance: Callable[[Channels], NDArray[np.float32]],
        shadow: ShadowPlane | None = None,
    ) -> None:
        self._tracer, self._camera, self._max_depth = tracer, camera, max_depth
        self._radiance, self._shadow = radiance, shadow
        self._shown: Channels | None = None
        self._sun: Sun | None = None
        with using(tracer.variant):
            self._surfaces = Surfaces(tracer)
            self._has_water = has_water(tracer.spec)
            self._fog = Fog(tracer.spec.fog, tracer.origin_m) if tracer.spec.fog else None
            lowest_m = float(tracer.spec.terrain.mesh.vertices_m[:, 2].min()) - float(tracer.origin_m[2])
            self._deepest = dr.opaque(mi.Float, lowest_m - _BELOW_GROUND_M)

    def show(self, channels: Channels) -> None:
        """Have the surfaces and lights of these channels."""
        if channels == self._shown:
            return
        spec = self._tracer.spec
        with using(self._tracer.variant):
            self._surfaces.show(channels)
            self._sky = Sky(self._radiance(channels), sampled=spec.clouds is not None)
            if has_sun(spec.sky):
                light, disc = sun_irradiance(spec.sky, channels), sun_radiance(spec.sky, channels)
                self._sun = Sun(
                    spec.sky.to_light, light, disc, self._shadow, self._tracer.origin_m, moon_phase(spec.sky)
                )
        self._shown = channels

    def take(self, samples: int, seed: int) -> Image:
        """An image of so many samples a pixel in the channels that are shown, by independent paths for each seed."""
        width, height = self._camera.size_px
        pixels, at_once = width * height, max(1, _PATHS_AT_ONCE // samples)
        found = np.zeros((pixels, 10), dtype=np.float32)
        with using(self._tracer.variant), renderer_errors():
            for first in range(0, pixels, at_once):
                count = min(at_once, pixels - first)
                found[first : first + count] = self._block(samples, seed, first, count)
            dr.flush_malloc_cache()
        image = found.reshape(height, width, 10)
        return Image(image[..., :3], image[..., 3:6], image[..., 6:9], image[..., 9])

    def _block(self, samples: int, seed: int, first: int, count: int) -> Array:
        """(count, 10) of the pixels from `first` on, row by row: what `Image` holds, one after another."""
        size = count * samples
        each, base = dr.opaque(mi.UInt32, samples), dr.opaque(mi.UInt32, first)
        key = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)

        def sequence(index: Any) -> Sequence:
            pixel = index // each
            return sequence_of(key, base + pixel, index - pixel * each)

        index = dr.arange(mi.UInt32, size)
        rays, hit, active = self._first(sequence(index), base + index // each, index - index // each * each, key)
        start = self._tracer.start_of(self._camera, rays) + mi.Vector3f(0.0)
        flight, met = self._flight(sequence(index), 0, start, rays.direction, hit)
        found = (hit.is_valid() | met) & active
        past = active & ~found
        beyond = dr.select(past, self._sky.towards(rays.direction, past), 0.0)
        if self._sun is not None:
            beyond += dr.select(past, self._sun.seen(rays.direction), 0.0)
        begun = Paths(index, start, rays.direction, mi.Color3f(1.0) + dr.zeros(mi.Color3f, size), hit, *flight)
        if self._fog is not None:
            begun = replace(begun, surfaces=dr.zeros(mi.UInt32, size))
        if self._has_water:
            begun = replace(begun, water=dr.zeros(mi.UInt32, size), matt=dr.zeros(mi.Bool, size))
        by_sky, by_sun = (dr.zeros(mi.Color3f, size) for _ in range(2))
        dr.eval(*vars(begun).values(), found, past, beyond, by_sky, by_sun)
        paths = begun.kept(dr.compress(found if self._max_depth > 1 else found & met))
        del begun, rays, hit, start
        for depth in range(1, self._max_depth if self._fog is None else _MOST_IN_FOG):
            if not dr.width(paths.index):
                break
            goes_on, paths, own_sky, own_sun = self._round(paths, sequence(paths.index), depth)
            for total, own in ((by_sky, own_sky), (by_sun, own_sun)):
                dr.scatter(total, dr.gather(mi.Color3f, total, paths.index) + own, paths.index)
            dr.eval(*vars(paths).values(), goes_on, by_sky, by_sun)
            paths = paths.kept(dr.compress(goes_on))
        sums = [*by_sky, *by_sun, *beyond, dr.select(past, mi.Float(1.0), 0.0)]
        means = [dr.block_sum(one, samples) / samples for one in sums]
        dr.eval(means)
        return np.stack([np.array(one) for one in means], axis=-1)

    def _first(self, sequence: Sequence, pixel: Any, number: Any, key: Any) -> tuple[DeviceRays, Any, Any]:
        width = dr.opaque(mi.UInt32, self._camera.size_px[0])
        row = pixel // width
        right, down = sequence.pair(mi.UInt32(0))
        time = None if self._camera.motion is None else sequence.pair(mi.UInt32(_TIME_CHOICE))[0]
        # Replicates go on along the lens' points from places of their own.
        rays = pixel_rays(self._camera, pixel - row * width, row, right, down, number + (key >> 8), time)
        active = mi.Bool(True) if rays.valid is None else rays.valid
        ray = mi.Ray3f(self._tracer.start_of(self._camera, rays), rays.direction)
        return rays, self._tracer.scene.ray_intersect_preliminary(ray, coherent=True, active=active), active

    def _flight(self, sequence: Sequence, depth: int, start: Any, direction: Any, hit: Any) -> tuple[list[Any], Any]:
        """Where rays scatter in fog, as `Paths` holds it, and whether they do so before their hit."""
        if self._fog is None:
            return [None, None], mi.Bool(False)
        choice = dr.opaque(mi.UInt32, _FOG_CHOICE + depth * self._fog.pairs)
        numbers = [one for k in range(self._fog.pairs) for one in sequence.pair(choice + k)]
        flight = self._fog.flights(start, direction, numbers)
        met = flight.distance_m < dr.select(hit.is_valid(), hit.t, FAR_M)
        # What goes down beyond the terrain's edge never comes back.
        met &= start.z + direction.z * flight.distance_m > self._deepest
        return [dr.select(met, flight.distance_m, FAR_M), flight.asymmetry], met

    def _round(self, paths: Paths, sequence: Sequence, depth: int) -> tuple[Any, Paths, Any, Any]:
        """Whether each path goes on, the paths one scattering later, and what they brought of sky and sun."""
        sky, sun = self._sky, self._sun
        paths, surface, shore, in_fog, distance_m = self._met(paths)
        point = paths.start + paths.direction * distance_m
        # A hit is as uncertain as the largest number that its place was made of.
        lift = LIFT * dr.maximum(dr.maximum(dr.max(dr.abs(point)), distance_m), 1.0)
        choice = dr.opaque(mi.UInt32, 1 + (depth - 1) * _CHOICES)

        def leaving(direction: Any) -> Any:
            up = dr.select(dr.dot(surface.geometric, direction) < 0, -surface.geometric, surface.geometric)
            return mi.Ray3f(point + up * lift, direction)

        by_sun = mi.Color3f(0.0)
        if sun is not None:
            to_sun = sun.sample(*sequence.pair(choice))
            by_sun = self._by_sun(paths, surface, point, to_sun, leaving)
        lobe, luck = sequence.pair(choice + 1)
        direction, weight = surface.sample(lobe, *sequence.pair(choice + 2))
        carried = paths.carried * weight
        strength = dr.max(carried)
        by_chance = dr.opaque(mi.Bool, depth >= ROULETTE_DEPTH)
        likely = dr.select(by_chance, dr.minimum(strength, dr.select(in_fog, 1.0, mi.Float(_MOST_LIKELY))), 1.0)
        goes_on = (strength > 0) & (luck < likely)
        carried *= dr.rcp(dr.maximum(likely, 1e-9))
        ray = leaving(direction)
        hit = self._tracer.scene.ray_intersect_preliminary(ray, coherent=False, active=goes_on)
        flight, met = self._flight(sequence, depth, ray.o, direction, hit)
        if shore is not None:  # there is no fog in water
            met &= shore.after(in_fog)["water"] == 0
            flight = [None if one is None else dr.select(met, one, FAR_M) for one in flight]
        away = goes_on & ~hit.is_valid() & ~met
        found = carried * sky.towards(direction, away)
        by_sky = mi.Color3f(0.0)
        if sky.sampled:
            # Both ways to the sky count by their densities (Veach 1997, the balance heuristic).
            chosen, density = sky.sample(*sequence.pair(choice + 3))
            light = paths.carried * surface.value(chosen) * sky.towards(chosen, mi.Bool(True))
            light *= dr.rcp(density + surface.density(chosen)) * self._through(point, chosen)
            wanted = (density > 0) & (dr.max(light) > 0)
            lit = wanted & ~self._tracer.scene.ray_test(leaving(chosen), coherent=False, active=wanted)
            by_sky = dr.select(lit, light, 0.0)
            own = surface.density(direction)
            found *= own * dr.rcp(dr.maximum(own + sky.density(direction), 1e-30))
        by_sky += dr.select(away, found, 0.0)
        later = Paths(paths.index, ray.o, direction, carried, hit, *flight)
        if shore is not None:
            later = replace(later, **shore.after(in_fog))
        may_scatter = hit.is_valid()
        if paths.surfaces is not None:
            count = paths.surfaces + dr.select(in_fog, mi.UInt32(0), 1)
            later = replace(later, surfaces=count)
            may_scatter &= count + 1 < dr.opaque(mi.UInt32, self._max_depth)
        return goes_on & (may_scatter | met), later, by_sky, by_sun

    def _met(self, paths: Paths) -> tuple[Paths, Local | Place | Shore, Shore | None, Any, Any]:
        """The paths as they arrive, where they scatter, the same as a shore, whether in fog, and how far they came."""
        hits = self._tracer.looked_up(DeviceRays(paths.direction, mi.Float(1.0)), paths.hit, mi.Bool(True))
        local, shore = self._surfaces.at(hits), None
        distance_m, in_fog = hits.distance_m, mi.Bool(False)
        if paths.water is not None:
            on_water = is_water(self._tracer, hits.organ, hits.valid)
            shore = Shore(local, on_water, hits.organ, paths.water, paths.matt)
            way_m = dr.select(hits.valid, distance_m, 0.0)
            kept = dr.exp(-self._surfaces.absorption(paths.water) * way_m)
            paths = replace(paths, carried=paths.carried * kept)
        surface: Local | Place | Shore = shore or local
        if paths.flight_m is not None:
            in_fog = paths.flight_m < FAR_M
            surface = Place(shore or local, in_fog, paths.direction, paths.asymmetry)
            distance_m = dr.select(in_fog, paths.flight_m, distance_m)
        return paths, surface, shore, in_fog, distance_m

    def _by_sun(
        self, paths: Paths, surface: Local | Place | Shore, point: Any, to_sun: Any, leaving: Callable[[Any], Any]
    ) -> Any:
        """Color3f: the sun's own light that paths bring from where they are."""
        assert self._sun is not None
        scene, inward, wet = self._tracer.scene, to_sun, mi.Bool(False)
        if paths.water is not None:
            wet = paths.water != 0
            inward = dr.select(wet, refracted_down(to_sun), to_sun)
        light = paths.carried * surface.value(inward) * self._sun.share(point, to_sun, mi.Bool(True))
        light *= self._sun.irradiance
        light *= self._through(point, to_sun)
        wanted, ray = dr.max(light) > 0, leaving(inward)
        if paths.water is not None:
            out, place, share = out_of_water(self._tracer, self._surfaces, ray, to_sun, paths.water, wanted & wet)
            light *= dr.select(wet, share, 1.0)
            wanted &= ~wet | out
            above = mi.Point3f(place.x, place.y, place.z + LIFT * dr.maximum(dr.max(dr.abs(place)), 1.0))
            ray = mi.Ray3f(dr.select(wet, above, ray.o), to_sun)
        lit = wanted & ~scene.ray_test(ray, coherent=False, active=wanted)
        return dr.select(lit, light, 0.0)

    def _through(self, point: Any, direction: Any) -> Any:
        """Share of the light of the sky, or the sun, that fog lets through to points."""
        return 1.0 if self._fog is None else self._fog.through(point, direction)
