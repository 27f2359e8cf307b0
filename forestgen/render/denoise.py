"""Denoising with Intel Open Image Denoise, and what guides it.

Guides are nearly noise-free pictures of the scene's colours in sun and shade, and of its normals. Tracing a ray is much
cheaper than a light path, so they can have many samples. The sun's share is in the colours since its shadows are edges
too: a denoiser that knows albedo alone takes them for noise and smears them. Clouds with detail have edges and billows
that are lost in the noise of their light: there the guide is how much of the sun comes to where a pixel's rays end in
the cloud. Other clouds and what lies between are left to the denoiser.

For the same reason each of a pixel's samples that the sun does not reach has a place of the sky, hidden or not: the
shade between leaves is in the colours. All pixels have the same places, so that the guide has no noise. Without it
a beech forest from inside, of 48 samples, has .35 of the power of 1/4 to 1/2 cycles a pixel, with it .46.

Still water has the guides of what it mirrors by Fresnel's share of its light, and its own for the rest, which comes
from the bed: there the guides know a level surface of the water's colour alone.

`benchmarks/sharpness.py` compares power spectra of denoised images with those of nearly noise-free ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.optical_depth import distance_to_depth, optical_depth
from forestgen.render.identity.interpolation import corners_of, shading_normal
from forestgen.render.identity.surface import SAMPLES, Values, albedo, spread_rank, sun_visible, unhidden
from forestgen.render.identity.tracer import LENS_STEPS, Hits, SceneTracer
from forestgen.render.light import has_sun
from forestgen.render.paths.fog import Fog
from forestgen.render.paths.scattering import WATER_INDEX, fresnel, has_water
from forestgen.render.paths.water import is_water
from forestgen.render.skies.model import casts_shadows
from forestgen.render.variant import dr, mi, mitsuba
from forestgen.render.views import lens_rays
from forestgen.scene.projection import DeviceRays
from forestgen.scene.spec import Camera, SceneSpec

_CLOUD_RAYS = 4  # of a pixel
_SEEN_DEPTH = 0.7  # optical depth of the place in a cloud that a ray sees
_CLEAR, _CLOUD_SHADE, _CLOUD_FALL, _DARK_DEPTH = 0.35, 0.5, 0.3, 12.0  # of guides: light falls slowly inside clouds
Floats = NDArray[np.float64]
_SHADE = 0.15  # light in the open shade, by that of a surface that faces the sun
_HIDDEN, _HIDDEN_BY_DAY = 0.2, 0.5  # shade where the sky is hidden, by that in the open; more beside sunlit leaves
_SHADE_EVERY = 4  # samples of which one is tried in the shade beside the sun's light, for the time that it takes
_ABOVE_WATER_M = 1e-3  # where mirrored rays begin


@dataclass(frozen=True)
class Guides:
    """Means over a pixel's samples."""

    colour: NDArray[np.float32]  # (H, W, 3) reflectance + transmittance, times the light of sun and shade; the sky: 1
    normal: NDArray[np.float32]  # (H, W, 3) shading normals, world; the sky: 0


