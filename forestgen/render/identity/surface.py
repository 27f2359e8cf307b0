"""What the rays through pixel centres meet: depth, position, normals, colour, and whether the sun reaches it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.render.build import origin_of
from forestgen.render.frame import Identity, Surface
from forestgen.render.identity.tracer import NONE, Hits, SceneTracer, sample_offsets
from forestgen.render.skies.model import casts_shadows
from forestgen.render.surfaces import LEAFLIKE
from forestgen.render.variant import dr, mi
from forestgen.scene.motion import is_rolling
from forestgen.scene.projection import projection_of, world_rays
from forestgen.scene.spec import Camera

Places = list[tuple[Any, Any]]  # weights, Float, and rows of a table, UInt32
Values = Callable[[Hits], Sequence[Any]]
SAMPLES = 64  # a pixel, of `pixel_sums`: what the denoiser's guides and the haze need to know of a view
_RAYS_AT_ONCE, _SUMMED_AT_ONCE = 2_000_000, 1_000_000
# Of the largest coordinate, a metre at least: shadow rays start this far above their surface. Single precision places
# a hit to within a few times 6e-8 of it, in the scene's frame and again in the instance's.
LIFT = 1e-5
_SNOW_GROUPS = (10, 7)  # bits of a face's number that are alike for neighbours: of a load on a branch, of a shoot
# Vertical parts of normals: of the steepest wood that holds snow where all is under it; and of leaves, which together
# hold it however each one stands.
_STEEPEST, _LEVEL_LEAF = 0.15, 0.35
_UNLABELLED = 1 << 31  # added to the row of what is no plant: other numbers than plants'


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


def corners_of(tracer: SceneTracer, hits: Hits) -> Places:
    """The triangle's three vertices, counted within the organ's mesh, with their barycentric weights."""
    weights = 1.0 - hits.uv.x - hits.uv.y, hits.uv.x, hits.uv.y
    rows = (dr.gather(mi.UInt32, tracer.table.corner, hits.face * 3 + k, hits.valid) for k in range(3))
    return list(zip(weights, rows, strict=True))


def weighted_sum(kind: Any, table: Any, places: Places, active: Any) -> Any:
    """Rows of a table of a kind of values, each times its weight."""
    total = kind(0.0)
    for weight, row in places:
        total += weight * dr.gather(kind, table, row, active)
    return total


def shading_normal(tracer: SceneTracer, hits: Hits, corners: Places, normal: Any) -> Any:
    """Vertex normals interpolated, on the side of the geometric `normal`; that one where the mesh has none."""
    first = dr.gather(mi.UInt32, tracer.table.first_normal, hits.organ, hits.valid)
    smooth = hits.valid & (first != NONE)
    rows = [(weight, first + corner) for weight, corner in corners]
    local = weighted_sum(mi.Vector3f, tracer.table.vertex_normal, rows, smooth)
    smooth &= dr.squared_norm(local) > 1e-12
    world = tracer.to_world(local, hits)
    world = dr.select(dr.dot(world, normal) < 0, -world, world)
    return dr.select(smooth, world, normal)


def albedo(tracer: SceneTracer, hits: Hits, corners: Places) -> Any:
    """Reflectance + transmittance at the hits, textures and the ground's distant colour included; 0 for the sky."""
    mean = dr.gather(mi.Color3f, tracer.table.albedo, hits.organ, hits.valid)
    first = dr.gather(mi.UInt32, tracer.table.first_uv, hits.organ, hits.valid)
    textured = hits.valid & (first != NONE)
    u, v = vertex_uv(tracer, hits, corners, textured)
    offset, width, height = (dr.gather(mi.UInt32, tracer.table.texture, hits.organ * 3 + k, textured) for k in range(3))
    colour = dr.select(textured, bilinear(tracer.table.texel, offset, width, height, u, v, textured), mean)
    of_ground = tracer.table.far_albedo, tracer.table.film_factor
    patches = patch_colours(tracer.table.patch_texture, tracer.table.texel, u, v, textured & (hits.instance == 0))
    shown = ground_colour(tracer, hits, corners, colour, of_ground, patches)
    if tracer.spec.snow is not None:
        shown = dr.select(under_snow(tracer, hits).seen, mi.Color3f(*tracer.spec.snow.reflectance), shown)
    return dr.select(hits.valid, shown, 0.0)


