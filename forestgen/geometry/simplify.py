"""Fewer triangles for programs that draw in real time, and the fine mesh's textures drawn into the coarse one's.

A coarse mesh gets an atlas: texture coordinates without overlap. Each of its texels is a place on the coarse mesh and
takes the colour of the nearest place on the fine one.

References
----------
Garland, M., Heckbert, P. S. (1997). Surface simplification using quadric error metrics. SIGGRAPH 1997, 209-216; as in
MeshLab, through pymeshlab.
xatlas, https://github.com/jpcy/xatlas: charts are grown over nearly flat regions, unfolded, and packed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.threads import cores
from forestgen.geometry.export import Piece, Surface, srgb
from forestgen.geometry.mesh import Floats, Ints, Mesh, concatenate, part_of, triangle_areas, vertex_normals

Image = NDArray[np.float32]

ATLAS_PX = 2048
_ROUNDS = 20
_MOST_PLACES = 2_000_000  # on the fine mesh, among which the nearest is looked for
_AT_ONCE = 4_000_000  # texels of triangles' boxes
_PADDING = 2  # texels between charts, in an atlas of one to two thousand texels a side


def decimate(mesh: Mesh, target_triangles: int) -> Mesh:
    """The mesh with about `target_triangles` triangles, by collapses of edges; new normals, no uv.

    Vertices of equal position are merged first. Closed bodies (connected components) stay closed, keep at least four
    triangles each, and keep their volumes: a collapse thins a tube, so every body is widened along its normals until
    its volume is back. The target is missed where there are too many bodies for it.
    """
    vertices, faces = merged(mesh)
    body = bodies(len(vertices), faces)
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


def bodies(count: int, faces: Ints) -> Ints:
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


def _volumes(vertices: Floats, faces: Ints, body: Ints, count: int | None = None) -> Floats:
    """(B,) signed volumes; each body is measured from its first corner, so that distance costs no digits."""
    count = int(body.max(initial=-1)) + 1 if count is None else count
    of_face = body[faces[:, 0]]
    origin = np.zeros((count, 3))
    origin[of_face[::-1]] = vertices[faces[::-1, 0]]
    a, b, c = (vertices[faces[:, k]] - origin[of_face] for k in range(3))
    volumes: Floats = np.bincount(of_face, np.sum(a * np.cross(b, c), axis=1) / 6.0, minlength=count).astype(np.float64)
    return volumes


def _restored(vertices: Floats, faces: Ints, body: Ints, volume: Floats) -> Floats:
    """Vertices moved along their normals until each body has the volume given; NaN: it stays as it is."""
    of_face, count = body[faces[:, 0]], len(volume)
    known = np.isfinite(volume)
    for _ in range(_ROUNDS):
        area = np.bincount(of_face, triangle_areas(vertices, faces), minlength=count)
        missing = volume - _volumes(vertices, faces, body, count)
        offset = np.where(known & (area > 0.0), missing / np.maximum(area, 1e-300), 0.0)
        vertices = vertices + offset[body, None] * vertex_normals(vertices, faces)
    return vertices


def unwrap(mesh: Mesh) -> Mesh:
    """The mesh with an atlas of its own: every point of the surface has its own place in the unit square.

    Vertices on the charts' edges are doubled; faces keep their number, order and place, and normals stay. The same mesh
    gives the same atlas. Tubes that repeat a texture have better coordinates from `sweep`.
    """
    import xatlas  # type: ignore[import-not-found]

    if not mesh.triangles:
        return Mesh(mesh.vertices_m, mesh.faces, mesh.normals, np.zeros((len(mesh.vertices_m), 2), np.float32))
    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices_m, mesh.faces, mesh.normals)
    packing = xatlas.PackOptions()
    packing.padding = _PADDING
    packing.create_image = False
    atlas.generate(xatlas.ChartOptions(), packing)
    source, faces, uv = atlas[0]
    return Mesh(
        mesh.vertices_m[source],
        np.ascontiguousarray(faces, dtype=np.uint32),
        None if mesh.normals is None else mesh.normals[source],
        np.clip(uv, 0.0, 1.0).astype(np.float32),
    )


def bake(coarse: Mesh, fine: Sequence[tuple[Mesh, Image]], size_px: int) -> Image:
    """(size_px, size_px, 3) colours of a coarse mesh's atlas, linear, row 0 at v = 0.

    Texels between the charts have the nearest one's colour. `coarse`: its uv is an atlas, see `unwrap`. `fine`: meshes
    near it, each with the texture that its uv repeat: (H, W, 3) linear, row 0 at v = 0.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import cKDTree

    row, column, place_m = _texels(coarse, size_px)
    texel_m = float(np.sqrt(triangle_areas(coarse.vertices_m, coarse.faces).sum() / max(len(row), 1)))
    places, colours = zip(*(_coloured_places(mesh, image, texel_m) for mesh, image in fine), strict=True)
    nearest = cKDTree(np.concatenate(places)).query(place_m, workers=cores())[1]
    image = np.zeros((size_px, size_px, 3), dtype=np.float32)
    image[row, column] = np.concatenate(colours)[nearest]
    empty = np.ones((size_px, size_px), dtype=np.bool_)
    empty[row, column] = False
    by_row, by_column = distance_transform_edt(empty, return_distances=False, return_indices=True)
    filled: Image = image[by_row, by_column]
    return filled


