"""Binary PLY files (Turk 1994): all pieces in one mesh, coloured by vertex; a face's `part` is its label.

Not by trimesh, which has neither comments nor flat facets (ADR 0015).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.export import MeshExporter, Model, srgb
from forestgen.geometry.mesh import Mesh

_VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
)
_FACE = np.dtype([("corners", "u1"), ("vertex_indices", "<i4", 3), ("part", "u1")])


class Ply(MeshExporter):
    """A piece without normals gets each facet's own, and vertices of their own for it."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        vertices, faces, first = [], [], 0
        for piece in model.pieces:
            positions, normals, corners = _smooth_or_faceted(piece.mesh)
            vertex = np.empty(len(positions), dtype=_VERTEX)
            for column, name in enumerate("xyz"):
                vertex[name], vertex["n" + name] = positions[:, column], normals[:, column]
            for column, name in enumerate(("red", "green", "blue")):
                vertex[name] = srgb(piece.surface.reflectance)[column]
            face = np.empty(len(corners), dtype=_FACE)
            face["corners"], face["vertex_indices"], face["part"] = 3, corners + first, int(piece.part)
            vertices.append(vertex)
            faces.append(face)
            first += len(vertex)
        parts = ", ".join(f"{int(part)} {part.name.lower()}" for part in Part)
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment forestgen: {model.name}; metres, z up; colours sRGB; part: {parts}",
            *(f"comment {key} {value}" for key, value in model.properties.items()),
            f"element vertex {first}",
            *(f"property float {name}" for name in _VERTEX.names or () if _VERTEX[name] == np.float32),
            *(f"property uchar {name}" for name in _VERTEX.names or () if _VERTEX[name] == np.uint8),
            f"element face {sum(map(len, faces))}",
            "property list uchar int vertex_indices",
            "property uchar part",
            "end_header\n",
        ]
        head = "\n".join(" ".join(line.split()) if line.startswith("comment") else line for line in lines)
        return {file_name: head.encode() + b"".join(one.tobytes() for one in (*vertices, *faces))}


EXPORTER = Ply()


def _smooth_or_faceted(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Positions (V, 3), normals (V, 3) and faces (F, 3); without normals, every face has its own three vertices."""
    if mesh.normals is not None:
        return mesh.vertices_m, mesh.normals, mesh.faces.astype(np.int64)
    corners = mesh.vertices_m[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return corners.reshape(-1, 3), np.repeat(normal, 3, axis=0).astype(np.float32), faces
