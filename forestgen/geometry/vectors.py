"""Small vector algebra on arrays of 3-vectors, and joins of meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh

Floats = NDArray[np.float64]


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
