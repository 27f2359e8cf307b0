"""What light does where paths meet surfaces (`render/surfaces.py`): tables on the device, in the channels of a pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.identity.interpolation import (
    bilinear_places,
    corners_of,
    shading_normal,
    vertex_uv,
    weighted_sum,
)
from forestgen.render.identity.surface import ground_colour, patch_colours, with_wood_tone
from forestgen.render.identity.tracer import NONE, Hits, SceneTracer, organs_of, patch_rows, uploaded
from forestgen.render.identity.weather import darkened, film_on, under_snow
from forestgen.render.surfaces import is_textured, relief_colour, surface_of
from forestgen.render.variant import dr, mi
from forestgen.scene.colour import Channels
from forestgen.scene.spec import SceneSpec
from forestgen.scene.surfaces import FILM_WAY_M, film_factor, film_reflectances, ground_texture

Array = NDArray[np.float32]
WATER_INDEX = 1.333


@dataclass(frozen=True)
class ReliefTables:
    """Where textures lie and how their reliefs stand; entry 0 of the organs is the terrain's."""

    texture: NDArray[np.uint32]  # (1 + O, 3) first texel, width, height; width 0: no texture
    normal: Array  # (T, 3) of texels, in the frame of tangent, cotangent and normal
    patch_texture: NDArray[np.uint32] | None  # (K, 3) likewise, of the terrain's patches; None: there are none
    first_tangent: NDArray[np.uint32]  # (1 + O,) row of the organ's first face in `tangent`, or NONE: no relief
    tangent: Array  # (F', 3) along which u grows, of faces in their exemplar's frame


@dataclass(frozen=True)
class Paint:
    """Shares of light by organ, (1 + O, ...), and by texel."""

    matt: Array  # (1 + O, 3) reflected evenly
    through: Array  # (1 + O, 3) let through evenly
    gloss: Array  # (1 + O, 3) scale of the gloss' mirror, width of its facets, index of refraction; scale 0: none
    chance: Array  # (1 + O, 2) of a path to go through, and of one that does not to meet the gloss
    texel: Array  # (T, 3) reflected evenly, in place of `matt`
    far: tuple[float, float, float]  # of the ground in the distance
    film_factor: tuple[float, float, float]  # of the wet ground's colour
    absorption: Array | None  # (1 + O, 3) 1/m, of the water that an organ is the surface of; None: there is none


