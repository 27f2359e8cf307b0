"""A repeating texture drawn once more, into the atlas of a mesh that stands for a finer one.

The atlas has texture coordinates without overlap. Each of its texels is a place on the coarse mesh; it takes the colour
of the nearest place on the fine one.

Reference
---------
xatlas, https://github.com/jpcy/xatlas: charts are grown over nearly flat regions, unfolded, and packed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.core.threads import cores
from forestgen.geometry.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Image = NDArray[np.float32]

_MOST_PLACES = 2_000_000  # on the fine mesh, among which the nearest is looked for
_AT_ONCE = 4_000_000  # texels of triangles' boxes
_PADDING = 2  # texels between charts, in an atlas of one to two thousand texels a side


def unwrap(mesh: Mesh) -> Mesh:
    """The mesh with an atlas of its own: every point of the surface has its own place in the unit square.

    Vertices on the charts' edges are doubled; faces stay, in number, order and place. The same mesh gives the same
    atlas. Tubes that repeat a texture have better coordinates from `sweep`.

    Returns
    -------
    mesh : uv (V, 2) in [0, 1]; normals as they were.
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
    """Colours of a coarse mesh's atlas.

    Parameters
    ----------
    coarse : its uv is an atlas, see `unwrap`.
    fine : meshes near it, each with the texture that its uv repeat: (H, W, 3) linear, row 0 at v = 0.

    Returns
    -------
    image : (size_px, size_px, 3) linear, row 0 at v = 0. Texels between the charts have the nearest chart's colour.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import cKDTree

    row, column, place_m = _texels(coarse, size_px)
    texel_m = float(np.sqrt(_areas(coarse.vertices_m, coarse.faces).sum() / max(len(row), 1)))
    places, colours = zip(*(_coloured_places(mesh, image, texel_m) for mesh, image in fine), strict=True)
    nearest = cKDTree(np.concatenate(places)).query(place_m, workers=cores())[1]
    image = np.zeros((size_px, size_px, 3), dtype=np.float32)
    image[row, column] = np.concatenate(colours)[nearest]
    empty = np.ones((size_px, size_px), dtype=np.bool_)
    empty[row, column] = False
    by_row, by_column = distance_transform_edt(empty, return_distances=False, return_indices=True)
    filled: Image = image[by_row, by_column]
    return filled


def _areas(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Floats:
    """(F,) areas of triangles in the plane, vertices (V, 2), or in space, (V, 3)."""
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    if vertices.shape[1] == 2:
        across = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        return np.asarray(np.abs(across) / 2.0, dtype=np.float64)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0, dtype=np.float64)


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
    area = _areas(mesh.vertices_m, mesh.faces)
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
    tiles = float(_areas(mesh.uv, mesh.faces).sum())
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
