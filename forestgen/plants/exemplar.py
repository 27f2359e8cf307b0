"""The contract between plants and scene: one plant's geometry, ready to be instanced; and plants as their silhouettes.

As solids (Lane 2002, Figure 6.2a) a crown is what its silhouette curve sweeps round the stem, a stem a cone frustum
below it: for looking at a stand before its plants are grown, and for amodal or silhouette studies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Floats, Mesh, surface_area_m2, vertex_normals
from forestgen.plants.skeleton import OrganPlacements


@dataclass(frozen=True)
class OrganMesh:
    """All surfaces of one part and one material."""

    part: Part
    material: str  # key into the species' materials
    mesh: Mesh
    mark: NDArray[np.uint32] | None = None  # (F,) `Skeleton.mark` of what each triangle is part of; None: unknown
    organ: NDArray[np.int32] | None = None  # (F,) number among all of `Exemplar.foliage`; -1: wood; None: all is wood


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
    lying_m3: float = 0.0  # volume of a dead tree's stem that lies on the ground
    has_weather_side: bool = False  # what grows on its stem does so on one side
    roots_m: float = 0.0  # height up to which roots run out from its stem; 0: it has none above the ground
    foliage: tuple[OrganPlacements, ...] = ()  # its leaves, flowers and fruits, where it has all detail

    @property
    def triangles(self) -> int:
        return sum(organ.mesh.triangles for organ in self.organs)

    @property
    def nbytes(self) -> int:
        """Of its arrays."""
        meshes = [organ.mesh for organ in self.organs]
        arrays: list[NDArray[Any] | None] = [
            one for mesh in meshes for one in (mesh.vertices_m, mesh.faces, mesh.normals, mesh.uv)
        ]
        arrays += [one for organ in self.organs for one in (organ.mark, organ.organ)]
        arrays += [one for placed in self.foliage for one in (placed.frame, placed.node)]
        twigs = [placed.twigs for placed in self.foliage if placed.twigs is not None]
        arrays += [one for each in twigs for one in (each.ends_m, each.radius_m, each.organ)]
        return sum(one.nbytes for one in arrays if one is not None)

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


_SIDES = 32
_LEVELS = 40  # rings of a measured profile
_REACH = 98.0  # percentile of the distances from the stem: single twigs do not make the form
_THIN_M = 1e-4


def solid_of_revolution(height_m: Floats, radius_m: Floats) -> Mesh:
    """Closed surface about the z axis.

    `height_m`: (K,) ascending, at least two. `radius_m`: (K,) at each height; the ends are capped.
    """
    angle = np.arange(_SIDES) * (2.0 * np.pi / _SIDES)
    radius = np.maximum(radius_m, _THIN_M)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    walls = np.concatenate(
        [radius[:, None, None] * ring, np.broadcast_to(height_m[:, None, None], (len(radius), _SIDES, 1))], axis=2
    ).reshape(-1, 3)
    ends = np.array([[0.0, 0.0, height_m[0]], [0.0, 0.0, height_m[-1]]])
    vertices = np.concatenate([walls, ends])
    around = np.arange(_SIDES)
    beyond = np.roll(around, -1)
    start = np.arange(len(radius) - 1)[:, None] * _SIDES
    bottom, top, last = len(walls), len(walls) + 1, (len(radius) - 1) * _SIDES
    corners = (
        (start + around, start + beyond, start + _SIDES + beyond),
        (start + around, start + _SIDES + beyond, start + _SIDES + around),
        (beyond, around, np.full(_SIDES, bottom)),
        (last + around, last + beyond, np.full(_SIDES, top)),
    )
    faces = np.concatenate([np.stack(one, axis=-1).reshape(-1, 3) for one in corners])
    normals = vertex_normals(vertices, faces)
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32), normals.astype(np.float32))


def measured_profile(vertices_m: Floats) -> tuple[Floats, Floats]:
    """Heights (K,) and radii (K,) of the solid that holds 98% of a plant's (V, 3) vertices at each height."""
    low, high = float(vertices_m[:, 2].min()), float(vertices_m[:, 2].max())
    edges = np.linspace(low, high, _LEVELS + 1)
    level = np.clip(np.searchsorted(edges, vertices_m[:, 2], side="right") - 1, 0, _LEVELS - 1)
    distance = np.hypot(vertices_m[:, 0], vertices_m[:, 1])
    filled = np.unique(level)
    reach = np.array([np.percentile(distance[level == one], _REACH) for one in filled])
    middle = 0.5 * (edges[filled] + edges[filled + 1])
    return np.concatenate([[low], middle, [high]]), np.concatenate([[0.5 * reach[0]], reach, [0.0]])


def as_solids(exemplar: Exemplar, profile: tuple[Floats, Floats] | None = None) -> Exemplar:
    """The exemplar with a solid for its crown and a frustum for its stem; area and volume stay the plant's.

    `profile`: (K,) heights and (K,) radii of the crown, metres; None: measured on the exemplar's leaves and flowers. A
    plant without leaves stays as it is.
    """
    leafy = [organ for organ in exemplar.organs if organ.part in (Part.LEAF, Part.FLOWER)]
    trunk = [organ for organ in exemplar.organs if organ.part == Part.TRUNK]  # one of each bark and cover
    if not leafy:
        return exemplar
    if profile is None:
        vertices_m = np.concatenate([organ.mesh.vertices_m for organ in leafy]).astype(np.float64)
        height_m, radius_m = measured_profile(vertices_m)
        profile = height_m, radius_m * (0.5 * exemplar.crown_width_m / radius_m.max())
    most = max(leafy, key=lambda organ: organ.mesh.triangles)
    organs = [OrganMesh(Part.LEAF, most.material, solid_of_revolution(*profile))]
    if trunk and profile[0][0] > 0.0:
        largest = max(trunk, key=lambda organ: surface_area_m2(organ.mesh))
        stem = _stem([organ.mesh for organ in trunk], float(profile[0][0]))
        organs.insert(0, OrganMesh(Part.TRUNK, largest.material, stem))
    return replace(exemplar, organs=tuple(organs), foliage=())


def _stem(trunk: Sequence[Mesh], crown_base_m: float) -> Mesh:
    """A frustum from below the ground into the crown, as thick as the trunk at breast height or a third of the way."""
    corners = np.concatenate([mesh.vertices_m.astype(np.float64)[mesh.faces] for mesh in trunk])
    radius = _girth_m(corners, min(1.3, crown_base_m / 3.0)) / (2.0 * np.pi)
    return solid_of_revolution(np.array([-0.3, crown_base_m + 2.0 * radius]), np.array([1.1 * radius, 0.8 * radius]))


def _girth_m(corners: Floats, height_m: float) -> float:
    """Length of the outline that (F, 3, 3) corners of triangles have at a height."""
    above = corners[:, :, 2] >= height_m
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossed], above[crossed]
    alone = np.where(above.sum(axis=1) == 1, np.argmax(above, axis=1), np.argmin(above, axis=1))
    first, second, third = (corners[np.arange(len(alone)), (alone + k) % 3] for k in range(3))
    ends = [
        first + ((height_m - first[:, 2]) / (other[:, 2] - first[:, 2]))[:, None] * (other - first)
        for other in (second, third)
    ]
    return float(np.linalg.norm(ends[1] - ends[0], axis=1).sum())
