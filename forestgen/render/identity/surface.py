"""What the rays through pixel centres meet: depth, position, normals, colour, and whether the sun reaches it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.render.build import origin_of
from forestgen.render.frame import Identity, Surface
from forestgen.render.identity.interpolation import (
    Places,
    bilinear,
    corners_of,
    shading_normal,
    vertex_uv,
    weighted_sum,
)
from forestgen.render.identity.tracer import NONE, Hits, SceneTracer, sample_offsets
from forestgen.render.identity.weather import darkened, film_on, under_snow
from forestgen.render.skies.model import casts_shadows
from forestgen.render.variant import dr, mi
from forestgen.scene.bark_tones import WOOD
from forestgen.scene.motion import is_rolling
from forestgen.scene.projection import projection_of, world_rays
from forestgen.scene.spec import Camera

Values = Callable[[Hits], Sequence[Any]]
SAMPLES = 64  # a pixel, of `pixel_sums`: what the denoiser's guides and the haze need to know of a view
_RANK_STEP = 37  # from one sample's rank to the next one's; it has no divisor in common with `SAMPLES`
_RAYS_AT_ONCE, _SUMMED_AT_ONCE = 2_000_000, 1_000_000
# Of the largest coordinate, a metre at least: shadow rays start this far above their surface. Single precision places
# a hit to within a few times 6e-8 of it, in the scene's frame and again in the instance's.
LIFT = 1e-5


def trace_identity(
    tracer: SceneTracer,
    camera: Camera,
    *,
    samples: int,
    timer: Callable[[str], Any],
    advance: Callable[[int], None],
    faces: bool = False,
) -> tuple[Identity, Surface]:
    """What `camera` sees of the tracer's scene, by a number of samples a pixel that is a perfect square.

    Time O(pixels x samples x log triangles); memory 5 bytes a sample (13 with `faces`, each sample's exemplar and
    face), 94 bytes a pixel, and about 60 bytes a ray of a block of two million rays. `timer` books time under a name;
    `advance` is called with the number of rows that are done.
    """
    width, height = camera.size_px
    shape = (height, width, samples)
    identity = Identity(np.zeros(shape, np.uint32), np.zeros(shape, np.uint8))
    if faces:
        identity = replace(identity, exemplar=np.zeros(shape, np.uint32), face=np.zeros(shape, np.uint32))
    surface = empty_surface(height, width)
    with timer("identity: trace"):
        for rows, hits in tracer.by_rows(camera, sample_offsets(samples), _RAYS_AT_ONCE):
            _fill(identity, rows, _ids(tracer, hits))
            advance(rows.stop - rows.start)
    with timer("identity: surface"):
        for rows, hits in tracer.by_rows(camera, np.array([0.5, 0.5]), _RAYS_AT_ONCE):
            _fill(surface, rows, _ids(tracer, hits) | _light_and_shape(tracer, camera, hits))
            surface.position_m[rows] = positions(camera, rows, surface.distance_m[rows])
    return identity, surface


def _ids(tracer: SceneTracer, hits: Hits) -> dict[str, Any]:
    """What is hit, by the names of the fields of `Identity` and `Surface`."""
    plant_id = dr.gather(mi.UInt32, tracer.table.plant_id, hits.instance, hits.valid)
    part = dr.gather(mi.UInt32, tracer.table.part, hits.organ, hits.valid)
    is_unlabelled = hits.valid & (hits.instance > 0) & (plant_id == 0) & (part <= int(Part.DEAD_WOOD))
    return {
        "plant_id": plant_id,
        "part": dr.uint8_array_t(mi.UInt32)(dr.select(is_unlabelled, int(Part.SURROUNDINGS), part)),
        "exemplar": dr.gather(mi.UInt32, tracer.table.exemplar, hits.instance, hits.valid),
        "face": tracer.face_in_exemplar(hits),
    }


def _fill(target: Identity | Surface, rows: slice, found: dict[str, Any]) -> None:
    """Write what was found into the arrays that the target has."""
    found = {name: values for name, values in found.items() if getattr(target, name) is not None}
    dr.eval(found)
    for name, values in found.items():
        field = getattr(target, name)
        field[rows] = np.array(values).reshape(field[rows].shape)


def pixel_sums(tracer: SceneTracer, camera: Camera, wanted: Sequence[Values]) -> list[NDArray[np.float32]]:
    """(C, H, W) for each of `wanted`: its C values by ray, summed over a pixel's `SAMPLES` rays, all in one launch.

    Rays of a camera that moves are spread over the exposure, as its light is.
    """
    blocks = []
    for _, hits in tracer.by_rows(camera, sample_offsets(SAMPLES), _SUMMED_AT_ONCE, exposed=True):
        values = [list(one(hits)) for one in wanted]
        dr.eval(values)  # together, and before the sums: each sum alone would trace all the rays again
        sums = [[dr.block_sum(one, SAMPLES) for one in group] for group in values]
        dr.eval(sums)
        blocks.append([np.array(group).reshape(len(group), -1, camera.size_px[0]) for group in sums])
    return [np.concatenate(parts, axis=1) for parts in zip(*blocks, strict=True)]


def spread_rank(ray: Any) -> Any:
    """Ranks of 0 to `SAMPLES` - 1 by the number of rays of `pixel_sums`: the first of a pixel lie all over it."""
    return ray % SAMPLES * _RANK_STEP % SAMPLES


def empty_surface(height: int, width: int) -> Surface:
    """Sky alone."""
    shape = (height, width)
    return Surface(
        plant_id=np.zeros(shape, dtype=np.uint32),
        part=np.zeros(shape, dtype=np.uint8),
        exemplar=np.zeros(shape, dtype=np.uint32),
        face=np.zeros(shape, dtype=np.uint32),
        depth_m=np.full(shape, np.inf, dtype=np.float32),
        distance_m=np.full(shape, np.inf, dtype=np.float32),
        position_m=np.full((*shape, 3), np.nan, dtype=np.float32),
        normal=np.zeros((*shape, 3), dtype=np.float32),
        shading_normal=np.zeros((*shape, 3), dtype=np.float32),
        albedo=np.zeros((*shape, 3), dtype=np.float32),
        sun_visible=np.zeros(shape, dtype=np.bool_),
    )


def _light_and_shape(tracer: SceneTracer, camera: Camera, hits: Hits) -> dict[str, Any]:
    """The other fields of `Surface` by name, positions left out."""
    normal, corners = tracer.geometric_normal(hits), corners_of(tracer, hits)
    return {
        "depth_m": dr.select(hits.valid, hits.distance_m * hits.rays.depth_share, dr.inf),
        "distance_m": dr.select(hits.valid, hits.distance_m, dr.inf),
        "normal": dr.ravel(normal),
        "shading_normal": dr.ravel(shading_normal(tracer, hits, corners, normal)),
        "albedo": dr.ravel(albedo(tracer, hits, corners)),
        "sun_visible": dr.select(sun_visible(tracer, camera, hits, normal), mi.UInt32(1), 0),
    }


def positions(camera: Camera, rows: slice, distance_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """(rows, W, 3) world, in double precision from the distances along pixel centres' rays; NaN for the sky."""
    if not projection_of(camera).is_pinhole or is_rolling(camera):
        rays = world_rays(camera, rows)
        far = np.where(np.isfinite(distance_m), distance_m, np.nan)[..., None]
        return (rays.origin_m + rays.direction * far).astype(np.float32)
    u, v = camera.pixel_slopes
    v = v[rows]
    length = np.sqrt(1.0 + u**2 + v[:, None] ** 2)
    depth = np.where(np.isfinite(distance_m), distance_m, np.nan) / length
    position = np.empty((*depth.shape, 3), dtype=np.float32)
    # By axis: half the memory, which counts in the images that are most.
    for axis, (right, down, forward) in enumerate(np.asarray(camera.world_from_camera, dtype=np.float64)):
        position[..., axis] = depth * (u * right + v[:, None] * down + forward) + origin_of(camera)[axis]
    return position