def guide_values(tracer: SceneTracer, camera: Camera) -> Values:
    """The rays' colours and shading normals, three channels each."""
    fog = Fog(tracer.spec.fog, tracer.origin_m) if tracer.spec.fog else None
    mirrors = has_water(tracer.spec)

    def values(hits: Hits) -> list[Any]:
        seen, share = hits, mi.Float(1.0)
        if mirrors:
            hits, share = in_still_water(tracer, camera, seen)
        facing, corners = tracer.geometric_normal(hits), corners_of(tracer, hits)
        smooth = shading_normal(tracer, hits, corners, facing)
        sunlit = sun_visible(tracer, camera, hits, facing)
        every, hidden = (_SHADE_EVERY, _HIDDEN_BY_DAY) if casts_shadows(tracer.spec.sky) else (1, _HIDDEN)
        number = dr.arange(mi.UInt32, dr.width(hits.distance_m))
        to_sky = _sky_place(number)
        is_open = unhidden(tracer, camera, hits, facing, to_sky, hits.valid & ~sunlit & (number % every == 0))
        # Of all places over level ground the mean cosine is a half.
        shade = hidden + (1.0 - hidden) * dr.select(is_open, 2.0 * every * dr.abs(dr.dot(smooth, to_sky)), 0.0)
        if casts_shadows(tracer.spec.sky):
            lit = _SHADE + (1.0 - _SHADE) * dr.abs(dr.dot(smooth, tracer.to_light))
            shade = dr.select(sunlit, lit, _SHADE * shade)
        colour = dr.select(hits.valid, albedo(tracer, hits, corners) * shade, 1.0)
        smooth = dr.select(hits.valid, smooth, 0.0)
        if fog is not None:  # what is behind it is as faint as its light
            kept = dr.select(hits.valid, _kept(fog, tracer, camera, hits), 0.0)
            colour, smooth = 1.0 + kept * (colour - 1.0), kept * smooth
        if mirrors:
            own = dr.gather(mi.Color3f, tracer.table.albedo, seen.organ, seen.valid)
            colour, smooth = share * colour + (1.0 - share) * own, share * smooth + (1.0 - share) * mi.Vector3f(0, 0, 1)
            if fog is not None:  # before the water
                kept = dr.select(share < 1.0, _kept(fog, tracer, camera, seen), 1.0)
                colour, smooth = 1.0 + kept * (colour - 1.0), kept * smooth
        return [*colour, *smooth]

    return values


def in_still_water(tracer: SceneTracer, camera: Camera, hits: Hits) -> tuple[Hits, Any]:
    """What still water mirrors instead of the water, and Float: the share of its light; of other hits 1."""
    texture_width = dr.gather(mi.UInt32, tracer.table.texture, hits.organ * 3 + 1, hits.valid)
    still = is_water(tracer, hits.organ, hits.valid) & (texture_width == 0)  # else waves turn rays to other places
    way = hits.rays.direction
    up = mi.Vector3f(way.x, way.y, dr.abs(way.z))
    shift = way * hits.distance_m if hits.rays.shift_m is None else hits.rays.shift_m + way * hits.distance_m
    rays = DeviceRays(up, hits.rays.depth_share, shift + mi.Vector3f(0.0, 0.0, _ABOVE_WATER_M), hits.rays.valid)
    ray = mi.Ray3f(tracer.start_of(camera, rays), up)
    found = tracer.looked_up(rays, tracer.scene.ray_intersect_preliminary(ray, coherent=True, active=still), still)
    shift = hits.rays.shift_m if hits.rays.shift_m is not None else mi.Vector3f(0.0)
    shift, ways = dr.select(still, rays.shift_m, shift), dr.select(still, up, way)
    merged = DeviceRays(ways, hits.rays.depth_share, shift, hits.rays.valid)
    parts = {name: dr.select(still, getattr(found, name), getattr(hits, name)) for name in vars(hits) if name != "rays"}
    return Hits(rays=merged, **parts), dr.select(still, fresnel(up.z, mi.Float(WATER_INDEX)), 1.0)


def _kept(fog: Fog, tracer: SceneTracer, camera: Camera, hits: Hits) -> Any:
    """Float: share of the light of hits that comes through fog."""
    return fog.kept(tracer.start_of(camera, hits.rays), hits.rays.direction, hits.distance_m)


def open_values(hits: Hits) -> list[Any]:
    """1 for rays that meet nothing."""
    return [dr.select(hits.valid, 0.0, mi.Float(1.0))]


