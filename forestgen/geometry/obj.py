"""Wavefront OBJ: text, a group a piece, materials in a .mtl file beside it, textures beside both.

Positions are written to 10 micrometres. A .mtl's colours have no standard encoding: these are linear Rec. 709, as
Blender reads and writes them. Image rows run up from v = 0 here, so v is written as 1 - v.

Not by trimesh, whose files with and without texture coordinates in one plant are broken (ADR 0015).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.export import MeshExporter, Model, texture_files


class Obj(MeshExporter):
    """Text, with materials beside it."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        (library,) = self.companions(file_name)
        names, textures = texture_files(model, file_name)
        return {file_name: _obj(model, library).encode(), library: _mtl(model, names).encode(), **textures}

    def companions(self, file_name: str) -> tuple[str, ...]:
        return (f"{file_name[: -len('.obj')]}.mtl",)


EXPORTER = Obj()


def _rows(line: str, values: NDArray[np.float32] | NDArray[np.int64]) -> str:
    return (line * len(values)) % tuple(values.ravel().tolist())


def _obj(model: Model, library: str) -> str:
    text = [f"# forestgen: {model.name}; metres, z up\n"]
    text += [f"# {key}: {value}\n" for key, value in model.properties.items()]
    text.append(f"mtllib {library}\n")
    points = normals = places = 1  # numbers of the next ones
    for piece in model.pieces:
        mesh = piece.mesh
        text.append(f"o {piece.name}\n")
        text += [f"# {key}: {value}\n" for key, value in piece.properties.items()]
        text.append(_rows("v %.5f %.5f %.5f\n", mesh.vertices_m))
        faces = mesh.faces.astype(np.int64)
        columns, line = [faces + points], "%d"
        if mesh.uv is not None:
            text.append(_rows("vt %.5f %.5f\n", np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], axis=1)))
            columns.append(faces + places)
            places += len(mesh.uv)
            line += "/%d"
        if mesh.normals is not None:
            text.append(_rows("vn %.5f %.5f %.5f\n", mesh.normals))
            columns.append(faces + normals)
            normals += len(mesh.normals)
            line += "/%d" if mesh.uv is not None else "//%d"
        points += len(mesh.vertices_m)
        text.append(f"usemtl {piece.surface.name}\n")
        text.append(_rows(f"f {line} {line} {line}\n", np.stack(columns, axis=-1)))
    return "".join(text)


def _mtl(model: Model, textures: dict[tuple[str, str], str]) -> str:
    text = [f"# forestgen: {model.name}; colours are linear Rec. 709\n"]
    for surface in model.surfaces:
        text.append(f"\nnewmtl {surface.name}\n")
        text.append("Kd {:.5f} {:.5f} {:.5f}\nKs 0 0 0\nillum 1\n".format(*surface.reflectance))
        text.append(f"Pr {surface.roughness:.3f}\n")
        for kind, keyword in (("colour", "map_Kd"), ("normal", "norm")):
            if (surface.name, kind) in textures:
                text.append(f"{keyword} {textures[surface.name, kind]}\n")
    return "".join(text)
