"""glTF 2.0 binary files (Khronos Group, 2021): one node and one mesh a piece, below a node of the plant.

The standard wants y up: (x, y, z) becomes (x, z, -y), in the vertices themselves. A leaf's transmittance has no place
in the core standard and goes into its material's extras. trimesh writes the file; it keeps colours as bytes and knows
no extras of materials, so both are put into its document (ADR 0015).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.export import MeshExporter, Model, Piece, Surface, images_of

_BASE = "/"  # name of trimesh's own frame, which is not written: no plant and no piece has this name


class Glb(MeshExporter):
    """glTF 2.0, binary."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        import trimesh
        from trimesh.exchange.gltf import export_glb

        materials = {surface.name: _material(surface) for surface in model.surfaces}
        scene = trimesh.Scene(base_frame=_BASE)
        scene.graph.update(frame_from=_BASE, frame_to=model.name, metadata=dict(model.properties))
        for piece in model.pieces:
            scene.add_geometry(
                _mesh(piece, materials[piece.surface.name]),
                node_name=piece.name,
                geom_name=piece.name,
                parent_node_name=model.name,
                metadata={"part": piece.part.name.lower(), **piece.properties},
            )

        complete = partial(_complete, surfaces=model.surfaces)
        return {file_name: export_glb(scene, unitize_normals=False, tree_postprocessor=complete)}


EXPORTER = Glb()


def _y_up(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    x, y, z = vectors.T
    return np.stack([x, z, -y], axis=1)


def _mesh(piece: Piece, material: Any) -> Any:
    import trimesh

    mesh, uv = piece.mesh, None
    if mesh.uv is not None:  # v runs down from the image's first row in ours and in the file, up in trimesh
        uv = np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1].astype(np.float64)], axis=1)
    return trimesh.Trimesh(
        _y_up(mesh.vertices_m),
        mesh.faces,
        vertex_normals=None if mesh.normals is None else _y_up(mesh.normals),
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )


def _material(surface: Surface) -> Any:
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    textures = {kind: Image.fromarray(image) for kind, image in images_of(surface).items()}
    return PBRMaterial(
        name=surface.name,
        baseColorFactor=None if "colour" in textures else surface.reflectance,
        baseColorTexture=textures.get("colour"),
        normalTexture=textures.get("normal"),
        metallicFactor=0.0,
        roughnessFactor=float(surface.roughness),
        doubleSided=surface.sheet,
    )


def _complete(document: dict[str, Any], surfaces: list[Surface]) -> None:
    """Put into trimesh's document what it does not keep: exact colours, transmittances, names of images."""
    document["asset"]["generator"] = "forestgen"
    of_name = {surface.name: surface for surface in surfaces}
    for material in document["materials"]:
        surface, look = of_name[material["name"]], material["pbrMetallicRoughness"]
        if "baseColorFactor" in look:
            look["baseColorFactor"] = [*surface.reflectance, 1.0]
        if any(surface.transmittance):
            material["extras"] = {"transmittance": list(surface.transmittance)}
        for kind, texture in (("colour", look.get("baseColorTexture")), ("normal", material.get("normalTexture"))):
            if texture is not None:
                image = document["textures"][texture["index"]]["source"]
                document["images"][image]["name"] = f"{surface.name}-{kind}"
