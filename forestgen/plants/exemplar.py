"""The contract between plants and scene: one plant's geometry, ready to be instanced."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh


@dataclass(frozen=True)
class OrganMesh:
    """All surfaces of one part and one material."""

    part: Part
    material: str  # key into the species' materials
    mesh: Mesh
    mark: NDArray[np.uint32] | None = None  # (F,) `Skeleton.mark` of what each triangle is part of; None: unknown


@dataclass(frozen=True)
class Exemplar:
    """Geometry of one plant in its own frame: origin at the stem base, z up, metres."""

    species: str
    organs: tuple[OrganMesh, ...]
    radius_m: float  # community radius that it was grown for
    height_m: float  # top of its geometry
    crown_width_m: float  # mean of its geometry's extents in x and y
    leaf_area_m2: float  # one side of all blades, petioles of the blade's own material included
    wood_volume_m3: float  # of the skeleton, see `Skeleton.volume_m3`
    is_unique: bool = False  # of one plant alone, with that plant's own branches

    @property
    def triangles(self) -> int:
        return sum(organ.mesh.triangles for organ in self.organs)

    @property
    def nbytes(self) -> int:
        """Of its arrays."""
        meshes = [organ.mesh for organ in self.organs]
        arrays = [one for mesh in meshes for one in (mesh.vertices_m, mesh.faces, mesh.normals, mesh.uv)]
        return sum(one.nbytes for one in (*arrays, *(organ.mark for organ in self.organs)) if one is not None)

    def marks(self) -> NDArray[np.uint32] | None:
        """(F,) marks of all triangles, the organs one after another; None if the plant has none."""
        known = [organ.mark for organ in self.organs if organ.mark is not None]
        return np.concatenate(known) if len(known) == len(self.organs) else None

    def bounds_m(self) -> NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        corners = [organ.mesh.vertices_m for organ in self.organs if len(organ.mesh.vertices_m)]
        low = np.min([c.min(axis=0) for c in corners], axis=0)
        high = np.max([c.max(axis=0) for c in corners], axis=0)
        return np.stack([low, high]).astype(np.float64)
