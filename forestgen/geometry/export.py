"""Meshes -> files: .glb, .ply, .obj and OpenUSD's .usd, .usda, .usdc, .usdz.

=======  =======  ========  ==========================  ====================================================
suffix   up       normals   colour                      besides
=======  =======  ========  ==========================  ====================================================
.glb     y        yes       materials, textures inside  names, extras; geometry/gltf.py
.ply     z        yes       vertices, sRGB              each face's part as a number; geometry/ply.py
.obj     z        yes       materials in a .mtl         a group a piece; textures beside it; geometry/obj.py
.usd     z        yes       materials                   custom data; textures beside it, or inside a .usdz;
                                                        geometry/usd.py
=======  =======  ========  ==========================  ====================================================

All are in metres. The same pieces give the same bytes.

A format is added by a module with a class of `MeshExporter` and its only object, EXPORTER, and a line of
`MESH_EXPORTERS` whose name is the suffix without its dot; or from another package:

    fg.register("mesh_exporter", "stl", "my_package.stl:EXPORTER")
"""

from __future__ import annotations

from forestgen.core.registry import Registry
from forestgen.geometry.model import Model

MESH_EXPORTERS = Registry(
    "mesh exporter",
    {
        "glb": ("forestgen.geometry.gltf:EXPORTER", "glTF 2.0, binary: materials and textures inside, y up"),
        "ply": ("forestgen.geometry.ply:EXPORTER", "one mesh, coloured by vertex, with each face's part"),
        "obj": ("forestgen.geometry.obj:EXPORTER", "Wavefront text, its materials and textures beside it"),
        "usd": ("forestgen.geometry.usd:EXPORTER", "OpenUSD, binary, its textures beside it"),
        "usda": ("forestgen.geometry.usd:EXPORTER", "OpenUSD as text, its textures beside it"),
        "usdc": ("forestgen.geometry.usd:EXPORTER", "OpenUSD, binary, its textures beside it"),
        "usdz": ("forestgen.geometry.usd:EXPORTER", "OpenUSD as one package, textures inside"),
    },
    contract="forestgen.geometry.export:MeshExporter",
)


class MeshExporter:
    """A format of mesh files. An exporter has no state."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        """Name -> content of a model's files: `file_name` first, then what goes beside it."""
        raise NotImplementedError

    def companions(self, file_name: str) -> tuple[str, ...]:
        """Names of the files that go beside `file_name` whatever the model is.

        If one exists, it is reported before a plant is grown.
        """
        return ()


def mesh_suffixes() -> tuple[str, ...]:
    """Suffixes of all mesh files, with their dots."""
    return tuple(f".{name}" for name in MESH_EXPORTERS)


def exporter_of(file_name: str) -> MeshExporter:
    """The exporter of a file's suffix, which is one of `mesh_suffixes` in small or capital letters."""
    found: MeshExporter = MESH_EXPORTERS.load(file_name.rsplit(".", 1)[-1].lower())
    return found


def model_files(model: Model, file_name: str) -> dict[str, bytes]:
    """Name -> content of a model's files: `file_name` first, then what goes beside it."""
    return exporter_of(file_name).files(model, file_name)
