"""Organs seen from far: each sheet as one triangle of the same area, and few wide needles for many narrow ones.

Whatever is much smaller than a pixel shows its area, its attitude and its place, not its outline. A triangle along a
sheet's longest extent, across its mean normal, keeps these three. Where an organ has many sheets, as a twig has
needles, some stand for the rest, wider by what is left out, so that the area stays (Cook et al. 2007, see
plants/levels.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TRIANGLE_PIXELS = 0.7  # sheets up to this long become triangles
_SMALLEST = 0.15  # of the largest sheet's area: smaller ones lend theirs to the others
_FEWEST_SHEETS = 24  # of an organ with many; fewer would cover one another less
_ROUNDEST = 1.15  # greatest width over length of a triangle: equal sides


@dataclass(frozen=True)
class _Sheets:
    """The connected pieces of a mesh that have an edge."""

    faces: Bools  # (F,) faces of the mesh that belong to them
    area_m2: Floats  # (C,)
    centre_m: Floats  # (C, 3) of the area
    normal: Floats  # (C, 3) unit, the mean of the faces'
    along: Floats  # (C, 3) unit, across the normal, along the longest extent
    length_m: Floats  # (C,) that extent
    uv: NDArray[np.float32] | None  # (C, 2) mean


def far_piece(mesh: Mesh, pixel_m: float) -> Mesh:
    """A piece of an organ as it is seen where a pixel covers at least `pixel_m` of it; the area stays.

    Bodies without an edge, and sheets longer than `TRIANGLE_PIXELS`, stay as they are.
    """
    if pixel_m <= 0.0 or not mesh.triangles:
        return mesh
    sheets = _sheets(mesh, TRIANGLE_PIXELS * pixel_m)
    if not len(sheets.area_m2):
        return mesh
    chosen, width, length = _chosen(sheets)
    slivers = _slivers(sheets, chosen, length, width)
    if len(chosen) >= np.count_nonzero(sheets.faces):
        return mesh
    return _beside(slivers, mesh, ~sheets.faces)


def _chosen(sheets: _Sheets) -> tuple[Ints, Floats, Floats]:
    """Which sheets remain, and the width and length of the triangles that stand for all."""
    area = sheets.area_m2
    large = np.flatnonzero(area >= _SMALLEST * area.max())  # a leaf without its stalk
    length = np.maximum(sheets.length_m, 1e-9)
    slim = float(np.median(2.0 * area[large] / length[large] ** 2))  # width over length of a triangle
    count = max(slim / _ROUNDEST * len(large), float(min(_FEWEST_SHEETS, len(large))))
    order = np.argsort(child_rng(0, "far piece").random(len(large)))
    chosen = np.sort(large[order[: max(1, round(count))]])
    shown = area[chosen] * (area.sum() / area[chosen].sum())
    length = np.maximum(length[chosen], np.sqrt(2.0 * shown / _ROUNDEST))  # none is wider than long
    return chosen, 2.0 * shown / length, length


def _sheets(mesh: Mesh, longest_m: float) -> _Sheets:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces = mesh.faces.astype(np.int64)
    points = mesh.vertices_m.astype(np.float64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(points), len(points)))
    count, found = connected_components(graph, directed=False)
    of_vertex = found.astype(np.int64)
    _, which, times = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    open_edge = times[which.reshape(-1)] == 1
    has_edge = np.zeros(count, dtype=bool)
    has_edge[of_vertex[edges[open_edge, 0]]] = True

    of_face = of_vertex[faces[:, 0]]
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = 0.5 * np.cross(b - a, c - a)
    face_area = np.linalg.norm(cross, axis=1)
    area = np.bincount(of_face, weights=face_area, minlength=count)
    weight = np.maximum(area, 1e-30)[:, None]
    centre = _sums(of_face, (a + b + c) / 3.0 * face_area[:, None], count) / weight
    spread = np.zeros((count, 3, 3))
    offset = points - centre[of_vertex]
    np.add.at(spread, of_vertex, offset[:, :, None] * offset[:, None, :])
    axes = np.linalg.eigh(spread)[1]
    normal = _sums(of_face, cross, count)
    size = np.linalg.norm(normal, axis=1)
    normal = np.where((size > 0.1 * area)[:, None], normal / np.maximum(size, 1e-30)[:, None], axes[:, :, 0])
    along = axes[:, :, 2] - np.sum(axes[:, :, 2] * normal, axis=1, keepdims=True) * normal
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    place = np.sum(offset * along[of_vertex], axis=1)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, of_vertex, place)
    np.maximum.at(high, of_vertex, place)
    length = high - low
    chosen = has_edge & (length <= longest_m) & (area > 0.0) & (np.linalg.norm(along, axis=1) > 0.5)
    uv = None
    if mesh.uv is not None:
        vertices = np.maximum(np.bincount(of_vertex, minlength=count), 1)[:, None]
        uv = (_sums(of_vertex, mesh.uv.astype(np.float64), count) / vertices).astype(np.float32)[chosen]
    return _Sheets(chosen[of_face], area[chosen], centre[chosen], normal[chosen], along[chosen], length[chosen], uv)


def _sums(owner: Ints, values: Floats, count: int) -> Floats:
    """(count, K) sums of the (N, K) values of each owner."""
    return np.stack([np.bincount(owner, weights=column, minlength=count) for column in values.T], axis=1)


def _slivers(sheets: _Sheets, chosen: Ints, length: Floats, width: Floats) -> Mesh:
    """A triangle for each chosen sheet, its middle where the sheet's is."""
    along, normal, centre = sheets.along[chosen], sheets.normal[chosen], sheets.centre_m[chosen]
    tip = along * (length[:, None] / 3.0)
    side = np.cross(along, normal) * (0.5 * width[:, None])
    corners = np.stack([centre - tip - side, centre - tip + side, centre + 2.0 * tip], axis=1).astype(np.float32)
    return Mesh(
        corners.reshape(-1, 3),
        np.arange(3 * len(chosen), dtype=np.uint32).reshape(-1, 3),
        np.repeat(normal, 3, axis=0).astype(np.float32),
        None if sheets.uv is None else np.repeat(sheets.uv[chosen], 3, axis=0),
    )


def _beside(slivers: Mesh, mesh: Mesh, kept: Bools) -> Mesh:
    """The slivers and the faces of the mesh that stay."""
    if not kept.any():
        return slivers
    faces = mesh.faces[kept]
    used = np.unique(faces)
    number = np.zeros(len(mesh.vertices_m), dtype=np.uint32)
    number[used] = np.arange(len(used), dtype=np.uint32) + np.uint32(len(slivers.vertices_m))
    normals = None if mesh.normals is None or slivers.normals is None else [slivers.normals, mesh.normals[used]]
    uv = None if mesh.uv is None or slivers.uv is None else [slivers.uv, mesh.uv[used]]
    return Mesh(
        np.concatenate([slivers.vertices_m, mesh.vertices_m[used]]),
        np.concatenate([slivers.faces, number[faces]]),
        None if normals is None else np.concatenate(normals),
        None if uv is None else np.concatenate(uv),
    )
