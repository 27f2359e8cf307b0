"""A mesh exporter of another package, as a user would write one: STL."""

from __future__ import annotations

import trimesh

from forestgen.geometry.export import MeshExporter, Model


class Stl(MeshExporter):
    """Triangles alone."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        meshes = [trimesh.Trimesh(one.mesh.vertices_m, one.mesh.faces, process=False) for one in model.pieces]
        return {file_name: trimesh.util.concatenate(meshes).export(file_type="stl"), f"{file_name}.txt": b"oak"}

    def companions(self, file_name: str) -> tuple[str, ...]:
        return (f"{file_name}.txt",)


EXPORTER = Stl()
NO_EXPORTER = object()