def albedo(tracer: SceneTracer, hits: Hits, corners: Places) -> Any:
    """Reflectance + transmittance at the hits, textures and the ground's distant colour included; 0 for the sky."""
    mean = dr.gather(mi.Color3f, tracer.table.albedo, hits.organ, hits.valid)
    first = dr.gather(mi.UInt32, tracer.table.first_uv, hits.organ, hits.valid)
    textured = hits.valid & (first != NONE)
    u, v = vertex_uv(tracer, hits, corners, textured)
    offset, width, height = (dr.gather(mi.UInt32, tracer.table.texture, hits.organ * 3 + k, textured) for k in range(3))
    colour = dr.select(textured, bilinear(tracer.table.texel, offset, width, height, u, v, textured), mean)
    colour = with_wood_tone(tracer, hits, colour, textured)
    of_ground = tracer.table.far_albedo, tracer.table.film_factor
    patches = patch_colours(tracer.table.patch_texture, tracer.table.texel, u, v, textured & (hits.instance == 0))
    shown = ground_colour(tracer, hits, corners, colour, of_ground, patches)
    if tracer.spec.film is not None:
        normal = shading_normal(tracer, hits, corners, tracer.geometric_normal(hits))
        shown = darkened(shown, film_on(tracer, hits, corners, normal, v).soaked, 1.0)
    if tracer.spec.snow is not None:
        seen = under_snow(tracer, hits, corners, u, v).seen
        shown = dr.select(seen, mi.Color3f(*tracer.spec.snow.reflectance), shown)
    return dr.select(hits.valid, shown, 0.0)


