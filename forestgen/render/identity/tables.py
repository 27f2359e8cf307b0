"""Flat tables behind a hit, in NumPy: instance -> plant, (exemplar, organ) -> part and colour, face -> vertices.

Entry 0 of instances and organs is the terrain's. Bytes: 48 an instance, 24 a triangle, 12 a vertex with a normal, 8 a
vertex of a textured mesh, 12 a texel: 77 MB for the 10,000 instances of benchmarks/labels.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.surfaces import LEAFLIKE
from forestgen.scene.channels import RGB
from forestgen.scene.soil_colour import film_factor
from forestgen.scene.spec import Material, SceneSpec

NONE = 2**32 - 1  # instead of a first row: the mesh has none


@dataclass(frozen=True)
class HitTables:
    """Everything that turns a hit into labels."""

    plant_id: NDArray[np.uint32]  # (1 + N,) by instance
    exemplar: NDArray[np.uint32]  # (1 + N,) index into SceneSpec.exemplars + 1; 0 for the terrain
    rotation: NDArray[np.float32]  # (1 + N, 9) row-major inverse transpose of the instance's linear part
    first_organ: NDArray[np.uint32]  # (1 + N,) first organ of the instance's exemplar
    part: NDArray[np.uint8]  # (1 + O,) by organ
    albedo: NDArray[np.float32]  # (1 + O, 3) reflectance + transmittance, the mean of a texture
    first_face: NDArray[np.uint32]  # (1 + O,) first face of the organ
    normal: NDArray[np.float32]  # (F, 3) geometric, not normalised by the instance's transform
    corner: NDArray[np.uint32]  # (F, 3) vertices, counted within the organ's mesh
    first_normal: NDArray[np.uint32]  # (1 + O,) row of the organ's first vertex in `vertex_normal`, or NONE
    vertex_normal: NDArray[np.float32]  # (VN, 3)
    first_uv: NDArray[np.uint32]  # (1 + O,) row of the organ's first vertex in `uv`, or NONE
    uv: NDArray[np.float32]  # (VT, 2) of textured meshes alone
    texture: NDArray[np.uint32]  # (1 + O, 3) first texel, width, height; width 0: no texture
    texel: NDArray[np.float32]  # (T, 3) linear Rec. 709; row 0 of a texture is v = 0
    far_share: NDArray[np.float32]  # (VG,) by vertex of the terrain
    far_albedo: tuple[float, float, float]
    wet_share: NDArray[np.float32] | None  # (VG,) by vertex of the terrain; None: none is wet
    film_factor: tuple[float, float, float]  # of the wet ground's albedo

    @property
    def nbytes(self) -> int:
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))


def face_normals(mesh: Mesh) -> NDArray[np.float32]:
    """(F, 3) unit geometric normals; a degenerate face has zero."""
    # By coordinates: three times as fast as np.cross on half a million faces.
    a, b, c = (mesh.vertices_m.astype(np.float64).T[:, mesh.faces[:, k]] for k in range(3))
    (x, y, z), (u, v, w) = b - a, c - a
    normal = np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
    length = np.sqrt(np.einsum("kf,kf->f", normal, normal))
    normal /= np.where(length > 0, length, 1.0)
    return np.ascontiguousarray(normal.T, dtype=np.float32)


def albedo_of(part: Part, material: Material) -> NDArray[np.float64]:
    """(3,) reflectance, and of a thin leaf the transmittance too: what `render.surfaces.surface_bsdf` makes of it."""
    reflectance = np.asarray(material.reflectance, dtype=np.float64)
    return reflectance + material.transmittance if part in LEAFLIKE else reflectance


class _Organs:
    """Tables by organ and by face, grown mesh by mesh."""

    def __init__(self) -> None:
        self.part: list[int] = []
        self.albedo: list[NDArray[np.float64]] = []
        self.first_face: list[int] = []
        self.first_normal: list[int] = []
        self.first_uv: list[int] = []
        self.texture: list[tuple[int, int, int]] = []
        self.normal: list[NDArray[np.float32]] = []
        self.corner: list[NDArray[np.uint32]] = []
        # One row that nothing refers to: the device gathers from no empty table.
        self.vertex_normal: list[NDArray[np.float32]] = [np.zeros((1, 3), dtype=np.float32)]
        self.uv: list[NDArray[np.float32]] = [np.zeros((1, 2), dtype=np.float32)]
        self.texel: list[NDArray[np.float32]] = [np.zeros((1, 3), dtype=np.float32)]
        self._faces, self._normals, self._uvs, self._texels = 0, 1, 1, 1
        self._first_texel: dict[int, int] = {}  # by the texture's identity: species share none, organs may

    def add(self, part: Part, mesh: Mesh, albedo: NDArray[np.float64], image: NDArray[np.float32] | None) -> None:
        """`image` is the colour texture; a mesh without uv has one colour."""
        self.part.append(int(part))
        self.albedo.append(albedo)
        self.first_face.append(self._faces)
        self.normal.append(face_normals(mesh))
        self.corner.append(mesh.faces)
        self._faces += len(mesh.faces)
        self.first_normal.append(NONE if mesh.normals is None else self._normals)
        if mesh.normals is not None:
            self.vertex_normal.append(mesh.normals)
            self._normals += len(mesh.normals)
        if image is None or mesh.uv is None:
            self.first_uv.append(NONE)
            self.texture.append((0, 0, 0))
            return
        self.first_uv.append(self._uvs)
        self.uv.append(mesh.uv)
        self._uvs += len(mesh.uv)
        if id(image) not in self._first_texel:
            self._first_texel[id(image)] = self._texels
            self.texel.append(np.asarray(image, dtype=np.float32).reshape(-1, 3))
            self._texels += len(self.texel[-1])
        self.texture.append((self._first_texel[id(image)], image.shape[1], image.shape[0]))


def hit_tables(spec: SceneSpec) -> HitTables:
    """Tables of `spec`: O(instances + faces and vertices of exemplars + texels)."""
    organs, terrain = _Organs(), spec.terrain
    organs.add(Part.GROUND, terrain.mesh, terrain.texture.mean(axis=(0, 1), dtype=np.float64), terrain.texture)
    organ_of_exemplar = np.zeros(len(spec.exemplars), dtype=np.uint32)
    for index, exemplar in enumerate(spec.exemplars):
        organ_of_exemplar[index] = len(organs.part)
        for organ in exemplar.organs:
            material = spec.materials[exemplar.species, organ.material]
            textured = material.texture is not None and organ.part not in LEAFLIKE
            image = material.texture.colour if textured and material.texture is not None else None
            organs.add(organ.part, organ.mesh, albedo_of(organ.part, material), image)
    # Normals go with the inverse transpose; for a rotation times a uniform scale that is the matrix itself up to scale.
    inverse_transpose = np.linalg.inv(spec.instances.transform[:, :, :3]).transpose(0, 2, 1)
    red, green, blue = film_factor(terrain, RGB).tolist()
    return HitTables(
        plant_id=np.concatenate([[0], spec.instances.plant_id]).astype(np.uint32),
        exemplar=np.concatenate([[0], spec.instances.exemplar.astype(np.int64) + 1]).astype(np.uint32),
        rotation=np.concatenate([np.eye(3).reshape(1, 9), inverse_transpose.reshape(-1, 9)]).astype(np.float32),
        first_organ=np.concatenate([[0], organ_of_exemplar[spec.instances.exemplar]]).astype(np.uint32),
        part=np.asarray(organs.part, dtype=np.uint8),
        albedo=np.asarray(organs.albedo, dtype=np.float32),
        first_face=np.asarray(organs.first_face, dtype=np.uint32),
        normal=np.concatenate(organs.normal),
        corner=np.concatenate(organs.corner),
        first_normal=np.asarray(organs.first_normal, dtype=np.uint32),
        vertex_normal=np.concatenate(organs.vertex_normal),
        first_uv=np.asarray(organs.first_uv, dtype=np.uint32),
        uv=np.concatenate(organs.uv),
        texture=np.asarray(organs.texture, dtype=np.uint32).reshape(-1, 3),
        texel=np.concatenate(organs.texel),
        far_share=np.asarray(terrain.far_share, dtype=np.float32),
        far_albedo=terrain.far_reflectance,
        wet_share=None if terrain.wet is None else terrain.wet.share,
        film_factor=(red, green, blue),
    )
