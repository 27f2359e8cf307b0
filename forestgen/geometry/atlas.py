"""Texture coordinates without overlap, where a texture is baked for one mesh.

Reference
---------
xatlas, https://github.com/jpcy/xatlas: charts are grown over nearly flat regions, unfolded, and packed.
"""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Mesh

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
