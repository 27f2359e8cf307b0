"""Fewer triangles for far views.

Reference
---------
Garland, M., Heckbert, P. S. (1997). Surface simplification using quadric error metrics. SIGGRAPH 1997, 209-216; as in
MeshLab, through pymeshlab.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.vectors import vertex_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROUNDS = 20


def decimate(mesh: Mesh, target_triangles: int) -> Mesh:
    """The mesh with about `target_triangles` triangles, by collapses of edges.

    Vertices of equal position are merged first. Closed bodies stay closed, keep at least four triangles each, and keep
    their volumes: a collapse thins a tube, so every body is widened along its normals until its volume is back. A body
    is what hangs together; several tubes that run through one another are several bodies. The target is missed where
    the bodies are too many for it.

    Returns
    -------
    mesh : new normals, no uv.
    """
    vertices, faces = merged(mesh)
    body = _bodies(len(vertices), faces)
    if target_triangles < len(faces):
        before = np.where(_closed(faces, body), _volumes(vertices, faces, body), np.nan)
        vertices, faces, body = _collapsed(vertices, faces, body, max(target_triangles, 4))
        vertices = _restored(vertices, faces, body, before)
    single = vertices.astype(np.float32)
    normals = vertex_normals(single.astype(np.float64), faces)
    return Mesh(single, faces.astype(np.uint32), normals.astype(np.float32))


def merged(mesh: Mesh) -> tuple[Floats, Ints]:
    """Vertices (V, 3) and faces (F, 3) with vertices of equal position made one, and faces that lost a corner dropped.

    The vertices come in the order in which the mesh first names them.
    """
    _, first, inverse = np.unique(mesh.vertices_m, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    faces = rank[inverse.reshape(-1)][mesh.faces.astype(np.int64)]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return mesh.vertices_m[first[order]].astype(np.float64), faces[whole]


def _bodies(count: int, faces: Ints) -> Ints:
    """(V,) number of the connected body that each vertex belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _closed(faces: Ints, body: Ints) -> NDArray[np.bool_]:
    """(B,) whether every edge of a body is walked as often one way as the other."""
    count = int(body.max(initial=-1)) + 1
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    there, back = start * len(body) + end, end * len(body) + start
    ways, seen = np.unique(there, return_counts=True)
    at = np.minimum(np.searchsorted(ways, back), len(ways) - 1)
    alone = (ways[at] != back) | (seen[at] != seen[np.searchsorted(ways, there)])
    is_closed = np.ones(count, dtype=np.bool_)
    is_closed[body[start[alone]]] = False
    return is_closed


def _collapsed(vertices: Floats, faces: Ints, body: Ints, target: int) -> tuple[Floats, Ints, Ints]:
    import pymeshlab  # type: ignore[import-untyped]

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32), v_scalar_array=body.astype(np.float64)))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=target, preservetopology=True, preserveboundary=True, preservenormal=True
    )
    result = meshes.current_mesh()
    return (
        np.array(result.vertex_matrix(), dtype=np.float64),
        np.array(result.face_matrix(), dtype=np.int64),
        np.rint(result.vertex_scalar_array()).astype(np.int64),
    )


def _corners(vertices: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    return vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]


def _volumes(vertices: Floats, faces: Ints, body: Ints, count: int | None = None) -> Floats:
    """(B,) signed volumes; each body is measured from its first corner, so that distance costs no digits."""
    count = int(body.max(initial=-1)) + 1 if count is None else count
    of_face = body[faces[:, 0]]
    origin = np.zeros((count, 3))
    origin[of_face[::-1]] = vertices[faces[::-1, 0]]
    a, b, c = (corner - origin[of_face] for corner in _corners(vertices, faces))
    volumes: Floats = np.bincount(of_face, np.sum(a * np.cross(b, c), axis=1) / 6.0, minlength=count).astype(np.float64)
    return volumes


def _restored(vertices: Floats, faces: Ints, body: Ints, volume: Floats) -> Floats:
    """Vertices moved along their normals until each body has the volume given; NaN: it stays as it is."""
    of_face, count = body[faces[:, 0]], len(volume)
    known = np.isfinite(volume)
    for _ in range(_ROUNDS):
        a, b, c = _corners(vertices, faces)
        area = np.bincount(of_face, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0, minlength=count)
        missing = volume - _volumes(vertices, faces, body, count)
        offset = np.where(known & (area > 0.0), missing / np.maximum(area, 1e-300), 0.0)
        vertices = vertices + offset[body, None] * vertex_normals(vertices, faces)
    return vertices
