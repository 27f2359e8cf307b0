"""Meshes -> mesh files, through trimesh."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from forestgen.geometry.mesh import Mesh

FORMATS = (".glb", ".ply", ".obj")


def mesh_file(meshes: Mapping[str, tuple[Mesh, tuple[float, float, float]]], suffix: str) -> bytes:
    """Bytes of a mesh file.

    Parameters
    ----------
    meshes : name -> mesh (metres, z up) and its colour, linear Rec. 709.
    suffix : one of `FORMATS`. A .glb is turned to y up, as its standard demands; the others stay z up.
    """
    import trimesh

    scene = trimesh.Scene()
    for name, (mesh, colour) in meshes.items():
        body = trimesh.Trimesh(mesh.vertices_m, mesh.faces, vertex_normals=mesh.normals, process=False)
        rgba = [*np.asarray(colour, dtype=np.float64), 1.0]
        if suffix == ".glb":
            material = trimesh.visual.material.PBRMaterial(
                name=name, baseColorFactor=rgba, roughnessFactor=0.8, metallicFactor=0.0, doubleSided=True
            )
            body.visual = trimesh.visual.TextureVisuals(material=material)
        else:
            srgb = np.where(
                np.array(rgba[:3]) <= 0.0031308,
                np.array(rgba[:3]) * 12.92,
                1.055 * np.array(rgba[:3]) ** (1 / 2.4) - 0.055,
            )
            body.visual.face_colors = [*np.round(255 * srgb).astype(int), 255]
        scene.add_geometry(body, node_name=name, geom_name=name)
    if suffix == ".glb":
        scene.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64))
        data = scene.export(file_type="glb")
    else:
        data = scene.to_geometry().export(file_type=suffix[1:])
    return data.encode() if isinstance(data, str) else bytes(data)
