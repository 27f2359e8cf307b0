"""Light of a cloudy sky on a scene far below it.

Clouds are traced alone (render/cloud_paths.py), over a plain of the region's albedo, once for each sky: into a map of
the radiance by direction at one place of the site, at the height of the canopy, which lights the scene from infinitely
far away. It holds the sky and what clouds scatter of it and of the sun; the sun's disc shines through the shadow plane
of render/cloud_shadow.py.

Decisions
---------
- Land a kilometre off, which an aerial view shows, is under other clouds. So the light of the map on what a pixel shows
  is multiplied by the ratio of the level irradiances there and at the map's place (`Overland`). Against `exact` on the
  forest under cumulus (benchmarks/cloud_views.py): 0.0 +- 0.7% over views from the ground, over the crowns and from 180
  m up, each within 2.3% with noise of 0.9 to 2.1%. Without the ratio the irradiance is 13 to 20% off in the mean over
  the whole field, with it 1 to 2%, and 5% RMS from place to place. An emissive plane at the clouds' base would need no
  ratio, but has no directions and ends with the field.
- The map has 1.4 degrees a row and column, and is not denoised: what it lights averages over hundreds of its pixels.
- Clouds are grey. So the sun's light comes through alike at all wavelengths, and the sky's differs only by how it
  spreads over the sky: the share by direction is baked at six wavelengths, with straight lines between. The plain has
  the colour of the terrain, mostly that of the distance; a baked sky holds the light by the number of its reflections.
- The nodes are noisy, by 4% in two bakes, and near the map's place that noise lies on every pixel alike, where the
  ratio is known to be 1. So what the middle node misses is added to the nodes around it too, in proportion to the
  correlation of their noise after smoothing. The measurements above are from before that.
- Baked skies are kept in memory by a hash of their content: all cameras of a scene, and later images under the same
  sky, share one. The random numbers are the same for all skies: the hash is of floats, whose last digits differ from
  machine to machine and with the threads of linear algebra.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.source import LEAST_GAP_M
from forestgen.atmosphere.grid import PhaseFunction
from forestgen.core.cache import BoundedCache
from forestgen.core.randomness import child_rng, child_seed
from forestgen.render.cloud_paths import ORDERS, CloudField, CloudLight, Gathered, field_of, gather
from forestgen.render.cloud_shadow import content_key, height_of
from forestgen.render.light import SUN_RADIUS_DEG, envmap, sky_map, sun_irradiance
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import SceneSpec, Sky, Terrain
from forestgen.scene.surfaces import film_factor

Floats = NDArray[np.float64]
_BAKED_NM = (360.0, 430.0, 500.0, 570.0, 640.0, 720.0)
_PATHS = 48  # of a pixel of the map at the horizon; with the sine of the zenith angle fewer
_LEAST_PATHS = 4
_NODES, _NODE_PATHS = 33, 512  # along a side of the irradiance's map, and paths of each
_NEAREST_NODE = 0.15  # distance of the nodes around the middle, in heights of the clouds' base
_BLUR_NODES = 1.4  # standard deviation
_HATS = np.eye(len(_BAKED_NM))
_SKIES = 3 + len(_BAKED_NM)  # parts of baked light that are the sky's
_KEPT_BYTES = 100_000_000


def phase_function(phase: PhaseFunction) -> dict[str, Any]:
    """Of a medium."""
    forward = {"type": "hg", "g": phase.forward}
    if phase.forward_share >= 1.0:
        return forward
    return {
        "type": "blendphase",
        "weight": 1.0 - phase.forward_share,  # of the second
        "first": forward,
        "second": {"type": "hg", "g": phase.backward},
    }


@dataclass(frozen=True, eq=False)
class TracedClouds:
    """A scene's clouds and plain, ready to be traced."""

    field: CloudField
    sky: Sky
    terrain: Terrain
    far_share: float  # of the plain that has the colour of the distance
    ground_m: float  # world height of the plain
    key: str  # hash of all that a baked sky depends on
    aloft_m: tuple[float, ...] = (0.0,)  # mean height of each layer of clouds over the plain

    def sun_aloft(self, channels: Channels) -> Floats:
        """(L, 3) irradiance of the sun that each layer of clouds scatters."""
        return np.stack([sun_irradiance(self.sky, channels, one) for one in self.aloft_m])

    @cached_property
    def _near_colour(self) -> tuple[float, float, float]:
        """Of the terrain: the mean over a large texture, asked for with every channel."""
        return self.terrain.mean_colour

    @cached_property
    def _wet_share(self) -> float:
        """Of the ground around the site, which is as wet as the site's mean."""
        assert self.terrain.wet is not None
        around = self.terrain.far_share > 0
        return float(self.terrain.wet.share[around].mean()) if around.any() else float(self.terrain.wet.share.mean())

    def albedo(self, channels: Channels) -> Floats:
        """(3,) of the plain."""
        near = channels.of_surface(self._near_colour, self.terrain.spectrum)
        if self.terrain.wet is not None:
            near = near * (1.0 - self._wet_share * (1.0 - film_factor(self.terrain, channels)))
        far = channels.of_surface(self.terrain.far_reflectance, self.terrain.far_spectrum)
        return np.asarray((1.0 - self.far_share) * near + self.far_share * far)

    def under(self, radiance: NDArray[np.float32]) -> CloudLight:
        """Under a sky of (MAP_ROWS, MAP_COLUMNS, C) radiance."""
        mean = float(self.albedo(RGB).mean())
        return CloudLight(self.sky.to_light, SUN_RADIUS_DEG, np.moveaxis(radiance, -1, 0), mean, self.ground_m)


