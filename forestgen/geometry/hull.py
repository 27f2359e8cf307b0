"""Convex hulls of meshes: the points that bound every view of a plant."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh


@dataclass(frozen=True)
class Hull:
    """Points whose convex hull is the mesh's, and edges between them that hold every edge of that hull."""

    vertices_m: NDArray[np.float64]  # (V, 3)
    edges: NDArray[np.int64]  # (E, 2) indices of vertices


def hull_of(meshes: Sequence[Mesh]) -> Hull:
    """Hull of all triangles of `meshes` (Qhull; Barber, Dobkin and Huhdanpaa 1996). O(V log V).

    What is flat, or smaller than Qhull can tell, keeps all its vertices and all edges of its triangles: no fewer
    points bound it, and nothing is lost.
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
