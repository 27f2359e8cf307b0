"""Many plants as one mesh, for where each is a few pixels: large triangles instead of leaves, frusta instead of stems.

Leaves, branches, flowers and fruits become equilateral triangles, each where a point of the plant's surface is, chosen
with equal chance by area, and across the surface's normal there. Their area is the plant's: of leaves that of their
blades, of twigs half of their surface, for what a rod hides from any side is that of a sheet of half its surface on the
mean. A stem is a frustum from its foot to its top of its own surface.

References
----------
Cook, R. L., Halstead, J., Planck, M., Ryu, D. (2007). Stochastic simplification of aggregate detail. ACM Transactions
on Graphics 26(3), article 79, section 3.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Floats, Mesh, triangle_areas
from forestgen.plants.exemplar import Exemplar, OrganMesh

SPECIES = "(surroundings)"  # of the meshes: no species' name has brackets
_STEM_SIDES = 6
_STEM_TAPER = 0.3  # radius of a stem's top by that of its foot
_FEWEST = 3  # triangles of a stem: a smaller one becomes sheets, too


def areas_m2(exemplar: Exemplar) -> list[Floats]:
    """Of each organ mesh, the areas of its triangles."""
    return [triangle_areas(organ.mesh.vertices_m, organ.mesh.faces) for organ in exemplar.organs]


def sheet_areas_m2(exemplar: Exemplar, areas: Sequence[Floats]) -> list[float]:
    """Of each organ mesh, with its triangles' `areas_m2`: the area of the sheets that hide as much."""
    whole = [float(one.sum()) for one in areas]
    blades = sum(area for area, organ in zip(whole, exemplar.organs, strict=True) if organ.part == Part.LEAF)
    share = {Part.LEAF: min(exemplar.leaf_area_m2 / max(blades, 1e-12), 1.0), Part.FLOWER: 1.0}
    return [share.get(organ.part, 0.5) * area for area, organ in zip(whole, exemplar.organs, strict=True)]


def thinned(
    exemplar: Exemplar, areas: Sequence[Floats], grain_m2: float, rng: np.random.Generator
) -> tuple[OrganMesh, ...]:
    """The organs of a plant as triangles of about an area; `areas` are its triangles' `areas_m2`."""
    rows = list(zip(exemplar.organs, areas, sheet_areas_m2(exemplar, areas), strict=True))
    stem = [(area, organ) for organ, _, area in rows if organ.part == Part.TRUNK]  # one of each bark and cover
    stem_m2 = sum(area for area, _ in stem)
    is_frustum = stem_m2 > _FEWEST * grain_m2
    largest = max(stem, key=lambda one: one[0])[1] if stem else None
    organs = []
    for organ, faces, area in rows:
        if organ is largest and is_frustum:
            corners = _frustum(np.concatenate([one.mesh.vertices_m for _, one in stem]), 2.0 * stem_m2)
        elif organ.part == Part.TRUNK and is_frustum:
            continue
        else:
            corners = _sheets(organ.mesh, faces, area, grain_m2, rng)
        organs.append(OrganMesh(organ.part, f"{exemplar.species}/{organ.material}", _soup(corners)))
    return tuple(organs)


def _sheets(mesh: Mesh, faces_m2: Floats, area_m2: float, grain_m2: float, rng: np.random.Generator) -> Floats:
    """Equilateral triangles of one size, `area_m2` together; none for a mesh without area."""
    if area_m2 <= 0.0:
        return np.zeros((0, 3, 3))
    count = max(1, round(area_m2 / grain_m2))
    areas = np.cumsum(faces_m2)
    chosen = np.searchsorted(areas, (np.arange(count) + rng.random(count)) / count * areas[-1])
    a, b, c = mesh.vertices_m[mesh.faces[np.minimum(chosen, len(areas) - 1)]].astype(np.float64).transpose(1, 0, 2)
    root, along = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    middle = (1.0 - root) * a + root * ((1.0 - along) * b + along * c)  # even over the triangle
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    beside = np.cross(normal, np.where(np.abs(normal[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    beside /= np.maximum(np.linalg.norm(beside, axis=1, keepdims=True), 1e-30)
    turn = 2.0 * np.pi * (rng.random((count, 1)) + np.arange(3) / 3.0)
    reach = np.sqrt(4.0 / np.sqrt(27.0) * area_m2 / count)
    corner = np.cos(turn)[..., None] * beside[:, None] + np.sin(turn)[..., None] * np.cross(normal, beside)[:, None]
    return np.asarray(middle[:, None] + reach * corner)


def _frustum(vertices_m: NDArray[np.float32], area_m2: float) -> Floats:
    """The sides of a frustum of an area, from the foot of a stem's vertices to their top."""
    points = vertices_m.astype(np.float64)
    low, high = np.percentile(points[:, 2], [10.0, 90.0])
    foot, top = points[points[:, 2] <= low].mean(axis=0), points[points[:, 2] >= high].mean(axis=0)
    foot[2], top[2] = points[:, 2].min(), points[:, 2].max()
    radius = 2.0 * area_m2 / (_STEM_SIDES * (1.0 + _STEM_TAPER) * np.linalg.norm(top - foot))
    angle = 2.0 * np.pi * np.arange(_STEM_SIDES) / _STEM_SIDES
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_STEM_SIDES)], axis=1) * radius
    below, above = foot + ring, top + _STEM_TAPER * ring
    next_below, next_above = np.roll(below, -1, axis=0), np.roll(above, -1, axis=0)
    sides = [np.stack(one, axis=1) for one in ((below, next_below, next_above), (below, next_above, above))]
    return np.concatenate(sides)


def far_mesh(plants: Iterable[tuple[Exemplar, Floats]]) -> Exemplar:
    """Many plants as one mesh: their `thinned` organs, and (N, 3, 4) transforms from their frame to the mesh's."""
    corners: dict[tuple[Part, str], list[Floats]] = defaultdict(list)
    leaf_area = wood_volume = 0.0
    for exemplar, transform in plants:
        for organ in exemplar.organs:
            moved = organ.mesh.vertices_m @ transform[:, :, :3].transpose(0, 2, 1) + transform[:, None, :, 3]
            corners[organ.part, organ.material].append(moved.reshape(-1, 3))
        volume = np.abs(np.linalg.det(transform[:, :, :3]))
        leaf_area += exemplar.leaf_area_m2 * float(np.sum(np.cbrt(volume) ** 2))
        wood_volume += exemplar.wood_volume_m3 * float(np.sum(volume))
    organs = tuple(OrganMesh(*key, _soup(np.concatenate(parts))) for key, parts in corners.items())
    points = np.concatenate([organ.mesh.vertices_m for organ in organs])
    width = float(np.ptp(points[:, :2], axis=0).mean())
    return Exemplar(SPECIES, organs, 0.5 * width, float(points[:, 2].max()), width, leaf_area, wood_volume)


def _soup(corners_m: Floats) -> Mesh:
    """Triangles that share no vertices, of their corners."""
    vertices = corners_m.reshape(-1, 3).astype(np.float32)
    return Mesh(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))