def _texels(mesh: Mesh, size_px: int) -> tuple[Ints, Ints, Floats]:
    """Rows and columns (T,) of the texels whose middle lies on a chart, and their places (T, 3)."""
    if mesh.uv is None:
        raise ValueError("a mesh without an atlas")
    corner = mesh.uv[mesh.faces].astype(np.float64) * size_px - 0.5  # (F, 3, 2): texel k has its middle at k
    low = np.maximum(np.ceil(corner.min(axis=1)), 0).astype(np.int64)
    count = np.maximum(np.minimum(np.floor(corner.max(axis=1)), size_px - 1).astype(np.int64) - low + 1, 0)
    in_box = count[:, 0] * count[:, 1]
    found = []
    chunk = np.cumsum(in_box) // _AT_ONCE
    for number in range(int(chunk[-1]) + 1 if len(chunk) else 0):
        face = np.flatnonzero(chunk == number)
        of = np.repeat(face, in_box[face])
        index = np.arange(len(of)) - np.repeat(np.cumsum(in_box[face]) - in_box[face], in_box[face])
        x = low[of, 0] + index % count[of, 0]
        y = low[of, 1] + index // count[of, 0]
        weight = _barycentric(corner[of], np.stack([x, y], axis=1).astype(np.float64))
        inside = np.all(weight >= 0.0, axis=1)
        corners_m = mesh.vertices_m[mesh.faces[of[inside]]].astype(np.float64)
        found.append((y[inside], x[inside], np.einsum("tk,tkd->td", weight[inside], corners_m)))
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3))
    row, column, place = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return row, column, place


def _barycentric(corner: Floats, point: Floats) -> Floats:
    """(T, 3) weights of the corners (T, 3, 2) at points (T, 2); negative ones outside, and in triangles of no area."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    (abx, aby), (acx, acy), (apx, apy) = ((q - a).T for q in (b, c, point))
    double = abx * acy - aby * acx
    flat = np.abs(double) < 1e-12
    safe = np.where(flat, 1.0, double)
    second, third = (apx * acy - apy * acx) / safe, (abx * apy - aby * apx) / safe
    return np.where(flat[:, None], -1.0, np.stack([1.0 - second - third, second, third], axis=1))


def _coloured_places(mesh: Mesh, image: Image, texel_m: float) -> tuple[Floats, Image]:
    """Places (P, 3) on a mesh, about half a texel apart, and their colours (P, 3)."""
    if mesh.uv is None:
        raise ValueError("a mesh without texture coordinates")
    area = triangle_areas(mesh.vertices_m, mesh.faces)
    step_m = max(0.5 * texel_m, float(np.sqrt(area.sum() / _MOST_PLACES)))
    rows = np.maximum(np.ceil(np.sqrt(area) / step_m), 1).astype(np.int64)  # a triangle's places are rows^2
    of = np.repeat(np.arange(len(rows)), rows**2)
    index = np.arange(len(of)) - np.repeat(np.cumsum(rows**2) - rows**2, rows**2)
    first, second = (index // rows[of] + 0.5) / rows[of], (index % rows[of] + 0.5) / rows[of]
    root = np.sqrt(first)  # a square, evenly mapped to the triangle (Turk 1990)
    weight = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    corner = mesh.faces[of]
    place = np.einsum("pk,pkd->pd", weight, mesh.vertices_m[corner].astype(np.float64))
    uv = np.einsum("pk,pkd->pd", weight, mesh.uv[corner].astype(np.float64))
    a, b, c = (mesh.uv[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    across = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    tiles = float((np.abs(across) / 2.0).sum())
    tile_px = np.sqrt(area.sum() / max(tiles, 1e-12)) / texel_m  # texels of the atlas along a tile
    small = _reduced(image, tile_px)
    at = np.floor(uv * small.shape[1::-1]).astype(np.int64) % np.array(small.shape[1::-1])
    return place, small[at[:, 1], at[:, 0]]


def _reduced(image: Image, tile_px: float) -> Image:
    """The image halved until it has about as many texels as the atlas shows of it: none is skipped."""
    while min(image.shape[:2]) > 1.5 * tile_px and min(image.shape[:2]) >= 2:
        even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
        image = (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2]) / np.float32(4)
    return image


def with_light_wood(pieces: Sequence[Piece], textures: Mapping[str, Image], triangles: int) -> tuple[Piece, ...]:
    """The pieces; those with a bark decimated to about `triangles` in all, with one atlas of their barks' colours.

    The relief is left out: from as far as such a plant is seen it does not show. Every twig keeps four triangles, so
    that a plant of many twigs keeps more than asked for.

    `textures`: (H, W, 3) linear, row 0 at v = 0, by the names of the pieces' surfaces; pieces of other surfaces stay.
    """
    wood = [piece for piece in pieces if piece.surface.name in textures]
    if not wood:
        return tuple(pieces)
    share = min(triangles / sum(piece.mesh.triangles for piece in wood), 1.0)
    coarse = [decimate(piece.mesh, round(share * piece.mesh.triangles)) for piece in wood]
    atlas = unwrap(concatenate(coarse))
    fine = [(piece.mesh, textures[piece.surface.name]) for piece in wood]
    image = srgb(bake(atlas, fine, ATLAS_PX))
    first = wood[0].surface
    surface = Surface("wood", first.reflectance, roughness=first.roughness, colour_image=image)
    ends = np.cumsum([mesh.triangles for mesh in coarse])
    light = {}
    for piece, start, end in zip(wood, [0, *ends], ends, strict=False):
        mesh = part_of(atlas, atlas.faces[start:end])
        area = {"area_m2": float(triangle_areas(mesh.vertices_m, mesh.faces).sum())}
        light[piece.name] = replace(piece, mesh=mesh, surface=surface, properties={**piece.properties, **area})
    return tuple(light.get(piece.name, piece) for piece in pieces)