def relief_tables(spec: SceneSpec) -> ReliefTables:
    """O(faces of textured organs + texels)."""
    ground = spec.terrain.texture
    normals = [np.tile(np.array([0, 0, 1], np.float32), (ground.shape[0] * ground.shape[1], 1))]
    whole = (0, ground.shape[1], ground.shape[0]) if spec.terrain.mesh.uv is not None else (0, 0, 0)
    texture, first_tangent, tangents = [whole], [NONE], []
    texels, faces, known = len(normals[0]), 0, dict[int, int]()
    for _, mesh, material in organs_of(spec):
        if not is_textured(material, has_uv=mesh.uv is not None):
            texture.append((0, 0, 0))
            first_tangent.append(NONE)
            continue
        assert material.texture is not None
        normal = material.texture.normals()
        if id(material) not in known:
            known[id(material)] = texels
            normals.append(np.ascontiguousarray(normal, dtype=np.float32).reshape(-1, 3))
            texels += len(normals[-1])
        texture.append((known[id(material)], normal.shape[1], normal.shape[0]))
        first_tangent.append(faces)
        tangents.append(face_tangents(mesh))
        faces += len(mesh.faces)
    patches = [one.texture for one in spec.terrain.overlays]
    rows = patch_rows(patches, (texels + np.cumsum([0, *(one.size // 3 for one in patches)])).tolist()[:-1])
    normals += [np.tile(np.array([0, 0, 1], np.float32), (one.size // 3, 1)) for one in patches]
    tangents.append(np.zeros((1, 3), np.float32))  # the device gathers from no empty table
    return ReliefTables(
        np.asarray(texture, np.uint32),
        np.concatenate(normals),
        rows,
        np.asarray(first_tangent, np.uint32),
        np.concatenate(tangents),
    )


def face_tangents(mesh: Mesh) -> Array:
    """(F, 3) unit directions along which u grows on each face of a mesh with uv; 0 where the face has none."""
    assert mesh.uv is not None
    position, uv = mesh.vertices_m.astype(np.float64)[mesh.faces], mesh.uv.astype(np.float64)[mesh.faces]
    one, other = position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]
    (u1, v1), (u2, v2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    along = (v2[:, None] * one - v1[:, None] * other) * np.sign(u1 * v2 - v1 * u2)[:, None]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(along / np.where(length > 0, length, 1.0), dtype=np.float32)


def has_water(spec: SceneSpec) -> bool:
    """Whether there are surfaces of water."""
    return any(one.absorption is not None for one in spec.materials.values())


def paint_of(spec: SceneSpec, channels: Channels) -> Paint:
    """All surfaces of a scene in three channels."""
    terrain = spec.terrain
    ground = ground_texture(terrain, channels)
    texels = [ground.reshape(-1, 3)]
    matt, through, gloss, chance = [ground.mean(axis=(0, 1))], [np.zeros(3)], [np.zeros(3)], [np.zeros(2)]
    known: set[int] = set()
    absorbed = [np.zeros(3)]
    for part, mesh, material in organs_of(spec):
        surface = surface_of(part, material, channels, has_uv=mesh.uv is not None)
        if surface.textured and id(material) not in known:
            known.add(id(material))
            texels.append(np.asarray(relief_colour(material, surface, channels), dtype=np.float32).reshape(-1, 3))
        sides, lobe = surface.sides, surface.lobe
        absorbed.append(np.zeros(3) if material.absorption is None else channels.of_absorption(material.absorption))
        if material.absorption is not None:
            matt.append(np.zeros(3))
            through.append(np.zeros(3))
            gloss.append(np.array([1.0, material.roughness**2, WATER_INDEX]))
            chance.append(np.zeros(2))
            continue
        matt.append(sides.matt)
        through.append(sides.through)
        passing, glossy = sides.shares
        gloss.append(np.zeros(3) if lobe is None else np.array([sides.gloss / lobe.albedo, lobe.alpha, lobe.index]))
        chance.append(np.array([passing if sides.through.any() else 0.0, 0.0 if lobe is None else glossy]))
    texels += [ground_texture(patch, channels).reshape(-1, 3) for patch in terrain.overlays]
    far_red, far_green, far_blue = channels.of_surface(terrain.far_reflectance, terrain.far_spectrum).tolist()
    film_red, film_green, film_blue = film_factor(terrain, channels).tolist()
    return Paint(
        np.asarray(matt, np.float32),
        np.asarray(through, np.float32),
        np.asarray(gloss, np.float32),
        np.asarray(chance, np.float32),
        np.concatenate(texels, dtype=np.float32),
        (far_red, far_green, far_blue),
        (film_red, film_green, film_blue),
        np.asarray(absorbed, np.float32) if has_water(spec) else None,
    )


@dataclass(frozen=True)
class Local:
    """A surface at P points, its normals on the side that the paths came from."""

    towards: Any  # Vector3f, unit, back to where the path came from
    geometric: Any  # Vector3f, unit
    normal: Any  # Vector3f, unit, shading
    facet: Any  # Vector3f, unit, of the relief on it; the shading normal where there is none
    matt: Any  # Color3f
    through: Any  # Color3f
    gloss: Any  # Vector3f: scale, width, index; see `surface_tables.Paint`
    chance: Any  # Vector2f

    def value(self, direction: Any) -> Any:
        """Color3f: radiance back along the path per light from `direction` on a surface that faces it."""
        up, onto = dr.dot(self.normal, direction), dr.dot(self.facet, direction)
        lit = (up > 0) & (onto > 0) & (dr.dot(self.facet, self.towards) > 0)
        matt = dr.select(lit, self.matt * (onto / np.pi), 0.0)
        front = matt + dr.select(up > 0, self._mirrored(direction), 0.0)
        return dr.select(up > 0, front, self.through * (-up / np.pi)) & (up != 0)

    def _mirrored(self, direction: Any) -> Any:
        """Float: the gloss' share, by GGX with separable masking (Walter et al. 2007, eqs. 20, 33, 34)."""
        half = dr.normalize(self.towards + direction)
        up, mirror = dr.dot(self.normal, direction), fresnel(dr.dot(half, direction), self.gloss.z)
        return self.gloss.x * mirror * _lit(up, self.gloss.y * self.gloss.y) * self._glossy_density(half)

    def _glossy_density(self, half: Any) -> Any:
        return dr.select(self.gloss.x > 0, facet_density(self.normal, self.towards, half, self.gloss.y), 0.0)

    def density(self, direction: Any) -> Any:
        """Float: density, over the sphere, of the directions in which `sample` has paths go on."""
        up = dr.dot(self.normal, direction)
        even = dr.maximum(dr.dot(self.facet, direction), 0.0) / np.pi
        glossy = self._glossy_density(dr.normalize(self.towards + direction))
        above = (1.0 - self.chance.x) * ((1.0 - self.chance.y) * even + self.chance.y * glossy)
        return dr.select(up > 0, above, self.chance.x * (-up / np.pi))

    def sample(self, lobe: Any, first: Any, second: Any) -> tuple[Any, Any]:
        """Unit directions in which paths go on, and Color3f by which their light is multiplied, of (P,) in [0, 1)."""
        passes = lobe < self.chance.x
        rest = (lobe - self.chance.x) / dr.maximum(1.0 - self.chance.x, 1e-6)
        glossy = ~passes & (rest < self.chance.y)
        even = mi.warp.square_to_cosine_hemisphere(mi.Point2f(first, second))
        matt = mi.Frame3f(dr.select(passes, -self.normal, self.facet)).to_world(even)
        axes = mi.Frame3f(self.normal)
        view = axes.to_local(self.towards)
        half = visible_facet(view, self.gloss.y, first, second)
        mirrored = dr.fma(half, 2 * dr.dot(half, view), -view)
        share = self.gloss.x * fresnel(dr.dot(half, view), self.gloss.z) * _lit(mirrored.z, dr.square(self.gloss.y))
        direction = dr.select(glossy, axes.to_world(mirrored), matt)
        back = 1.0 - self.chance.x
        inside = (dr.dot(self.normal, matt) > 0) & (dr.dot(self.facet, self.towards) > 0)
        weight = dr.select(inside, self.matt * dr.rcp(dr.maximum(back * (1.0 - self.chance.y), 1e-6)), 0.0)
        bright = dr.select((mirrored.z > 0) & (view.z > 0), share * dr.rcp(dr.maximum(back * self.chance.y, 1e-6)), 0.0)
        weight = dr.select(glossy, mi.Color3f(bright), weight)
        return direction, dr.select(passes, self.through * dr.rcp(dr.maximum(self.chance.x, 1e-6)), weight)


def facet_density(normal: Any, towards: Any, half: Any, width: Any) -> Any:
    """Float: density over the directions to which facets that are seen and lean to `half` reflect a path."""
    square = width * width
    view, facing = dr.dot(normal, towards), dr.dot(normal, half)
    spread = dr.square(1.0 - facing * facing * (1.0 - square))
    value = square * _lit(view, square) / (4 * np.pi * spread * dr.maximum(view, 1e-6))
    return dr.select((view > 0) & (facing > 0), value, 0.0)


def _lit(cosine: Any, square: Any) -> Any:
    """Share of facets that are not hidden at an angle; `square` of the facets' width."""
    up = dr.square(dr.maximum(cosine, 1e-6))
    return 2.0 / (1.0 + dr.sqrt(1.0 + square * (1.0 - dr.minimum(up, 1.0)) / up))


def fresnel(cosine: Any, index: Any) -> Any:
    """Reflectance for unpolarised light from a medium of index 1."""
    inner = dr.sqrt(dr.maximum(1.0 - (1.0 - cosine * cosine) / dr.square(dr.maximum(index, 1.0)), 0.0))
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (index * cosine - inner) / (index * cosine + inner)
    return 0.5 * (across * across + along * along)


def visible_facet(view: Any, width: Any, first: Any, second: Any) -> Any:
    """Vector3f: normals of facets that are seen from `view` (Heitz 2018)."""
    stretched = dr.normalize(mi.Vector3f(width * view.x, width * view.y, dr.maximum(view.z, 1e-6)))
    length = stretched.x * stretched.x + stretched.y * stretched.y
    aside = dr.select(
        length > 1e-12,
        mi.Vector3f(-stretched.y, stretched.x, 0.0) * dr.rsqrt(dr.maximum(length, 1e-12)),
        mi.Vector3f(1.0, 0.0, 0.0),
    )
    across = dr.cross(stretched, aside)
    radius, (sine, cosine) = dr.sqrt(first), dr.sincos(2 * np.pi * second)
    x, y = radius * cosine, radius * sine
    share = 0.5 * (1.0 + stretched.z)
    y = (1.0 - share) * dr.sqrt(dr.maximum(1.0 - x * x, 0.0)) + share * y
    facet = x * aside + y * across + dr.sqrt(dr.maximum(1.0 - x * x - y * y, 0.0)) * stretched
    return dr.normalize(mi.Vector3f(width * facet.x, width * facet.y, dr.maximum(facet.z, 1e-6)))


# Numbers of ours. Widths of the facets of a film on what it covers, and of puddles.
_FILM_WIDTH, _POOL_WIDTH = 0.12, 0.02
_FILM_CHANCE, _POOL_CHANCE = 0.3, 0.5  # of paths to meet them
_SNOW_SMOOTH = 1.0  # how far the normals of snow on leaves and wood turn up: its surface is smoother than what bears it


def _with_film(gloss: Any, share: Any, width: Any) -> Any:
    """Vector3f: the gloss of a surface of which a share mirrors as water, by facets of a width.

    One lobe, which reflects what both together do, from straight ahead and grazing.
    """
    scale = gloss.x + share * (1.0 - gloss.x)
    film = share / dr.maximum(scale, 1e-6)
    own, water = dr.square((gloss.z - 1.0) / (gloss.z + 1.0)), ((WATER_INDEX - 1.0) / (WATER_INDEX + 1.0)) ** 2
    root = dr.sqrt(own + film * (water - own))
    return mi.Vector3f(scale, gloss.y + film * (width - gloss.y), (1.0 + root) / (1.0 - dr.minimum(root, 0.999)))


class Surfaces:
    """The tables of a scene on the device; its paint changes with the channels."""

    def __init__(self, tracer: SceneTracer) -> None:
        self._tracer, self._relief = tracer, uploaded(relief_tables(tracer.spec))

    def absorption(self, water: Any) -> Any:
        """Color3f, 1/m, of the water below surfaces of organs (UInt32); 0 of others."""
        return dr.gather(mi.Color3f, self._paint.absorption, water)

    def show(self, channels: Channels) -> None:
        """Have the paint of a pass' channels."""
        self._paint = uploaded(paint_of(self._tracer.spec, channels))
        snow = self._tracer.spec.snow
        if snow is not None:
            colour = channels.of_surface(snow.reflectance, snow.spectrum)
            self._snow = mi.Color3f(*[dr.opaque(mi.Float, float(value)) for value in colour])
        film = self._tracer.spec.film
        if film is not None:
            kept = np.exp(-FILM_WAY_M * channels.of_absorption(film.absorption))
            self._kept = mi.Color3f(*[dr.opaque(mi.Float, float(value)) for value in kept])

    def at(self, hits: Hits) -> Local:
        """The surfaces at hits; where none is hit, anything."""
        tracer, valid = self._tracer, hits.valid
        towards = -hits.rays.direction
        geometric = tracer.geometric_normal(hits)
        corners = corners_of(tracer, hits)
        normal = shading_normal(tracer, hits, corners, geometric)
        below = dr.dot(normal, towards) < 0
        normal = dr.select(below, -normal, normal)
        matt = dr.gather(mi.Color3f, self._paint.matt, hits.organ, valid)
        offset, width, height = (
            dr.gather(mi.UInt32, self._relief.texture, hits.organ * 3 + k, valid) for k in range(3)
        )
        textured = valid & (width > 0)
        u, v = vertex_uv(tracer, hits, corners, textured)
        places = bilinear_places(offset, width, height, u, v)
        colour = weighted_sum(mi.Color3f, self._paint.texel, places, textured)
        relief = weighted_sum(mi.Vector3f, self._relief.normal, places, textured)
        of_ground = self._paint.far, self._paint.film_factor
        patches = patch_colours(self._relief.patch_texture, self._paint.texel, u, v, textured & (hits.instance == 0))
        colour = ground_colour(tracer, hits, corners, colour, of_ground, patches)
        matt = dr.select(textured, colour, matt)
        matt = with_wood_tone(tracer, hits, matt, textured)
        through = dr.gather(mi.Color3f, self._paint.through, hits.organ, valid)
        gloss = dr.gather(mi.Vector3f, self._paint.gloss, hits.organ, valid)
        chance = dr.gather(mi.Vector2f, self._paint.chance, hits.organ, valid)
        if tracer.spec.film is not None:
            film = film_on(tracer, hits, corners, normal, v)
            matt = darkened(matt, film.soaked, self._kept)
            mirrors = film.share > 0
            part = dr.gather(mi.UInt32, tracer.table.part, hits.organ, valid)
            skin = (film.soaked == 0) & (part != int(Part.LITTER))  # of living leaves: other colours are darkened
            matt = dr.select(skin, matt * (1.0 - film.share * film_reflectances()[0]), matt)
            width = _FILM_WIDTH + film.pool * (_POOL_WIDTH - _FILM_WIDTH)
            gloss = dr.select(mirrors, _with_film(gloss, film.share, width), gloss)
            chance.y = dr.select(mirrors, _FILM_CHANCE + film.pool * (_POOL_CHANCE - _FILM_CHANCE), chance.y)
            normal = dr.select(
                film.pool > 0, dr.normalize(normal + film.pool * (mi.Vector3f(0, 0, 1) - normal)), normal
            )
        if tracer.spec.snow is not None:
            snow = under_snow(tracer, hits, corners, u, v)
            dark = snow.covered | snow.seen
            matt, through = dr.select(snow.seen, self._snow, matt), dr.select(dark, 0.0, through)
            gloss.x = dr.select(snow.seen, 0.0, gloss.x)
            chance.x, chance.y = dr.select(dark, 0.0, chance.x), dr.select(snow.seen, 0.0, chance.y)
            smooth = dr.normalize(normal + _SNOW_SMOOTH * mi.Vector3f(0.0, 0.0, 1.0))
            normal = dr.select(snow.seen & (dr.dot(smooth, towards) > 0), smooth, normal)
            textured &= ~snow.seen
        relief.x = dr.select(below, -relief.x, relief.x)  # seen from below, where v is to the other side of u
        facet = self._facet(hits, normal, towards, relief, textured)
        return Local(towards, geometric, normal, facet, matt, through, gloss, chance)

    def _facet(self, hits: Hits, normal: Any, towards: Any, relief: Any, textured: Any) -> Any:
        """Normals of the relief; one that leans away from where the path came from is turned about the surface's."""
        first = dr.gather(mi.UInt32, self._relief.first_tangent, hits.organ, textured)
        rough = textured & (first != NONE)
        local = dr.gather(mi.Vector3f, self._relief.tangent, first + hits.primitive, rough)
        along = self._tracer.direction_to_world(local, hits)
        along = dr.normalize(along - normal * dr.dot(normal, along))
        across = dr.cross(normal, along)
        bump = dr.normalize(relief)
        facet = bump.x * along + bump.y * across + bump.z * normal
        turned = 2.0 * bump.z * normal - facet
        facet = dr.select(dr.dot(facet, towards) <= 0, turned, facet)
        usable = rough & (dr.squared_norm(local) > 0) & dr.isfinite(dr.dot(facet, facet))
        return dr.select(usable, facet, normal)