def traced_clouds_of(spec: SceneSpec) -> TracedClouds:
    """The clouds of a scene, over a plain below every valley and camera."""
    assert spec.clouds is not None
    heights = [0.0, float(spec.terrain.mesh.vertices_m[:, 2].min()), *(camera.position_m[2] for camera in spec.cameras)]
    ground_m = float(np.floor(min(heights))) - 1.0
    share = _far_share(spec.terrain, np.asarray(spec.clouds.low_m), np.asarray(spec.clouds.high_m))
    aloft_m = tuple(max(height_of(one) - ground_m, 0.0) for one in spec.clouds.layers)
    result = TracedClouds(field_of(spec.clouds), spec.sky, spec.terrain, share, ground_m, "", aloft_m)
    parts = (content_key(spec.clouds), spec.sky, ground_m, result.under(np.zeros((1, 1, 3), np.float32)).ground_albedo)
    return replace(result, key=hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest())


def _far_share(terrain: Terrain, low_m: Floats, high_m: Floats) -> float:
    """Share of the ground below a box that has the colour of the distance, by area seen from above."""
    faces, vertices = terrain.mesh.faces, terrain.mesh.vertices_m[:, :2].astype(np.float64)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    (bx, by), (cx, cy) = (b - a).T, (c - a).T
    area = np.abs(bx * cy - by * cx)
    middle = (a + b + c) / 3.0
    area = area * np.all((middle >= low_m[:2]) & (middle <= high_m[:2]), axis=1)
    share = terrain.far_share[faces].mean(axis=1, dtype=np.float64)
    # No `@`: the last digits of its long sums depend on the threads of linear algebra.
    return float(np.sum(area * share) / area.sum()) if area.sum() > 0 else float(terrain.far_share.max(initial=0.0))


def site_middle(spec: SceneSpec) -> Floats:
    """(3,) world, whole metres: the middle of the plants, at the height of their tops; of the ground without plants."""
    if len(spec.instances):
        plants = spec.instances.on_site
        foot = plants.transform[:, :, 3]
        tallest = max(spec.exemplars[k].height_m for k in np.unique(plants.exemplar))
        low, high = foot.min(axis=0), foot.max(axis=0)
    else:
        near = spec.terrain.far_share < 0.5
        vertices = spec.terrain.mesh.vertices_m[near if near.any() else slice(None)].astype(np.float64)
        tallest, low, high = 1.0, vertices.min(axis=0), vertices.max(axis=0)
    middle = (low + high) / 2.0
    return np.round([middle[0], middle[1], high[2] + tallest])


@dataclass(frozen=True, eq=False)
class Baked:
    """Light at places, by reflections on the plain, for whatever channels.

    Three parts are the sky's light in colour, six the same at wavelengths, of a sky that gives 1 on a level plane, and
    one is the sun's, of a sun that gives 1 on a plane that faces it. The last ones are what of that each layer of
    clouds has scattered, and not the plain: it is of the sunlight at their height.
    """

    parts: NDArray[np.float32]  # (3, _SKIES + 1 + L, *S)

    def of(self, clouds: TracedClouds, channels: Channels) -> Floats:
        """(*S, 3) in the channels."""
        sky, sun, albedo = clouds.sky, sun_irradiance(clouds.sky, channels), clouds.albedo(channels)
        aloft = clouds.sun_aloft(channels) - sun
        level = np.ones(3) if channels.wavelength_nm is None else level_irradiance(sky_map(sky, channels))
        result = []
        for k in range(3):
            if channels.wavelength_nm is None:
                share = np.eye(3)[k].tolist() + [0.0] * len(_BAKED_NM)
            else:
                share = [0.0] * 3 + [np.interp(channels.wavelength_nm[k], _BAKED_NM, one) for one in _HATS]
            weight = np.outer(
                albedo[k] ** np.arange(ORDERS), np.array([*(level[k] * np.array(share)), sun[k], *aloft[:, k]])
            )
            result.append(np.tensordot(weight, self.parts, 2))
        return np.stack(result, axis=-1)


