"""Meshes: joined, instanced, measured, their normals and convex hulls; and small vector algebra."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UP = np.array([0.0, 0.0, 1.0])
GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))  # turn from leaf to leaf that fills the circle most evenly


@dataclass(frozen=True)
class Mesh:
    """Triangles. Winding is counter-clockwise seen from outside; blades are sheets, seen from their upper side."""

    vertices_m: NDArray[np.float32]  # (V, 3) metres, the owner's frame
    faces: NDArray[np.uint32]  # (F, 3) indices into vertices
    normals: NDArray[np.float32] | None = None  # (V, 3) unit, or None for flat facets
    uv: NDArray[np.float32] | None = None  # (V, 2)

    def __post_init__(self) -> None:
        count = len(self.vertices_m)
        wanted = {"vertices_m": (count, 3), "faces": (len(self.faces), 3), "normals": (count, 3), "uv": (count, 2)}
        for name, shape in wanted.items():
            array, kind = getattr(self, name), np.dtype(np.uint32 if name == "faces" else np.float32)
            if array is not None and (array.shape != shape or array.dtype != kind):
                raise ValueError(f"{name} must be {shape} {kind}, got {array.shape} {array.dtype}")

    @property
    def triangles(self) -> int:
        return len(self.faces)


def triangle_areas(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Floats:
    """(F,) areas of the triangles of (V, 3) vertices, one side."""
    first, second, third = np.ascontiguousarray(faces.T)
    axes = vertices.T.astype(np.float64)
    (ux, uy, uz), (vx, vy, vz) = ([axis[to] - axis[first] for axis in axes] for to in (second, third))
    return np.asarray(np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2) / 2.0)


def surface_area_m2(mesh: Mesh) -> float:
    """Sum of the triangles' areas, one side."""
    return float(triangle_areas(mesh.vertices_m, mesh.faces).sum())


def instance(template: Mesh, frames: NDArray[np.float32]) -> Mesh:
    """One mesh of the template, which has normals, under M transforms.

    `frames`: (M, 3, 4) organ frame -> plant frame: rotation times uniform scale, and translation in metres.
    """
    if template.normals is None:
        raise ValueError("the template needs normals")
    count = len(template.vertices_m)
    linear = frames[:, :, :3]
    to_plant = linear.transpose(0, 2, 1)
    vertices = template.vertices_m @ to_plant + frames[:, None, :, 3]
    scale = np.cbrt(np.linalg.det(linear.astype(np.float64))).astype(np.float32)
    normals = template.normals @ (to_plant / scale[:, None, None])
    faces = template.faces[None] + (np.arange(len(frames), dtype=np.uint32) * np.uint32(count))[:, None, None]
    uv = None if template.uv is None else np.tile(template.uv, (len(frames), 1))
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), normals.reshape(-1, 3), uv)


def concatenate(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several that all have normals; uv if one has it, and zeros for those that have not."""
    if len(meshes) == 1 and meshes[0].normals is not None:
        return meshes[0]
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    normals = [mesh.normals for mesh in meshes if mesh.normals is not None]
    if len(normals) != len(meshes):
        raise ValueError("every mesh needs normals")
    uv = None
    if any(mesh.uv is not None for mesh in meshes):
        uv = np.concatenate(
            [mesh.uv if mesh.uv is not None else np.zeros((len(mesh.vertices_m), 2), np.float32) for mesh in meshes]
        )
    return Mesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.faces + np.uint32(s) for mesh, s in zip(meshes, starts, strict=False)]),
        np.concatenate(normals),
        uv,
    )


def part_of(mesh: Mesh, faces: NDArray[np.uint32]) -> Mesh:
    """Some (F, 3) faces of a mesh with the vertices that they need."""
    used = np.zeros(len(mesh.vertices_m), dtype=bool)
    used[faces] = True
    row = np.cumsum(used, dtype=np.uint32) - np.uint32(1)
    normals, uv = (None if one is None else one[used] for one in (mesh.normals, mesh.uv))
    return Mesh(mesh.vertices_m[used], row[faces], normals, uv)


def unit(vectors: Floats) -> Floats:
    """(..., 3) vectors of length 1; a zero vector stays zero."""
    length = np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True))
    scaled: Floats = vectors / np.where(length > 0.0, length, 1.0)
    return scaled


def any_perpendicular(vectors: Floats) -> Floats:
    """(N, 3) unit vectors perpendicular to unit `vectors`, taken against the world axis that is least aligned."""
    helper = np.eye(3)[np.argmin(np.abs(vectors), axis=-1)]
    return unit(np.cross(vectors, helper))


def rotate(vectors: Floats, axis: Floats, angle_rad: Floats) -> Floats:
    """Rodrigues' rotation of (N, 3) `vectors` about (N, 3) unit `axis` by (N,) radians, right-handed."""
    c, s = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    along = np.sum(axis * vectors, axis=1, keepdims=True) * axis
    turned: Floats = vectors * c + np.cross(axis, vectors) * s + along * (1.0 - c)
    return turned


def vertex_normals(vertices: Floats, faces: NDArray[np.integer]) -> Floats:
    """(V, 3) unit normals, each the mean of the adjoining faces weighted by their areas."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    weighted = np.cross(b - a, c - a)
    total = np.empty_like(vertices)
    for axis in range(3):
        total[:, axis] = np.bincount(
            faces.reshape(-1), weights=np.repeat(weighted[:, axis], 3), minlength=len(vertices)
        )
    normals = unit(total)
    normals[np.all(normals == 0.0, axis=1)] = (0.0, 0.0, 1.0)
    return normals


@dataclass(frozen=True)
class Hull:
    """Points whose convex hull is the mesh's, and edges between them that hold every edge of that hull."""

    vertices_m: NDArray[np.float64]  # (V, 3)
    edges: NDArray[np.int64]  # (E, 2) indices of vertices


def hull_of(meshes: Sequence[Mesh]) -> Hull:
    """Hull of all triangles of `meshes` (Qhull; Barber, Dobkin and Huhdanpaa 1996). O(V log V).

    Meshes that are flat, or too small for Qhull, keep all their vertices and all edges of their triangles.
    """
    from scipy.spatial import ConvexHull, QhullError

    vertices, triangles, count = [], [], 0
    for mesh in meshes:
        used = np.zeros(len(mesh.vertices_m), dtype=np.bool_)
        used[mesh.faces] = True
        vertices.append(mesh.vertices_m[used].astype(np.float64))
        triangles.append((np.cumsum(used) - 1)[mesh.faces] + count)
        count += len(vertices[-1])
    if not count:
        return Hull(np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64))
    points, corners = np.concatenate(vertices), np.concatenate(triangles)
    if count > 3:
        with suppress(QhullError):
            corners = ConvexHull(points).simplices.astype(np.intp)
    kept, index = np.unique(corners, return_inverse=True)
    corners = index.reshape(-1, 3)
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return Hull(points[kept], np.unique(edges, axis=0).astype(np.int64))