def with_wood_tone(tracer: SceneTracer, hits: Hits, colour: Any, textured: Any) -> Any:
    """The colours of textured wood with the tone of its plant; at most 1."""
    if tracer.table.wood_tone is None:
        return colour
    part = dr.gather(mi.UInt32, tracer.table.part, hits.organ, textured)
    is_wood = textured & reduce(or_, (part == int(one) for one in WOOD))
    tone = dr.gather(mi.Float, tracer.table.wood_tone, hits.instance, is_wood)
    return dr.select(is_wood, dr.minimum(colour * tone, 1.0), colour)


def patch_colours(texture: Any | None, texel: Any, u: Any, v: Any, active: Any) -> list[Any]:
    """Colours of the terrain's patches, by their rows of the table `texel`; meaningless off the terrain."""
    if texture is None:
        return []
    found = []
    for patch in range(dr.width(texture) // 3):
        first, width, height = (dr.gather(mi.UInt32, texture, mi.UInt32(3 * patch + k)) for k in range(3))
        found.append(bilinear(texel, first, width, height, u, v, active))
    return found


def ground_colour(
    tracer: SceneTracer,
    hits: Hits,
    corners: Places,
    colour: Any,
    of_ground: tuple[Any, Any],
    patches: Sequence[Any] = (),
) -> Any:
    """`colour` of hits; the ground's is that of others in places, dimmed where it is wet, and that of the distance
    where it lies far.

    `of_ground` are, in the channels of `colour`, the distant ground's colour, and the factor of a film of water;
    `patches` the colours of other grounds in places, the later ones on the earlier.
    """
    ground = hits.valid & (hits.instance == 0)
    far_colour, film_factor = of_ground
    far = dr.clip(weighted_sum(mi.Float, tracer.table.far_share, corners, ground), 0.0, 1.0)
    near = _dimmed(tracer.table.wet_share, corners, ground, colour, film_factor)
    vertices = dr.opaque(mi.UInt32, dr.width(tracer.table.far_share))
    for index, patch in enumerate(patches):
        rows = [(weight, corner + index * vertices) for weight, corner in corners]
        here = dr.clip(weighted_sum(mi.Float, tracer.table.patch_share, rows, ground), 0.0, 1.0)
        damp = _dimmed(tracer.table.wet_share, corners, ground, patch, film_factor)
        near = near * (1.0 - here) + damp * here
    return dr.select(ground, near * (1.0 - far) + far_colour * far, colour)


def _dimmed(share: Any | None, corners: Places, ground: Any, colour: Any, factor: Any) -> Any:
    """`colour` times a factor in places, by the share of vertices; None: nowhere."""
    if share is None:
        return colour
    here = dr.clip(weighted_sum(mi.Float, share, corners, ground), 0.0, 1.0)
    return colour * (1.0 - here * (1.0 - factor))


def sun_visible(tracer: SceneTracer, camera: Camera, hits: Hits, normal: Any) -> Any:
    """Whether nothing of the scene, clouds left out, hides the sun's centre, or by night the moon's; else False."""
    active = hits.valid & casts_shadows(tracer.spec.sky)
    return unhidden(tracer, camera, hits, normal, tracer.to_light, active)


def unhidden(
    tracer: SceneTracer, camera: Camera, hits: Hits, normal: Any, direction: Any, active: Any | None = None
) -> Any:
    """Whether nothing of the scene lies in a direction from the hits, by default from all that are valid."""
    point = tracer.start_of(camera, hits.rays) + hits.rays.direction * hits.distance_m
    bright = dr.select(dr.dot(normal, direction) < 0, -normal, normal)  # leaves are lit through from below, too
    lift = LIFT * dr.maximum(dr.max(dr.abs(point)), 1.0)
    ray = mi.Ray3f(point + bright * lift, direction)
    # Single rays: from leaf to leaf neighbours lose each other, and packets take 1.7 times as long.
    lit = hits.valid if active is None else active
    return lit & ~tracer.scene.ray_test(ray, coherent=False, active=lit)