@dataclass(frozen=True, eq=False)
class SkyLight:
    """The sky through clouds at one place; black below the horizon, since the terrain reaches the horizon."""

    clouds: TracedClouds
    baked: Baked

    def radiance(self, channels: Channels) -> NDArray[np.float32]:
        """(MAP_ROWS, MAP_COLUMNS, 3) as `sky_map`."""
        return self.baked.of(self.clouds, channels).astype(np.float32)

    def light(self, channels: Channels) -> dict[str, Any]:
        """An `envmap` dictionary."""
        return envmap(self.radiance(channels))


@dataclass(frozen=True, eq=False)
class Overland:
    """Level irradiance under the clouds by place, without the sun's disc; the middle node is the map's place."""

    here: SkyLight  # in the middle
    east_m: Floats  # (N,) world, of the nodes: near one another in the middle
    north_m: Floats  # (N,)
    baked: Baked  # by north and east

    def ratio(self, channels: Channels, position_m: NDArray[np.floating]) -> Floats:
        """(..., 3) irradiance at (..., 3) world positions over that in the middle; 1 where a position is not finite."""
        total = self.baked.of(self.here.clouds, channels)
        middle = level_irradiance(self.here.radiance(channels))
        half = _NODES // 2
        # Correlation of a smoothed node's noise with that of the one in the middle.
        from_middle = (np.arange(_NODES) - half) / (2.0 * _BLUR_NODES)
        in_common = np.exp(-(from_middle[:, None] ** 2) - from_middle**2)
        total = total + in_common[..., None] * (middle - total[half, half])
        known = np.isfinite(position_m).all(axis=-1)
        result = np.ones((*known.shape, 3))
        i, u = _between(self.east_m, position_m[known][:, 0].astype(np.float64))
        j, v = _between(self.north_m, position_m[known][:, 1].astype(np.float64))
        south = total[j, i] * (1 - u) + total[j, i + 1] * u
        north = total[j + 1, i] * (1 - u) + total[j + 1, i + 1] * u
        result[known] = (south * (1 - v) + north * v) / np.maximum(middle, 1e-30)
        return result


_kept: BoundedCache[Baked] = BoundedCache(_KEPT_BYTES, lambda one: one.parts.nbytes)


def baked_sky(clouds: TracedClouds, place_m: Floats) -> SkyLight:
    """The sky at a place below the clouds. Call it in the scalar variant."""
    key = ("sky", clouds.key, tuple(place_m.tolist()))
    return SkyLight(clouds, _kept.get(key, lambda: _bake(clouds, place_m)))


def overland(here: SkyLight, place_m: Floats, base_m: float) -> Overland:
    """Irradiance around a place, of clouds with their base at a height. Call it in the scalar variant."""
    field, height_m = here.clouds.field, max(base_m - float(place_m[2]), LEAST_GAP_M)
    size_m = (np.array(field.value.shape[::-1]) - 2) / field.per_m
    edges = np.stack([field.low_m, field.low_m + size_m])[:, :2] - place_m[:2]
    offset = _spread(max(float(np.abs(edges).max()), height_m) + 2 * height_m, _NEAREST_NODE * height_m)
    key = ("land", here.clouds.key, tuple(place_m.tolist()), height_m)
    baked = _kept.get(key, lambda: _bake_land(here.clouds, place_m, offset))
    return Overland(here, offset + place_m[0], offset + place_m[1], baked)


def level_irradiance(radiance: NDArray[np.float32]) -> Floats:
    """(C,) light of a `sky_map` on a level plane."""
    rows, columns = radiance.shape[:2]
    theta = np.arange(rows) / (rows - 1) * np.pi
    weight = np.maximum(np.cos(theta), 0.0) * np.sin(theta) * (np.pi / (rows - 1)) * (2 * np.pi / columns)
    return np.asarray(np.einsum("rck,r->k", radiance.astype(np.float64), weight))


def _all_channels(sky: Sky) -> NDArray[np.float32]:
    """(MAP_ROWS, MAP_COLUMNS, 9) colour in its own unit, and six wavelengths as shares of the level irradiance."""
    result = [sky_map(sky, RGB)]
    for first in range(0, len(_BAKED_NM), 3):
        short, middle, long = _BAKED_NM[first : first + 3]
        radiance = sky_map(sky, Channels((short, middle, long)))
        result.append((radiance / np.maximum(level_irradiance(radiance), 1e-30)).astype(np.float32))
    return np.concatenate(result, axis=-1)


