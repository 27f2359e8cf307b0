"""What surfaces do with light (`render/surfaces.py`) as tables, by organ and by texel, in the channels of a pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.identity.tables import NONE
from forestgen.render.surfaces import is_textured, relief_colour, surface_of
from forestgen.scene.channels import Channels
from forestgen.scene.soil_colour import film_factor
from forestgen.scene.spec import Material, SceneSpec

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ReliefTables:
    """Where textures lie and how their reliefs stand; entry 0 of the organs is the terrain's."""

    texture: NDArray[np.uint32]  # (1 + O, 3) first texel, width, height; width 0: no texture
    normal: Array  # (T, 3) of texels, in the frame of tangent, cotangent and normal
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


def _organs(spec: SceneSpec) -> Iterator[tuple[Part, Mesh, Material]]:
    """In the order of the identity pass' tables, the terrain left out."""
    for exemplar in spec.exemplars:
        for organ in exemplar.organs:
            yield organ.part, organ.mesh, spec.materials[exemplar.species, organ.material]


def relief_tables(spec: SceneSpec) -> ReliefTables:
    """O(faces of textured organs + texels)."""
    ground = spec.terrain.texture
    normals = [np.tile(np.array([0, 0, 1], np.float32), (ground.shape[0] * ground.shape[1], 1))]
    whole = (0, ground.shape[1], ground.shape[0]) if spec.terrain.mesh.uv is not None else (0, 0, 0)
    texture, first_tangent, tangents = [whole], [NONE], []
    texels, faces, known = len(normals[0]), 0, dict[int, int]()
    for part, mesh, material in _organs(spec):
        if not is_textured(part, material, has_uv=mesh.uv is not None):
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
    tangents.append(np.zeros((1, 3), np.float32))  # the device gathers from no empty table
    return ReliefTables(
        np.asarray(texture, np.uint32),
        np.concatenate(normals),
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


def paint_of(spec: SceneSpec, channels: Channels) -> Paint:
    """All surfaces of a scene in three channels."""
    terrain = spec.terrain
    ground = channels.texture(terrain.texture, terrain.mean_colour, terrain.spectrum)
    texels = [np.maximum(ground, 0.0).reshape(-1, 3)]
    matt, through, gloss, chance = [ground.mean(axis=(0, 1))], [np.zeros(3)], [np.zeros(3)], [np.zeros(2)]
    known: set[int] = set()
    for part, mesh, material in _organs(spec):
        surface = surface_of(part, material, channels, has_uv=mesh.uv is not None)
        if surface.textured and id(material) not in known:
            known.add(id(material))
            texels.append(np.asarray(relief_colour(material, channels), dtype=np.float32).reshape(-1, 3))
        sides, lobe = surface.sides, surface.lobe
        matt.append(sides.matt)
        through.append(sides.through)
        passing, glossy = sides.shares
        gloss.append(np.zeros(3) if lobe is None else np.array([sides.gloss / lobe.albedo, lobe.alpha, lobe.index]))
        chance.append(np.array([passing if sides.through.any() else 0.0, 0.0 if lobe is None else glossy]))
    far = channels.of_surface(terrain.far_reflectance, terrain.far_spectrum).tolist()
    film = film_factor(terrain, channels).tolist()
    return Paint(
        matt=np.asarray(matt, np.float32),
        through=np.asarray(through, np.float32),
        gloss=np.asarray(gloss, np.float32),
        chance=np.asarray(chance, np.float32),
        texel=np.concatenate(texels, dtype=np.float32),
        far=(far[0], far[1], far[2]),
        film_factor=(film[0], film[1], film[2]),
    )