def with_clouds(guides: Guides, spec: SceneSpec, camera: Camera, sky: Floats) -> Guides:
    """The guides with those of clouds with detail in the `sky` (H, W), the share of a pixel that sees nothing else."""
    clouds, to_sun = spec.clouds, spec.sky.to_light
    if clouds is None or not clouds.detail.brick.size or not has_sun(spec.sky):
        return guides
    total = np.zeros(sky.shape)
    rows, columns = np.nonzero(sky > 0)
    for number in range(_CLOUD_RAYS):
        along, down = (number + 0.5) / _CLOUD_RAYS, (number * 0.6180339887498949 + 0.5) % 1.0
        when = (number * 0.7548776662466927 + 0.5) % 1.0
        places = np.broadcast_to(np.array([along, down, 0.5, 0.5, when])[:, None], (5, len(rows)))
        origin, direction, _ = lens_rays(camera, rows, columns, places)
        distance = distance_to_depth(clouds, origin, direction, _SEEN_DEPTH)
        met = np.isfinite(distance)
        seen = np.full(len(rows), _CLEAR)
        at = (np.broadcast_to(origin, direction.shape) + np.where(met, distance, 0.0)[:, None] * direction)[met]
        depth = optical_depth(clouds, at, np.broadcast_to(to_sun, at.shape), np.inf, enough=_DARK_DEPTH)
        seen[met] = _CLOUD_SHADE + (1.0 - _CLOUD_SHADE) * np.exp(-_CLOUD_FALL * depth)
        total[rows, columns] += seen / _CLOUD_RAYS
    colour = guides.colour + (sky * (total - 1.0))[..., None].astype(np.float32)
    return Guides(np.clip(colour, 0.0, None).astype(np.float32), guides.normal)


def _sky_place(number: Any) -> Any:
    """Unit direction upwards of a pixel's sample: even over the half sphere."""
    up = (mi.Float(spread_rank(number)) + 0.5) / SAMPLES
    sine, cosine = dr.sincos(2 * np.pi * mi.Float(number % SAMPLES * LENS_STEPS[1] >> 8) * 2.0**-24)
    level = dr.sqrt(1.0 - up * up)
    return mi.Vector3f(level * cosine, level * sine, up)


def guides_of(sums: NDArray[np.float32]) -> Guides:
    """Of the sums (6, H, W) of `guide_values`."""
    mean = np.moveaxis(sums / np.float32(SAMPLES), 0, -1)
    return Guides(mean[..., :3], mean[..., 3:])


def denoise(
    colour: NDArray[np.float32], guide: NDArray[np.float32] | None = None, normal: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) radiance, guided by noise-free colours (1 where the sky is: 0 biases clouds by -2.8%) and normals."""
    mitsuba()  # the denoiser shares Dr.Jit's thread pool: load it first
    import mitsuba_oidn

    result = mitsuba_oidn.denoise(
        np.ascontiguousarray(colour),
        albedo=None if guide is None else np.ascontiguousarray(guide),
        normal=None if normal is None else np.ascontiguousarray(normal),
        hdr=True,
        clean_aux=guide is not None,
        input_scale=_exposure(colour),
    )
    return np.asarray(result, dtype=np.float32)


def denoise_bands(
    image: NDArray[np.float32], guide: NDArray[np.float32] | None = None, normal: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(H, W, C) of any number of bands: three at a time, each group brought to one brightness and back."""
    bands = image.shape[2]
    level = np.maximum(np.nan_to_num(image).mean(axis=(0, 1), dtype=np.float64), 1e-30)
    result = np.empty_like(image)
    for first in range(0, bands, 3):
        own = np.minimum(np.arange(first, first + 3), bands - 1)  # the last group repeats its last band
        clean = denoise((image[..., own] / level[own]).astype(np.float32), guide, normal)
        kept = min(3, bands - first)
        result[..., first : first + kept] = clean[..., :kept] * level[own[:kept]]
    return result


def _exposure(colour: NDArray[np.float32]) -> float:
    """Scale that brings an image to the brightness that the denoiser was trained on.

    The denoiser's own automatic exposure, recomputed: 0.18 over the geometric mean of the luminance of 16 x 16 pixel
    blocks. Its parallel sum depends on the number of threads in the last bits, and so would every denoised pixel.
    """
    luminance = np.nan_to_num(colour.astype(np.float64)) @ [0.212671, 0.715160, 0.072169]
    rows, columns = (np.arange(0, length, 16) for length in luminance.shape)
    block = np.add.reduceat(np.add.reduceat(luminance, rows, axis=0), columns, axis=1)
    size = np.diff([*rows, luminance.shape[0]])[:, None] * np.diff([*columns, luminance.shape[1]])
    mean = block / size
    lit = mean[mean > 1e-8]
    return float(0.18 / np.exp2(np.log2(lit).mean())) if len(lit) else 1.0