def _bake(clouds: TracedClouds, place_m: Floats) -> Baked:
    """Each pixel of the map is the mean over its own part of the sky."""
    light = clouds.under(_all_channels(clouds.sky))
    rng, seed = child_rng(0, "sky"), child_seed(0, "sky")
    step = np.pi / (MAP_ROWS - 1)
    count = _SKIES + 1 + len(clouds.field.layers)
    parts = np.zeros((ORDERS, count, MAP_ROWS, MAP_COLUMNS), dtype=np.float32)
    for row in range(MAP_ROWS // 2 + 1):
        paths = max(_LEAST_PATHS, round(_PATHS * np.sin(row * step)))
        shape = (MAP_COLUMNS, paths)
        low, high = np.cos(min((row + 0.5) * step, np.pi / 2)), np.cos(max((row - 0.5) * step, 0.0))
        up = low + (high - low) * (np.arange(paths) + rng.random(shape)) / paths
        turn = np.arange(MAP_COLUMNS)[:, None] + rng.permuted((np.arange(paths) + rng.random(shape)) / paths, axis=1)
        direction = _directions(up, turn * (2 * np.pi / MAP_COLUMNS)).reshape(-1, 3)
        found = _joined(gather(clouds.field, light, place_m, direction, seed=seed + row, disc=False))
        parts[:, :, row] = np.moveaxis(found.reshape(*shape, ORDERS, count).mean(axis=1), 0, -1)
    return Baked(parts)


def _bake_land(clouds: TracedClouds, place_m: Floats, offset_m: Floats) -> Baked:
    """Smoothed over neighbouring nodes: what clouds give to the ground varies over half the height of their base."""
    from scipy.ndimage import gaussian_filter

    light = clouds.under(_all_channels(clouds.sky))
    rng, seed = child_rng(0, "land"), child_seed(0, "land")
    north, east = np.meshgrid(offset_m, offset_m, indexing="ij")
    nodes = np.stack([east, north, np.zeros_like(east)], axis=-1).reshape(-1, 3) + place_m
    count = _SKIES + 1 + len(clouds.field.layers)
    total = np.zeros((len(nodes), ORDERS, count))
    shift, golden = rng.random((2, len(nodes))), np.pi * (3.0 - np.sqrt(5.0))
    for number in range(_NODE_PATHS):
        up = np.sqrt((number + shift[0]) / _NODE_PATHS)  # its density is the cosine's that irradiance asks for
        way = _directions(up, number * golden + 2 * np.pi * shift[1])
        total += _joined(gather(clouds.field, light, nodes, way, seed=seed + number, disc=False))
    parts = np.moveaxis((np.pi / _NODE_PATHS * total).reshape(_NODES, _NODES, ORDERS, count), (0, 1), (2, 3))
    smooth = gaussian_filter(parts, (0, 0, _BLUR_NODES, _BLUR_NODES), mode="nearest")
    return Baked(smooth.astype(np.float32))


def _joined(found: Gathered) -> Floats:
    """(N, 3, C + 1 + L)"""
    return np.concatenate([found.of_sky, found.of_sun[..., None], found.of_aloft], axis=-1)


def _spread(farthest_m: float, nearest_m: float) -> Floats:
    """(_NODES,) offsets from the middle to both sides, evenly apart in the middle and ever wider outside."""
    half = np.arange(_NODES) - _NODES // 2
    last = _NODES // 2
    low, high = 1e-6, 2.0  # of the sinh's stretch: bisection for the one that reaches farthest_m
    if nearest_m * last >= farthest_m:
        return np.asarray(half * (farthest_m / last), dtype=np.float64)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if nearest_m * np.sinh(middle * last) / middle < farthest_m else (low, middle)
    return np.asarray(nearest_m * np.sinh(low * half) / low)


def _directions(up: Floats, turn: Floats) -> Floats:
    """(..., 3) unit, of their sine of elevation and angle from x over y."""
    across = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    return np.stack([across * np.cos(turn), across * np.sin(turn), np.broadcast_to(up, turn.shape)], axis=-1)


def _between(nodes: Floats, place: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Node before each place, and how far it lies towards the next, (N, 1) in [0, 1]."""
    index = np.clip(np.searchsorted(nodes, place, side="right") - 1, 0, len(nodes) - 2)
    share = (place - nodes[index]) / (nodes[index + 1] - nodes[index])
    return index, np.clip(share, 0.0, 1.0)[:, None]
