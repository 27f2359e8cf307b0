"""Meshes cut along a contour of a value that is known at their vertices, and meshes with finer triangles."""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Bools, Floats, Ints, Mesh, part_of


def bisected(mesh: Mesh, chosen: Bools) -> tuple[Mesh, Ints]:
    """The mesh with each chosen face in two, across its longest edge, and (F',) the face that each face is part of.

    New vertices lie on the middles of edges: the surface stays, also where a neighbour is not chosen.
    """
    faces = mesh.faces[chosen].astype(np.int64)
    longest = np.argmax(edge_lengths_m(mesh, faces), axis=1)
    a, b, c = np.take_along_axis(faces, (longest[:, None] + np.arange(3)) % 3, axis=1).T
    ends, which = np.unique(np.sort(np.column_stack([a, b]), axis=1), axis=0, return_inverse=True)
    whole, middle = _with_vertices(mesh, ends, np.full(len(ends), 0.5)), len(mesh.vertices_m) + which.reshape(-1)
    halves = np.concatenate([np.column_stack([a, middle, c]), np.column_stack([middle, b, c])]).astype(np.uint32)
    own = np.flatnonzero(chosen)
    origin = np.concatenate([np.flatnonzero(~chosen), own, own])
    return Mesh(whole.vertices_m, np.concatenate([mesh.faces[~chosen], halves]), whole.normals, whole.uv), origin


def edge_lengths_m(mesh: Mesh, faces: Ints) -> Floats:
    """(F, 3) lengths of the edges of faces: from the first corner, the second and the third."""
    corners = mesh.vertices_m[faces].astype(np.float64)
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def cut(mesh: Mesh, value: Floats) -> tuple[tuple[Mesh, Ints], tuple[Mesh, Ints]]:
    """The parts of a mesh where (V,) values, straight between vertices, are at most 0 and above; each may be empty.

    With each part (F',) the face that each of its faces is part of.
    """
    above = (value > 0.0)[mesh.faces]
    count = above.sum(axis=1)
    mixed = np.flatnonzero((count == 1) | (count == 2))
    alone = np.where(count[mixed] == 1, np.argmax(above[mixed], axis=1), np.argmin(above[mixed], axis=1))
    turned = (alone[:, None] + np.arange(3)) % 3  # the corner that is alone comes first
    a, b, c = np.take_along_axis(mesh.faces[mixed].astype(np.int64), turned, axis=1).T
    ends = np.concatenate([np.column_stack([a, b]), np.column_stack([a, c])])
    share = value[ends[:, 0]] / (value[ends[:, 0]] - value[ends[:, 1]])
    whole = _with_vertices(mesh, ends, share)
    p, q = len(mesh.vertices_m) + np.arange(2 * len(mixed)).reshape(2, -1)
    tip = np.column_stack([a, p, q])
    rest = np.concatenate([np.column_stack([p, b, c]), np.column_stack([p, c, q])])
    tip_above = count[mixed] == 1
    made = []
    for side in (False, True):
        plain = np.flatnonzero(count == (3 if side else 0))
        tips, rests = tip_above == side, np.tile(tip_above != side, 2)
        faces = np.concatenate([mesh.faces[plain], tip[tips], rest[rests]]).astype(np.uint32)
        origin = np.concatenate([plain, mixed[tips], np.tile(mixed, 2)[rests]])
        made.append((part_of(whole, faces), origin))
    return made[0], made[1]


def _with_vertices(mesh: Mesh, ends: Ints, share: Floats) -> Mesh:
    """The mesh with more vertices: on (N, 2) edges, so far from the first end to the second."""

    def more(values: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> Floats:
        return np.asarray(
            values[ends[:, 0]] + share[:, None] * (values[ends[:, 1]].astype(np.float64) - values[ends[:, 0]])
        )

    normals = uv = None
    if mesh.normals is not None:
        fresh = more(mesh.normals)
        fresh /= np.maximum(np.linalg.norm(fresh, axis=1, keepdims=True), 1e-9)
        normals = np.concatenate([mesh.normals, fresh.astype(np.float32)])
    if mesh.uv is not None:
        uv = np.concatenate([mesh.uv, more(mesh.uv).astype(np.float32)])
    return Mesh(np.concatenate([mesh.vertices_m, more(mesh.vertices_m).astype(np.float32)]), mesh.faces, normals, uv)