@dataclass(frozen=True)
class UnderSnow:
    """Which hits of plants and things have snow on their upper side."""

    covered: Any  # Bool, wherever the ray comes from
    seen: Any  # Bool, and the ray sees that side


def under_snow(tracer: SceneTracer, hits: Hits) -> UnderSnow:
    """By the slope of facets, and of leaves by chance, alike for some neighbours: those of a shoot.

    Wood holds snow where its facets' normals rise above 1 - share (1 - _STEEPEST): with more snow on steeper wood.
    """
    assert tracer.spec.snow is not None
    up = tracer.geometric_normal(hits).z
    part = dr.gather(mi.UInt32, tracer.table.part, hits.organ, hits.valid)
    leaflike = mi.Bool(False)
    for one in LEAFLIKE:
        leaflike |= part == int(one)
    plant = dr.gather(mi.UInt32, tracer.table.plant_id, hits.instance, hits.valid)
    plant = dr.select(plant > 0, plant, hits.instance + _UNLABELLED)
    groups = [mi.sample_tea_32(plant, hits.face >> size, 4)[0] for size in _SNOW_GROUPS]
    luck = sum(mi.Float(one >> 8) * 2.0**-24 for one in groups) / len(groups)
    # Of the mean of two even numbers, the share below a number (Irwin and Hall's distribution).
    luck = dr.select(luck < 0.5, 2.0 * luck * luck, 1.0 - 2.0 * dr.square(1.0 - luck))
    share = dr.opaque(mi.Float, tracer.spec.snow.share)
    on_leaf = luck < share * dr.minimum(dr.abs(up) / _LEVEL_LEAF, 1.0)
    on_wood = dr.abs(up) > 1.0 - share * (1.0 - _STEEPEST)
    covered = hits.valid & (hits.instance > 0) & dr.select(leaflike, on_leaf, on_wood) & (part != int(Part.WATER))
    return UnderSnow(covered, covered & (up > 0))


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


def vertex_uv(tracer: SceneTracer, hits: Hits, corners: Places, textured: Any) -> tuple[Any, Any]:
    """u and v of hits on textured meshes."""
    first = dr.gather(mi.UInt32, tracer.table.first_uv, hits.organ, textured)
    u, v = (
        weighted_sum(mi.Float, tracer.table.uv, [(w, (first + c) * 2 + axis) for w, c in corners], textured)
        for axis in range(2)
    )
    return u, v


def bilinear(texel: Any, first: Any, width: Any, height: Any, u: Any, v: Any, active: Any) -> Any:
    """Colours of repeating textures as in Mitsuba's `bitmap`: texel centres at (i + 0.5) / width, row 0 at v = 0."""
    return weighted_sum(mi.Color3f, texel, bilinear_places(first, width, height, u, v), active)


def bilinear_places(first: Any, width: Any, height: Any, u: Any, v: Any) -> Places:
    """Weights and rows of the four texels around a place of a repeating texture."""
    x, y = ((t - dr.floor(t)) * mi.Float(size) - 0.5 for t, size in ((u, width), (v, height)))
    left, low = mi.Int32(dr.floor(x)), mi.Int32(dr.floor(y))
    columns, rows = mi.Int32(width), mi.Int32(height)
    places = []
    for i, across in ((0, 1.0 - (x - dr.floor(x))), (1, x - dr.floor(x))):
        for j, up in ((0, 1.0 - (y - dr.floor(y))), (1, y - dr.floor(y))):
            column, row = _wrapped(left + i, columns), _wrapped(low + j, rows)
            places.append((across * up, first + mi.UInt32(row * columns + column)))
    return places


def _wrapped(index: Any, size: Any) -> Any:
    """Index of -1 to `size`, into a row that repeats."""
    return dr.select(index < 0, index + size, dr.select(index >= size, index - size, index))


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
